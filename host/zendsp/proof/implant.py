"""Implants: a known law put into real recordings, as large as the report says that it would see.

The given model is the one that the diagnosis itself found for the unaltered recordings, so that
nothing else is left to find. With it the unaltered recordings are diagnosed once more: that report
states the smallest sizes that these recordings would have shown. Implants are multiples of them,
above and below. Where no size is stated, an implant is a part of the RMS torque, and shows what
such a silence hides.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import savemat

from zendsp.proof.answer import Answer, Finding, Smallest, read_report
from zendsp.proof.children import threads, workers
from zendsp.proof.convert import Recordings, convert
from zendsp.proof.draft import Array
from zendsp.proof.implanted import Columns, Motion
from zendsp.proof.mechanisms import BODILY, NEEDLESS, SIZE, mechanism_of
from zendsp.proof.real import diagnose, model_folder
from zendsp.proof.score import identity

SURE = 0.8  # of a wrong name, from which on it is called sure
WITHIN = 2.0  # standard deviations between the number found and the true one
FRESH = 1e-3  # of the RMS torque: size at which a law is tried before it is scaled


@dataclass(frozen=True)
class Wish:
    """An effect to put into a joint of a machine: at multiples of its stated size; where none is
    stated, at shares of the RMS torque.
    """

    effect: str
    joint: int = 1
    times: tuple[float, ...] = (1.3, 2.0)
    shares: tuple[float, ...] = (0.1,)


W = Wish
WANTED: dict[str, tuple[Wish, ...]] = {
    "emps": (
        W("stiffness", times=(0.5, 1.3, 4.0)),
        W("ripple", times=(0.5, 1.3)),
        W("gain_drift", times=(1.3,)),
        W("quadratic_drag", times=(1.3,)),
        W("cubic_stiffness"),
        W("delay", shares=()),
        W("dead_zone"),
        W("position_friction", times=(1.3,)),
        W("load_friction", times=(1.3,)),
        W("disturbance"),
        W("stribeck", times=(1.3,)),
        W("friction_drift", times=(1.3,)),
        W("hysteresis"),
    ),
    "single_pendulum": (
        W("stiffness", times=(0.5, 1.3, 4.0)),
        W("viscous"),
        W("torque_offset", times=(1.3,)),
        W("ripple", times=(1.3,)),
        W("cubic_stiffness", times=(1.3,)),
        W("position_friction", times=(1.3,)),
        W("encoder_eccentricity", times=(1.3,), shares=()),
        W("stribeck", times=(1.3,)),
        W("friction_drift", times=(1.3,)),
        W("disturbance"),
    ),
    "tx40": (
        W("stiffness", 3),
        W("ripple", 3, (1.3,)),
        W("quadratic_drag", 3, (1.3,)),
        W("delay", 1, (1.3,), ()),
        W("dead_zone", 1, (1.3,)),
        W("position_friction", 2, (1.3,)),
        W("disturbance", 2, (1.3,)),
    ),
    "kuka_kr300": (
        W("stiffness", 1, (1.3,)),
        W("position_friction", 3, (1.3,)),
        W("disturbance", 5, (1.3,)),
    ),
}
QUICK = ("emps",)


@dataclass(frozen=True)
class Implant:
    """One law in a real recording, and the answer."""

    machine: str
    effect: str
    joint: int
    times: float  # its size as a multiple of the stated one; nan where none is stated
    share: float  # of the RMS torque of the training recording
    parameters: dict[str, float]  # the leading one first
    answer: Answer

    @property
    def stated(self) -> bool:
        """Whether a size was stated, so that the implant is above or below it."""
        return not math.isnan(self.times)

    def is_right(self, finding: Finding) -> bool:
        """The very law or a set that holds it, at its joint."""
        names = {finding.effect, *finding.indistinguishable}
        return self.effect in names and (finding.joint == self.joint or finding.effect in BODILY)

    @property
    def named(self) -> bool:
        """Named first."""
        return bool(self.answer.findings) and self.is_right(self.answer.findings[0])

    @property
    def mechanism(self) -> bool:
        """Its mechanism is first, at its joint."""
        first = self.answer.findings[0] if self.answer.findings else None
        own = mechanism_of(self.effect)
        return first is not None and self.joint == first.joint and own in (
            mechanism_of(first.effect, first.mechanism),
            *(mechanism_of(name) for name in first.indistinguishable),
        )

    @property
    def complete(self) -> bool:
        """Called complete."""
        return self.answer.verdict == "complete"

    @property
    def wrong(self) -> bool:
        """A wrong name is stated as sure; a law that holds the right one as a special case is none.
        """
        return any(
            f.confidence >= SURE
            and not self.is_right(f)
            and f.effect != "unknown"
            and f.effect not in NEEDLESS.get(self.effect, ())
            for f in self.answer.findings
        )

    @property
    def broken(self) -> bool:
        """A promise is broken: no answer, complete above the stated size, or a wrong name as sure.
        """
        return bool(self.answer.trouble) or self.wrong or (self.complete and self.times > 1.0)

    def deviation(self) -> float | None:
        """The error of the leading number in its own standard deviations, where the very effect was
        found.
        """
        key = next(iter(self.parameters))
        for f in self.answer.findings:
            if f.effect == self.effect and f.joint == self.joint and key in f.parameters:
                found, truth = f.parameters[key], self.parameters[key]
                truth += self.parameters.get("upon", 0.0)
                return abs(found.value - truth) / max(found.std, 1e-300)
        return None


def shape_of(effect: str, m: Motion, model: Columns, joint: int) -> dict[str, float]:
    """The parameters beside the leading one, from the motion of the training recording; none of
    them lies at a special point of the travel.
    """
    middle, travel = float(np.mean(m.q)), float(np.ptp(m.q))
    top, seconds = float(np.abs(m.v).max()), float(m.t[-1])
    waves = 5.0 if model.model["mechanism"]["kind"] != "linear" else 2 * math.pi / (0.064 * travel)

    def friction(*kinds: str) -> float:
        """The mean of the numbers of a friction, those of both directions."""
        terms = (e for e in model.model["effect"] if e["joint"] == joint and e["kind"] in kinds)
        values = [q["value"] for e in terms for q in e.values() if isinstance(q, dict)]
        return float(np.mean(values)) if values else 0.0

    return {
        # the breakaway that is found contains the friction upon which the curve stands
        "stribeck": {"velocity": 0.07 * top, "upon": friction("coulomb", "coulomb_asymmetry")},
        "position_friction": {"period": 0.29 * travel, "phase": 0.4},
        "friction_drift": {
            "time_constant": 0.3 * seconds,
            "dry": friction("coulomb", "coulomb_asymmetry"),
            "fluid": friction("viscous", "viscous_asymmetry"),
        },
        "gain_drift": {"time_constant": 0.3 * seconds},
        "gravity": {"angle": 0.8},
        "stiffness": {"neutral": middle},
        "cubic_stiffness": {"neutral": middle},
        "ripple": {"order": waves, "phase": 0.7},
        "encoder_eccentricity": {"phase": 0.7},
        "disturbance": {"middle": 0.41 * seconds, "length": 1.0},
    }.get(effect, {})


LEADING = {**SIZE, "stribeck": "breakaway", "friction_drift": "ratio", "gain_drift": "ratio",
           "hysteresis": "force", "disturbance": "peak"}  # fmt: skip


def sized(effect: str, size: float, shape: dict[str, float], m: Motion) -> dict[str, float]:
    """The parameters of a law with its leading number."""
    p = {LEADING[effect]: size, **shape}
    if effect == "delay":
        dt = float(np.median(np.diff(m.t)))
        p["rows"] = max(1.0, round(size / dt))
        p["time"] = p["rows"] * dt
    if effect == "hysteresis":
        p["stiffness"] = 15.0 * size / float(np.ptp(m.q))
    return p


def change(effect: str, p: dict[str, float], columns: Columns, joint: int) -> Array:
    """The change of the joint's torque by a law, row by row."""
    table = columns.with_law(effect, joint, p)
    after = Columns(table, columns.model).torques
    before = columns.torques[: len(after)]
    out: Array = (after - before).reshape(len(after), -1)[:, joint - 1]
    return out


def share_of(effect: str, p: dict[str, float], columns: Columns, joint: int) -> float:
    """RMS of a law's torque as a part of the RMS torque that moves the joint, or that holds it
    where there is no actuator.
    """
    torque = columns.motion(joint).torque
    scale = float(np.sqrt(np.mean(torque**2))) or _weight(columns, joint)
    return float(np.sqrt(np.mean(change(effect, p, columns, joint) ** 2))) / scale


def _weight(columns: Columns, joint: int) -> float:
    """RMS torque of a pendulum's weight."""
    gravity = float(columns.model["mechanism"]["parameters"]["gravity"]["value"])
    return gravity * float(np.sqrt(np.mean(np.sin(columns.motion(joint).q) ** 2)))


def sizes(wish: Wish, stated: float | None, train: Columns) -> list[tuple[float, float]]:
    """(multiple of the stated size, leading number) of the implants of one wish; the multiple is
    nan where no size is stated.
    """
    if stated is not None:
        return [(x, x * stated) for x in wish.times]
    m = train.motion(wish.joint)
    shape = shape_of(wish.effect, m, train, wish.joint)
    small = FRESH * (float(np.sqrt(np.mean(m.torque**2))) or _weight(train, wish.joint))
    if wish.effect in ("friction_drift", "gain_drift"):
        small = FRESH
    unit = share_of(wish.effect, sized(wish.effect, small, shape, m), train, wish.joint)
    return [(math.nan, small * share / unit) for share in wish.shares]


@dataclass(frozen=True)
class Subject:
    """A machine whose unaltered recordings were diagnosed, with the model that was found."""

    name: str
    recordings: Recordings
    model: Path
    unaltered: Answer

    def stated(self, wish: Wish) -> float | None:
        """The smallest size that the report of the unaltered recordings states."""
        said = [s.size for s in self.unaltered.smallest if is_of(s, wish)]
        return min(said) if said else None


def is_of(said: Smallest, wish: Wish) -> bool:
    """Whether a stated size is that of a wish."""
    return (said.joint, said.effect) == (wish.joint, wish.effect)


def prepared(name: str, data: Path, out: Path, limit: float) -> Subject:
    """The machine's own diagnosis, and that of the unaltered recordings with the model it found.

    Raises
    ------
    FileNotFoundError
        The recordings are absent.
    RuntimeError
        The unaltered recordings could not be diagnosed.
    """
    recordings = convert(name, data, out)
    start, found, given = out / f"{name}.toml", out / "found.toml", out / "given.toml"
    shutil.copyfile(model_folder() / f"{name}.toml", start)
    answer = asked(start, recordings, out / "first", limit)
    if not answer.trouble:
        text = uncontrolled((out / "first" / "model.toml").read_text(encoding="utf-8"))
        found.write_text(text, encoding="utf-8")
        given.write_text(driven(text), encoding="utf-8")
        answer = asked(found, recordings, out / "unaltered", limit)
    if answer.trouble:
        raise RuntimeError(f"{name} unaltered gave no model: {answer.trouble}")
    return Subject(name, recordings, given, answer)


def asked(model: Path, recordings: Recordings, out: Path, limit: float) -> Answer:
    """The answer that an earlier run left in its folder, by the same code; or a new one."""
    stamp, code = out / "code", identity()
    if stamp.exists() and stamp.read_text() == code and (out / "report.json").exists():
        return read_report(out / "report.json", math.nan)
    answer = diagnose(model, recordings, out, limit, "--jobs", "1", "--no-figures")
    if not answer.trouble:
        stamp.write_text(code)
    return answer


def uncontrolled(text: str) -> str:
    """A model without ``[controller]``: the altered command is not the controller's any more."""
    keep, skipping = [], False
    for line in text.splitlines():
        if line.startswith("["):
            skipping = line.strip().startswith("[controller")
        if not skipping:
            keep.append(line)
    return "\n".join(keep) + "\n"


def driven(text: str) -> str:
    """A model with a command: where it has none, that of an actuator that gave nothing."""
    if "\ncommand =" in text:
        return text
    return text.replace("[columns]\n", '[columns]\ncommand = "implanted"\n')


def written(table: dict[str, Array], path: Path) -> Path:
    """Write a recording in the format of its name."""
    if path.suffix == ".mat":
        savemat(path, table, oned_as="column", do_compression=True)
    else:
        np.savez_compressed(path, allow_pickle=False, **table)
    return path


def put_in(
    subject: Subject, wish: Wish, times: float, size: float, out: Path, limit: float
) -> Implant:
    """Put one law into all recordings of a machine, and ask."""
    train = Columns.read(subject.recordings.train[0], subject.model)
    m = train.motion(wish.joint)
    p = sized(wish.effect, size, shape_of(wish.effect, m, train, wish.joint), m)
    out.mkdir(parents=True, exist_ok=True)

    def one(path: Path) -> Path:
        columns = Columns.read(path, subject.model)
        table = columns.with_law(wish.effect, wish.joint, p)
        return written(table, out / path.name)

    train_files, held = (
        tuple(map(one, part)) for part in (subject.recordings.train, subject.recordings.heldout)
    )
    answer = asked(subject.model, Recordings(train_files, held), out / "report", limit)
    share = share_of(wish.effect, p, train, wish.joint)
    return Implant(subject.name, wish.effect, wish.joint, times, share, p, answer)


def run_implants(
    data: Path, out: Path, limit: float, quick: bool, only: str, jobs: int,
    tell: Callable[[str], None],
) -> list[Implant]:  # fmt: skip
    """Every implant, or those of one machine, ``jobs`` at a time; a run that was interrupted goes
    on where it stopped.
    """
    done: list[Implant] = []
    for name in [only] if only else QUICK if quick else WANTED:
        tell(f"{name} unaltered: its diagnosis is the model that the implants are given")
        subject = prepared(name, data, out / name, limit)
        tell(unaltered_line(subject))
        train = Columns.read(subject.recordings.train[0], subject.model)
        todo = [
            (wish, times, size)
            for wish in WANTED[name]
            for times, size in sizes(wish, subject.stated(wish), train)
        ]

        def one(case: tuple[Wish, float, float], subject: Subject = subject) -> Implant:
            wish, times, size = case
            folder = out / subject.name / f"{wish.effect}_{wish.joint}_{size:.3g}"
            made = put_in(subject, wish, times, size, folder, limit)
            tell(implant_line(made))
            return made

        with workers(threads(jobs)) as pool:
            done += pool.map(one, todo[:QUICKLY] if quick else todo)
    return done


QUICKLY = 4  # implants of a quick run


def unaltered_line(subject: Subject) -> str:
    """What the report says of the unaltered recordings, and would have seen."""
    a = subject.unaltered
    seen = ", ".join(f"{s.effect}@{s.joint} {s.size:.3g}" for s in a.smallest)
    said = ", ".join(f"{f.effect}@{f.joint}" for f in a.findings) or a.verdict
    return f"  {subject.name} unaltered: said {said}; would have seen {seen or 'nothing'}"


def implant_line(i: Implant) -> str:
    """One implant."""
    said = i.answer.trouble or i.answer.verdict
    if i.answer.findings:
        said = ", ".join(f"{f.effect}@{f.joint} {f.confidence:.2f}" for f in i.answer.findings)
    size = f"x{i.times:g} of the stated size" if i.stated else "no size stated"
    error = i.deviation()
    off = "" if error is None else f", number off by {error:.1f} deviations"
    mark = "yes" if i.named else "mec" if i.mechanism else "NO "
    return (
        f"  {mark}  {i.machine} {i.effect}@{i.joint}, {size}, {i.share:.1%} of the torque:"
        f" said {said}{off}"
    )


def implant_lines(done: Sequence[Implant]) -> list[str]:
    """One line per implant; the totals above, below and without a stated size."""
    groups = (
        ("above the size that the report states as seen", [i for i in done if i.times > 1.0]),
        ("below it", [i for i in done if i.times <= 1.0]),
        ("of which no size is stated", [i for i in done if not i.stated]),
    )
    lines = [*map(implant_line, done)]
    for words, group in groups:
        right = [d for d in map(Implant.deviation, group) if d is not None]
        lines.append(
            f"{words}: {_of(i.named for i in group)} named first, {_of(i.mechanism for i in group)}"
            f" their mechanism, {_of(i.complete for i in group)} called complete,"
            f" {_of(i.wrong for i in group)} with a wrong name stated at 80 % or more;"
            f" {_of(d <= WITHIN for d in right)} numbers within two deviations"
        )
    return lines


def _of(flags: Iterable[bool]) -> str:
    those = list(flags)
    return f"{sum(those)} of {len(those)}"
