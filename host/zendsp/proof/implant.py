"""Implants: a known torque, computed from the recorded motion, added to a real recording's command.

If M qdd + ... = K u holds on the real machine, then M qdd + ... + e = K (u + e / K) holds for a
machine with the effect e too: exact truth, real sensor, real noise. Valid where joints are rigid.
The given model is the one that the diagnosis itself found for the unaltered recording, so that
nothing else is left to find.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat, savemat
from scipy.signal import butter, sosfiltfilt

from zendsp.proof.answer import Answer, Smallest, read_report
from zendsp.proof.children import threads, workers
from zendsp.proof.convert import Recordings, convert
from zendsp.proof.draft import Array
from zendsp.proof.mechanisms import SIZE
from zendsp.proof.real import diagnose, model_folder
from zendsp.proof.score import identity

CUTOFF_HZ = 40.0
SIZES = (1.0, 0.3)
SHARE = 0.1  # of the command's RMS at size 1
GAIN = 35.15065188248547  # N/V of EMPS
EFFECTS = ("stiffness", "cubic_stiffness", "quadratic_drag", "ripple", "position_friction")


@dataclass(frozen=True)
class Implant:
    """One effect put into a real recording."""

    effect: str
    size: float
    parameters: dict[str, float]
    answer: Answer
    stated: tuple[Smallest, ...] = ()  # what the report of the unaltered recording would have seen

    @property
    def named(self) -> bool:
        """Named first, or in the first finding's set."""
        first = self.answer.findings[0] if self.answer.findings else None
        return first is not None and self.effect in (first.effect, *first.indistinguishable)

    @property
    def above(self) -> bool | None:
        """Larger than what the unaltered recording would have shown, by its report; None where that
        states no size.
        """
        size = self.parameters.get(SIZE[self.effect], math.nan)
        stated = [s.size for s in self.stated if s.effect == self.effect]
        return abs(size) > min(stated) if stated else None

    def error(self) -> float | None:
        """Relative error of the leading parameter, where the very effect was found."""
        key = next(iter(self.parameters))
        for f in self.answer.findings:
            if f.effect == self.effect and key in f.parameters:
                return abs(f.parameters[key].value / self.parameters[key] - 1)
        return None


def middle_motion(q: Array, dt: float) -> tuple[Array, Array]:
    """Position and velocity at the middle of each hold interval, without phase."""
    smooth = sosfiltfilt(butter(4, CUTOFF_HZ, fs=1 / dt, output="sos"), q)
    v = np.gradient(smooth, dt)
    return smooth + 0.5 * dt * v, v + 0.5 * dt * np.gradient(v, dt)


def parameters_for(
    effect: str, size: float, q: Array, v: Array, command: Array
) -> dict[str, float]:
    """Sizes on the training recording; the leading parameter first."""
    force = SHARE * size * GAIN * float(np.sqrt(np.mean(command**2)))
    neutral = float(q.mean())
    if effect == "stiffness":
        return {"coefficient": force / float(np.std(q)), "neutral": neutral}
    if effect == "cubic_stiffness":
        return {
            "coefficient": force / float(np.sqrt(np.mean((q - neutral) ** 6))),
            "neutral": neutral,
        }
    if effect == "quadratic_drag":
        return {"coefficient": force / float(np.sqrt(np.mean(v**4)))}
    if effect == "ripple":  # not the screw's own orders
        return {"amplitude": 1.4 * force, "order": 2 * np.pi / 0.0137, "phase": 0.7}
    return {"amplitude": 1.4 * force, "period": 0.061, "phase": 0.4}


def torque(effect: str, p: dict[str, float], q: Array, v: Array) -> Array:
    """The implanted force along the motion, N."""
    if effect == "stiffness":
        return np.asarray(p["coefficient"] * (q - p["neutral"]))
    if effect == "cubic_stiffness":
        return np.asarray(p["coefficient"] * (q - p["neutral"]) ** 3)
    if effect == "quadratic_drag":
        return np.asarray(p["coefficient"] * v * np.abs(v))
    if effect == "ripple":
        return np.asarray(p["amplitude"] * np.sin(p["order"] * q + p["phase"]))
    return np.asarray(
        p["amplitude"] * np.sin(2 * np.pi * q / p["period"] + p["phase"]) * np.sign(v)
    )


def put_in(
    source: Path, target: Path, effect: str, parameters: dict[str, float] | None, size: float
) -> dict[str, float]:
    """Copy an EMPS recording with the effect in it; sizes are drawn from it where none are given.
    """
    table = loadmat(source, squeeze_me=True)
    q, v = middle_motion(np.asarray(table["qm"], float), 1e-3)
    command = np.asarray(table["vir"], float)
    if parameters is None:
        parameters = parameters_for(effect, size, q, v, command)
    changed = command + torque(effect, parameters, q, v) / GAIN
    keep = {k: table[k] for k in ("t", "qm", "qg")}
    savemat(target, {**keep, "vir": changed}, oned_as="column", do_compression=True)
    return parameters


def run_implants(
    data: Path, out: Path, limit: float, quick: bool, jobs: int, tell: Callable[[str], None]
) -> list[Implant]:
    """Every implant on EMPS, ``jobs`` at a time; a run that was interrupted goes on where it
    stopped.

    Raises
    ------
    FileNotFoundError
        The recordings are absent.
    RuntimeError
        The unaltered recording could not be diagnosed.
    """
    recordings = convert("emps", data, out)
    base = out / "unaltered"
    tell("the unaltered recording, whose diagnosis is the model that the implants are given")
    first = _asked(model_folder() / "emps.toml", recordings, base, limit)
    if first.trouble:
        raise RuntimeError(f"the unaltered EMPS recording gave no model: {first.trouble}")
    model = without_controller(base / "model.toml", out / "emps_found.toml")

    def one(effect: str, size: float) -> Implant:
        folder = out / f"{effect}_{size:g}"
        folder.mkdir(parents=True, exist_ok=True)
        train, held = folder / "train.mat", folder / "heldout.mat"
        parameters = put_in(recordings.train[0], train, effect, None, size)
        put_in(recordings.heldout[0], held, effect, parameters, size)
        answer = _asked(model, Recordings((train,), (held,)), folder / "report", limit)
        done = Implant(effect, size, parameters, answer, first.smallest)
        tell(implant_line(done))
        return done

    wanted = [
        (e, x) for e in (EFFECTS[:2] if quick else EFFECTS) for x in (SIZES[:1] if quick else SIZES)
    ]
    with workers(threads(jobs)) as pool:
        return list(pool.map(lambda case: one(*case), wanted))


def _asked(model: Path, recordings: Recordings, out: Path, limit: float) -> Answer:
    """The answer that an earlier run left in its folder, by the same code; or a new one."""
    stamp, code = out / "code", identity()
    if stamp.exists() and stamp.read_text() == code and (out / "report.json").exists():
        return read_report(out / "report.json", math.nan)
    answer = diagnose(model, recordings, out, limit)
    if not answer.trouble:
        stamp.write_text(code)
    return answer


def without_controller(source: Path, target: Path) -> Path:
    """The model without ``[controller]``: the altered command is not the controller's any more."""
    keep, skipping = [], False
    for line in source.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            skipping = line.strip().startswith("[controller")
        if not skipping:
            keep.append(line)
    target.write_text("\n".join(keep) + "\n", encoding="utf-8")
    return target


def implant_line(i: Implant) -> str:
    """One implant."""
    error = i.error()
    said = i.answer.trouble or ", ".join(f.effect for f in i.answer.findings) or i.answer.verdict
    off = "" if error is None else f", {next(iter(i.parameters))} off by {error:.1%}"
    return f"  {'yes' if i.named else 'NO '}  {i.effect} x{i.size:g}: said {said}{off}"


def implant_lines(done: list[Implant]) -> list[str]:
    """One line per implant and a total; where reports state what they would have seen, the implants
    above that.
    """
    lines = [
        *map(implant_line, done),
        f"implants named first: {sum(i.named for i in done)} of {len(done)}",
    ]
    above = [i for i in done if i.above]
    if any(i.above is not None for i in done):
        complete = sum(i.answer.verdict == "complete" for i in above)
        lines.append(
            f"above the size that the report states as seen: {sum(i.named for i in above)} of"
            f" {len(above)} named first, {complete} called complete"
        )
    return lines
