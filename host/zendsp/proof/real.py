"""Real machines: models that lack the physics, their recordings, and what was published about them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from zendsp.physics.files.shipped import model_folder as model_folder
from zendsp.proof.answer import Answer
from zendsp.proof.children import command
from zendsp.proof.convert import LOAD, Recordings, altered, convert
from zendsp.proof.score import asked
from zendsp_protocol.views import with_std


@dataclass(frozen=True)
class Machine:
    """One real machine of the proof."""

    name: str
    published: str  # what the publication says, for the eye
    # model file of the published model, to simulate beside ours; "" where there is none
    compare: str
    promises: tuple[tuple[str, Callable[[Answer], bool]], ...]


def names(answer: Answer, effect: str, joint: int = 1) -> bool:
    """The answer names `effect` on `joint`, or a set that holds it."""
    return any(
        f.joint == joint and (f.effect == effect or effect in f.indistinguishable)
        for f in answer.findings
    )


def dry_friction(answer: Answer, joint: int = 1) -> bool:
    """Coulomb friction in any of its forms."""
    forms = ("coulomb", "coulomb_asymmetry", "stribeck", "presliding", "position_friction")
    return any(names(answer, form, joint) for form in forms)


def screw_ripple(answer: Answer) -> bool:
    """A ripple once per 2.5 mm turn of the screw: order 2513 per metre, within 2 %."""
    found = [f.parameters.get("order") for f in answer.findings if f.effect == "ripple"]
    return any(order is not None and abs(order.value / 2513.27 - 1) < 0.02 for order in found)


def compliance_of_axis_3(answer: Answer) -> bool:
    """0.18 to 0.22 mrad per kN m by hand (docs/measurements/two_sensors.md), within a factor 1.5.
    """
    return _compliance(answer, 3, 0.12e-6, 0.33e-6)


def compliance_of_axis_2(answer: Answer) -> bool:
    """0.11 mrad per kN m by hand, 0.13 as published, within a factor 1.5."""
    return _compliance(answer, 2, 0.073e-6, 0.2e-6)


def _compliance(answer: Answer, joint: int, low: float, high: float) -> bool:
    """Whether a spring is named at a joint, of a compliance within two bounds, rad/(N m)."""
    found = [
        f.parameters["stiffness"].value
        for f in answer.findings
        if f.joint == joint and f.effect == "elasticity"
    ]
    return any(low < 1.0 / k < high for k in found if k > 0)


def sprung(answer: Answer, joints: tuple[int, ...]) -> bool:
    """A spring is named at one of these joints."""
    return any(f.joint in joints and f.effect == "elasticity" for f in answer.findings)


def load_of_150_kg(answer: Answer) -> bool:
    """A payload is the first finding, its mass within 15 % and within its own 95 % interval."""
    first = answer.findings[0] if answer.findings else None
    if first is None or first.effect != "payload":
        return False
    mass = first.parameters["mass"]
    return abs(mass.value - LOAD) < min(0.15 * LOAD, 2.0 * mass.std)


def _wrist_coupling(answer: Answer) -> bool:
    return any(f.effect == "coupling" and f.joint in (5, 6) for f in answer.findings)


AT_EACH_AXIS = tuple(  # of six
    (f"Coulomb friction of axis {j}", partial(dry_friction, joint=j)) for j in range(1, 7)
)
MACHINES = (
    Machine(
        "emps",
        "mass 95.11 kg, viscous 203.5 N s/m, Coulomb 20.39 N, offset -3.165 N; asymmetric: 166.7 /"
        " 240.4 N s/m, 20.1 / 20.6 N",
        "emps_published.toml",
        (
            ("Coulomb friction", dry_friction),
            ("asymmetry", lambda a: names(a, "viscous_asymmetry") or names(a, "coulomb_asymmetry")),
            ("ripple once per turn of the screw", screw_ripple),
        ),
    ),
    Machine(
        "single_pendulum",
        "viscous 2.2394e-4 N m s/rad; by hand: Coulomb and quadratic drag together in place of it",
        "single_pendulum.toml",
        (
            ("Coulomb friction", dry_friction),
            ("quadratic drag", lambda a: names(a, "quadratic_drag")),
            ("viscous replaced", lambda a: any("viscous" in f.replaces for f in a.findings)),
        ),
    ),
    Machine(
        "tx40",
        "Coulomb 7.14, 8.26, 6.34, 2.48, 3.03, 0.282 N m; wrist coupling inertia 0.00964 kg m^2,"
        " viscous 0.616, Coulomb 1.95",
        "",
        (
            *AT_EACH_AXIS,
            ("wrist coupling of axes 5 and 6", _wrist_coupling),
        ),
    ),
    Machine(
        "kuka_kr300",
        "stiffness of axes 1 to 3: 4.58e6, 7.52e6, 4.10e6 N m/rad; by hand, with the 3 ms by which"
        " the second encoders are late: 4.5e6 to 5.7e6 at axis 3, 9e6 at axis 2, axis 1 at the"
        " edge of what these recordings show",
        "",
        (
            ("compliance of axis 3 by its two encoders", compliance_of_axis_3),
            ("compliance of axis 2 by its two encoders", compliance_of_axis_2),
            ("no spring at axes 4 to 6", lambda a: not sprung(a, (4, 5, 6))),
        ),
    ),
    Machine(
        "kuka_unloaded",
        "the same by its motors' encoders, at 100 Hz by a clock that jitters, given without the 150"
        " kg that it carries; by hand, rotors and friction refitted: 148 +- 7 kg of both"
        " recordings, 214 of the first, 297 of the second",
        "",
        (("the load first, within 15 %", load_of_150_kg),),
    ),
    Machine(
        "kuka_frictionless",
        "the same log, given with its load and without any dry friction: Coulomb 355, 242, 294, 50,"
        " 47, 76 N m, fitted with the rest of the model",
        "",
        (
            *AT_EACH_AXIS,
            ("at most one finding beyond", lambda a: len(a.findings) <= 7),
        ),
    ),
)


@dataclass(frozen=True)
class Seen:
    """What came out on one machine."""

    machine: str
    answer: Answer
    kept: tuple[tuple[str, bool], ...]
    # held-out error of the published model, in the report's quantity
    published_heldout: float | None
    absent: str = ""  # why there was nothing to run on
    altered: tuple[str, ...] = ()  # files that are not those of the published figures

    @property
    def good(self) -> bool:
        """Whether the answer came, without trouble, and says all that was published."""
        return not self.absent and not self.answer.trouble and all(ok for _, ok in self.kept)


def diagnose(
    model: Path, recordings: Recordings, out: Path, limit: float, *options: str
) -> Answer:
    """Run the command on a real recording."""
    line = [*command("diagnose"), *map(str, recordings.train), "--model", str(model), "--json"]
    line += options
    for path in recordings.heldout:
        line += ["--heldout", str(path)]
    return asked(line, out, limit)


def given_heldout(out: Path) -> float | None:
    """Held-out error of the model as it was given, from a report."""
    try:
        value = json.loads((out / "report.json").read_text(encoding="utf-8"))["fit"]["heldout"][
            "given"
        ]
    except (OSError, KeyError, json.JSONDecodeError):
        return None
    return float(value) if isinstance(value, int | float) else None


def look_at(machine: Machine, data: Path, out: Path, limit: float) -> Seen:
    """Convert, diagnose, compare one machine."""
    here = out / machine.name
    try:
        recordings = convert(machine.name, data, here)
    except FileNotFoundError as error:
        return Seen(machine.name, Answer("", trouble="absent"), (), None, absent=str(error))
    model = here / f"{machine.name}.toml"
    if not model.exists():  # of some it is made with the recordings
        text = (model_folder() / model.name).read_text(encoding="utf-8")
        model.write_text(text, encoding="utf-8")
    answer = diagnose(model, recordings, here / "report", limit)
    published = None
    if machine.compare:
        other = model_folder() / machine.compare
        reports = here / "report" if other.name == model.name else here / "published"
        if other.name != model.name:
            diagnose(other, recordings, reports, limit)
        published = given_heldout(reports)
    kept = tuple((what, bool(ask(answer))) for what, ask in machine.promises)
    return Seen(machine.name, answer, kept, published, altered=tuple(altered(machine.name, data)))


def lines_of(machine: Machine, seen: Seen) -> list[str]:
    """What is printed for one machine."""
    if seen.absent:
        return [f"{machine.name}: ABSENT. {seen.absent}"]
    a = seen.answer
    if a.trouble:
        return [f"{machine.name}: FAILED. {a.trouble}"]
    out = [f"{machine.name}: {a.verdict} in {a.seconds:.1f} s", f"  published: {machine.published}"]
    for f in a.findings:
        values = ", ".join(f"{k} {with_std(e.value, e.std)}" for k, e in f.parameters.items())
        gone = f"  (replaces {', '.join(f.replaces)})" if f.replaces else ""
        detail = f" ({f.detail})" if f.detail else ""
        out.append(f"  found: {f.effect} on joint {f.joint}{detail}: {values}{gone}")
    held = (
        f"  held out: calibrated {a.calibrated:.4g}, improved {a.improved:.4g}, noise"
        f" {a.noise_floor:.2g}"
    )
    beaten = ""
    if seen.published_heldout is not None:
        beaten = f"; published model as given {seen.published_heldout:.4g}"
    out.append(held + beaten)
    out += [
        f"  {name} is not the file of the published figures (its hash differs)"
        for name in seen.altered
    ]
    out += [f"  {'yes' if ok else 'NO '}  {what}" for what, ok in seen.kept]
    return out


def main_status(results: list[tuple[Machine, Seen]]) -> int:
    """0 when every machine was there and every promise kept; 1 otherwise, absent data included."""
    return 0 if results and all(seen.good for _, seen in results) else 1
