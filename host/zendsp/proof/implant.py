"""Implants: a known law put into real recordings, as large as the report says that it would see.

The given model is the one that the diagnosis itself found for the unaltered recordings, so that
nothing else is left to find. With it the unaltered recordings are diagnosed once more: that report
states the smallest sizes that these recordings would have shown. Implants are multiples of them,
above and below. Where no size is stated, an implant is a part of the RMS torque, and shows what
such a silence hides.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import savemat

from zendsp.proof.answer import Answer, Finding, Smallest, read_report
from zendsp.proof.children import threads, workers
from zendsp.proof.convert import Recordings, convert
from zendsp.proof.implant_sizes import shape_of, share_of, size_of, sized
from zendsp.proof.implant_wishes import QUICK, WANTED, Wish
from zendsp.proof.implanted import Columns
from zendsp.proof.mechanisms import BODILY, NEEDLESS, mechanism_of
from zendsp.proof.real import diagnose, model_folder
from zendsp.proof.score import JUDGED, identity

SURE = 0.8  # of a wrong name, from which on it is called sure
ONCE = ("disturbance",)  # in the first recording: in all, along one motion, it is of the state
WITHIN = 2.0  # standard deviations between the number found and the true one


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
    silent: bool = False  # the report says nothing of the joint: complete

    @property
    def stated(self) -> bool:
        """Whether a size was stated, so that the implant is above or below it."""
        return not math.isnan(self.times)

    def is_right(self, finding: Finding) -> bool:
        """The very law or a set that holds it."""
        return self.effect in (finding.effect, *finding.indistinguishable)

    @property
    def said(self) -> list[Finding]:
        """The findings of its joint, or of a body."""
        return [f for f in self.answer.findings if f.joint == self.joint or f.effect in BODILY]

    @property
    def named(self) -> bool:
        """Named first."""
        return bool(self.said) and self.is_right(self.said[0])

    @property
    def mechanism(self) -> bool:
        """Its mechanism is first."""
        if not self.said:
            return False
        first = self.said[0]
        return mechanism_of(self.effect) in (
            mechanism_of(first.effect, first.mechanism),
            *(mechanism_of(name) for name in first.indistinguishable),
        )

    @property
    def complete(self) -> bool:
        """Called complete, as far as its joint is concerned."""
        return self.silent and not self.said and not self.answer.trouble

    @property
    def wrong(self) -> bool:
        """A wrong name is stated as sure; a law that holds the right one as a special case is none.
        """
        return any(
            f.confidence >= SURE
            and not self.is_right(f)
            and f.effect != "unknown"
            and f.effect not in NEEDLESS.get(self.effect, ())
            for f in self.said
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
    start, found = out / f"{name}.toml", out / "found.toml"
    shutil.copyfile(model_folder() / f"{name}.toml", start)
    answer = asked(start, recordings, out / "first", limit)
    if not answer.trouble:
        text = (out / "first" / "model.toml").read_text(encoding="utf-8")
        found.write_text(uncontrolled(text), encoding="utf-8")
        answer = asked(found, recordings, out / "unaltered", limit)
    if answer.trouble:
        raise RuntimeError(f"{name} unaltered gave no model: {answer.trouble}")
    return Subject(name, recordings, found, answer)


def asked(model: Path, recordings: Recordings, out: Path, limit: float) -> Answer:
    """The answer that an earlier run left in its folder, by the same code; or a new one."""
    stamp, code = out / "code", identity(*JUDGED, "proof")
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


def put_in(subject: Subject, wishes: Sequence[Wish], out: Path, limit: float) -> list[Implant]:
    """Put laws into all recordings of a machine, one a joint, and ask."""
    train = Columns.read(subject.recordings.train[0], subject.model)
    laws: dict[Wish, tuple[float, dict[str, float]]] = {}
    for w in wishes:
        stated = subject.stated(w)
        if stated is not None or w.share:
            times, size = size_of(w, stated, train)
            m = train.motion(w.joint)
            laws[w] = times, sized(w.effect, size, shape_of(w.effect, m, train, w.joint), m)
    out.mkdir(parents=True, exist_ok=True)

    def one(path: Path) -> Path:
        columns = Columns.read(path, subject.model)
        for w, (_, p) in laws.items():
            if w.effect not in ONCE or path == subject.recordings.train[0]:
                columns = Columns(columns.with_law(w.effect, w.joint, p), columns.model)
        table, target = columns.table, out / path.name
        if path.suffix == ".mat":
            savemat(target, table, oned_as="column", do_compression=True)
        else:
            np.savez_compressed(target, allow_pickle=False, **table)
        return target

    if not laws:
        return []
    files, held = (
        tuple(map(one, part)) for part in (subject.recordings.train, subject.recordings.heldout)
    )
    answer = asked(subject.model, Recordings(files, held), out / "report", limit)
    left = unexplained_joints(out / "report" / "report.json")
    return [
        Implant(
            subject.name, w.effect, w.joint, times, share_of(w.effect, p, train, w.joint), p,
            answer, w.joint not in left,
        )
        for w, (times, p) in laws.items()
    ]  # fmt: skip


def unexplained_joints(report: Path) -> set[int]:
    """The joints of which a report says that something is missing without a name."""
    if not report.exists():
        return set()
    said = json.loads(report.read_text(encoding="utf-8"))["unexplained"]
    return {int(number) for number in re.findall(r"^Joint (\d+):", said, re.MULTILINE)}


def run_implants(
    data: Path, out: Path, limit: float, quick: bool, only: str, jobs: int,
    tell: Callable[[str], None],
) -> list[Implant]:  # fmt: skip
    """Every implant, or those of one machine, ``jobs`` at a time; a run that was interrupted goes
    on where it stopped.
    """
    done: list[Implant] = []
    wanted = {only: WANTED[only]} if only else QUICK if quick else WANTED
    for name, rounds in wanted.items():
        tell(f"{name} unaltered: its diagnosis is the model that the implants are given")
        subject = prepared(name, data, out / name, limit)
        tell(unaltered_line(subject))

        def one(wishes: tuple[Wish, ...], subject: Subject = subject) -> list[Implant]:
            named = "_".join(f"{w.effect}{w.joint}x{w.times:g}" for w in wishes)
            made = put_in(subject, wishes, out / subject.name / named, limit)
            tell("\n".join(map(implant_line, made)))
            return made

        with workers(threads(jobs)) as pool:
            for made in pool.map(one, rounds):
                done += made
    return done


def unaltered_line(subject: Subject) -> str:
    """What the report says of the unaltered recordings, and would have seen."""
    a = subject.unaltered
    seen = ", ".join(f"{s.effect}@{s.joint} {s.size:.3g}" for s in a.smallest)
    said = ", ".join(f"{f.effect}@{f.joint}" for f in a.findings) or a.verdict
    return f"  {subject.name} unaltered: said {said}; would have seen {seen or 'nothing'}"


def implant_line(i: Implant) -> str:
    """One implant."""
    said = i.answer.trouble or i.answer.verdict
    if i.said:
        said = ", ".join(f"{f.effect} {f.confidence:.2f}" for f in i.said)
    elif not i.answer.trouble:
        said = "complete" if i.complete else "unexplained"
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
