"""The result of a diagnosis; ``Diagnosis.report()`` is report.json of the contract."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.assemble import Assembled
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import (
    ErrorReport,
    FitReport,
    Rejected,
    Report,
    Verdict,
    WhereReport,
    dark,
    nameless,
    nearest,
    times_off,
    two_digits,
)
from zendsp.diagnosis.decide.findings import Finding, number
from zendsp.diagnosis.decide.headline import complete_below, verdict_sentence
from zendsp.diagnosis.measure.where import Missing, Region
from zendsp.diagnosis.measure.windows import WINDOW
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model
from zendsp_protocol.views import html_table, sentence

Array = npt.NDArray[np.float64]
OFF = 3.0  # times the calibrated model's error: above it the given model is wrong


def _rounded(value: float) -> float:
    """The number with four digits, more than any of these figures is sure of."""
    return float(f"{value:.4g}")


@dataclass(frozen=True)
class FitTable:
    """RMS position error of short free simulations, rad or m: given, calibrated and improved model.
    """

    given: float
    calibrated: float
    improved: float

    def as_dict(self) -> ErrorReport:
        """For the report."""
        return {"given": self.given, "calibrated": self.calibrated, "improved": self.improved}


def numbers_off(verdict: Verdict, table: FitTable, left: Sequence[Left] = ()) -> bool:
    """Whether the headline of a complete model says that its given numbers were off, and notes say
    which; not where the recordings show nothing of a joint.
    """
    shown = verdict == Verdict.COMPLETE and not dark((x.joint, x.interval) for x in left)
    return shown and table.given > OFF * table.calibrated


@dataclass(frozen=True)
class Left:
    """The unexplained torque at a joint, as a part of the RMS torque, with its 95 % interval; 1
    where the model does not follow the recording.
    """

    joint: int
    share: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Detectable:
    """The smallest size of an effect at a joint that the recordings would have shown, with 90 %
    probability.
    """

    joint: int
    mechanism: str
    effect: str
    size: float  # infinite where even a large one would not have been shown
    unit: str
    share: float  # of the RMS torque
    # the shape of its law that shows least, SI: a period, the speed of a Stribeck curve
    at: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_shown(self) -> bool:
        """Whether some size would have been shown."""
        return math.isfinite(self.size)


@dataclass(frozen=True)
class Next:
    """The next recording and its reason, with a reference that separates the open hypotheses, rad
    or m.
    """

    sentence: str
    reference: tuple[Array, float] | None = None  # positions (n, joints), sample time in s
    tells: bool = True  # False: the sentence says why no recording would tell them apart
    free: int = 0  # the joint that it is of, where nothing drives that


@dataclass(frozen=True)
class Workings:
    """The data behind a diagnosis, for its figures: searches and decisions of the joints, the
    models of the whole machine, recordings to fit to and to test on.
    """

    searches: Sequence[JointSearch]
    decisions: Sequence[Decision]
    whole: Assembled
    train: Data
    test: Data

    def forget(self) -> None:
        """Let go of what was computed along the recordings: a figure needs little of it again."""
        for data in (self.train, self.test):
            data.forget()


@dataclass(frozen=True)
class SimulatorErrors:
    """Errors of a simulator on the held-out recording, (n, joints) each, over its time, (n,)."""

    time: Array
    calibrated: Array
    improved: Array


@dataclass(frozen=True)
class Errors:
    """Position errors of all joints with one unit of position; tables and noise floor as in
    `Diagnosis`.
    """

    unit: str
    joints: tuple[int, ...]  # empty: all
    estimation: FitTable
    heldout: FitTable
    test: FitTable
    noise_floor: float
    window: float = WINDOW  # s, of the free simulations

    @property
    def of(self) -> str:
        """The joints in words, to follow what the errors are of, as ", joints 1, 2"; empty for all.
        """
        which = ", ".join(map(str, self.joints))
        return f", joint{'s' * (len(self.joints) > 1)} {which}" if which else ""

    def as_dict(self) -> FitReport:
        """For the report."""
        return {
            "quantity": "position",
            "unit": self.unit,
            "estimation": self.estimation.as_dict(),
            "heldout": self.heldout.as_dict(),
            "test": self.test.as_dict(),
            "noise_floor": self.noise_floor,
        }


@dataclass(repr=False, eq=False)  # arrays have no one truth
class Diagnosis:
    """The outcome of a diagnosis; docs/diagnosis.md says how to read it.

    Attributes
    ----------
    verdict : {"complete", "missing", "unexplained"}
    findings, refinements : tuple of Finding
        The claims, the most important first; and terms that only improve the fit.
    regions, times, times_of
        Where the model lacks something: intervals of a joint's state, intervals of time (s), and
        the recordings of these times.
    unit : str
        Unit of positions, rad or m; where joints slide and turn, that of joint 1.
    estimation, heldout, test : FitTable
        Errors on the recordings of the fit, on the held-out ones, and on the untouched part of
        these.
    noise_floor : float
        Error of the sensor alone, in ``unit``.
    rejected : tuple of Rejected
    next_recording : Next or None
    seconds : float
        Duration of the diagnosis.
    notes : tuple of str
    given, calibrated, improved : Model
        The model as given, with its free parameters refitted, and with what was found.
    unexplained : str
        The unexplained torque, a line for each joint; empty where there is none.
    discrepancy : tuple of Left
    detectable, undetectable : tuple of Detectable
        The smallest effects that would have been seen; and those that would not even if large.
    others : tuple of Errors
        Errors of the joints with the other unit of position, where joints slide and turn.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    regions: tuple[Region, ...]
    times: tuple[tuple[float, float], ...]
    unit: str
    estimation: FitTable
    heldout: FitTable
    noise_floor: float
    rejected: tuple[Rejected, ...]
    next_recording: Next | None
    seconds: float
    notes: tuple[str, ...]
    given: Model
    calibrated: Model
    improved: Model
    unexplained: str = ""
    # torque that the calibrated model lacks
    missing: dict[int, list[Missing]] = field(default_factory=dict)
    # and what the improved one lacks
    remaining: dict[int, list[Missing]] = field(default_factory=dict)
    refinements: tuple[Finding, ...] = ()  # what improves the fit and is not claimed
    discrepancy: tuple[Left, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    undetectable: tuple[Detectable, ...] = ()
    times_of: tuple[str, ...] = ()
    others: tuple[Errors, ...] = ()
    test: FitTable | None = None  # on recordings that neither the fit nor any choice has touched
    # of a simulator that can only be called: its errors
    workings: Workings | SimulatorErrors | None = None
    stopped: bool = False  # an interrupt ended the search; this is what was found until then
    # effects and joints about which the headline cannot tell
    doubted: tuple[tuple[str, int], ...] = ()
    loads: tuple[int, ...] = ()  # unexplained joints; numbers of its own explain each recording
    window: float = WINDOW  # s, of the free simulations whose errors these are
    undriven: tuple[int, ...] = ()  # joints whose command is zero throughout
    zeros: tuple[str, ...] = ()  # a sentence for each joint that has another zero than given

    @property
    def errors(self) -> tuple[Errors, ...]:
        """Position errors, once for each unit of position that the joints have."""
        other = {j for e in self.others for j in e.joints}
        own = tuple(j for j in range(1, self.given.joints + 1) if other and j not in other)
        test = self.test or self.heldout
        first = Errors(
            self.unit, own, self.estimation, self.heldout, test, self.noise_floor, self.window
        )
        return (first, *self.others)

    @property
    def units(self) -> str:
        """The unit of all positions, as a `Reference` has it: "rad", "m", or "rad or m"."""
        return " or ".join(u for u in ("rad", "m") if any(e.unit == u for e in self.errors))

    @property
    def nameless(self) -> tuple[tuple[int, float], ...]:
        """The joints with torque that has no name and exceeds the sensor's error, and its share."""
        shares = ((x.joint, x.share) for x in self.discrepancy)
        return nameless(shares, (self.test or self.heldout).improved, self.noise_floor)

    @property
    def headline(self) -> str:
        """The verdict in one or two sentences, the mechanism first."""
        if self.stopped and not self.findings:
            return "Interrupted before it was done: nothing is claimed."
        found = [
            (f.word, (f.effect, *f.indistinguishable), f.joint, f.confidence)
            for f in self.findings
        ]
        unseen = dark((x.joint, x.interval) for x in self.discrepancy)
        table, left = self.test or self.heldout, self.nameless
        most = {x.joint: -x.share for x in self.discrepancy}
        near = sorted(nearest(self.verdict, self.rejected), key=lambda law: most.get(law[1], 0.0))
        text = verdict_sentence(self.verdict, found, unseen, left, near, self.doubted, self.loads)
        errs = max(times_off(e.test.improved, e.noise_floor) for e in self.errors)
        if self.verdict == Verdict.COMPLETE and errs and not (unseen or left or self.doubted):
            text = complete_below(errs)
        if numbers_off(self.verdict, table, self.discrepancy):
            times = two_digits(table.given / table.calibrated)
            text += f" The given numbers were off: calibrated, it errs {times} times less (notes)."
        text = " ".join((*self.zeros, text))
        return f"So far, interrupted: {text}" if self.stopped else text

    def report(self) -> Report:
        """report.json of the contract, as plain numbers and strings."""
        return {
            "verdict": self.verdict,
            "headline": self.headline,
            "findings": [f.as_dict() for f in self.findings],
            "refinements": [f.as_dict() for f in self.refinements],
            "discrepancy": [
                {
                    "joint": d.joint,
                    "share": _rounded(d.share),
                    "interval": [_rounded(x) for x in d.interval],
                }
                for d in self.discrepancy
            ],
            "detectable": [
                {
                    "joint": d.joint,
                    "mechanism": d.mechanism,
                    "effect": d.effect,
                    "size": _rounded(d.size),
                    "unit": d.unit,
                    "at": {name: _rounded(x) for name, x in d.at.items()},
                }
                for d in self.detectable
            ],
            "undetectable": [
                {
                    "joint": d.joint,
                    "mechanism": d.mechanism,
                    "effect": d.effect,
                    "at": {name: _rounded(x) for name, x in d.at.items()},
                }
                for d in self.undetectable
            ],
            "where": self._where(),
            "fit": self.errors[0].as_dict(),
            "fit_other_unit": [e.as_dict() for e in self.others],
            "rejected": [
                {"effect": r.effect, "joint": r.joint, "why": r.why, "score": round(r.score, 1)}
                for r in self.rejected
            ],
            "next_recording": (
                None
                if self.next_recording is None
                else {
                    "sentence": self.next_recording.sentence,
                    "reference": (
                        "next_reference.mat" if self.next_recording.reference is not None else None
                    ),
                }
            ),
            "undriven": list(self.undriven),
            "unexplained": self.unexplained,
            "notes": list(self.notes),
            "seconds": round(self.seconds, 3),
        }

    def _where(self) -> WhereReport:
        """Where the model lacks something: times, and regions of the state."""
        return {
            "time": [[round(a, 4), round(b, 4)] for a, b in self.times],
            "state": [
                {
                    "joint": r.joint,
                    "variable": r.variable,
                    "interval": [r.interval[0], r.interval[1]],
                    "unit": r.unit,
                    "share": round(r.share, 4),
                    "time_share": round(r.time_share, 4),
                }
                for r in self.regions
            ],
        }

    def __repr__(self) -> str:
        found = ", ".join(
            f"{f.effect} at joint {f.joint} ({100 * f.confidence:.0f} %)" for f in self.findings
        )
        return f"<Diagnosis {self.verdict}{f': {found}' if found else ''}; {self.seconds:.1f} s>"

    def _repr_html_(self) -> str:
        """HTML for a notebook: the findings as sentences, their numbers, and the fit."""
        said = "".join(
            sentence(f"{f.sentence} (confidence {100 * f.confidence:.0f} %)") for f in self.findings
        )
        said += "".join(map(sentence, self.unexplained.splitlines()))
        rows = [
            (f.effect, f.joint, name, number(e))
            for f in self.findings
            for name, e in f.parameters.items()
        ]
        numbers = html_table(("effect", "joint", "parameter", "value"), rows) if rows else ""
        fit = "".join(
            html_table(
                (f"RMS error [{e.unit}]{e.of}", "given", "calibrated", "improved",
                 "noise floor"),
                [
                    (name, *(f"{x:.3g}" for x in (t.given, t.calibrated, t.improved)),
                     f"{e.noise_floor:.2g}")
                    for name, t in (
                        ("recordings of the fit", e.estimation), ("untouched", e.test)
                    )
                ],
            )
            for e in self.errors
        )  # fmt: skip
        return sentence(f"verdict: {self.verdict}") + said + numbers + fit

    def __str__(self) -> str:
        lines = [f"verdict: {self.verdict}{', so far, interrupted' if self.stopped else ''}"]
        lines += [f"  {f.sentence} (confidence {100 * f.confidence:.0f} %)" for f in self.findings]
        lines += [f"  {words}" for words in self.unexplained.splitlines()]
        own, shares = self.errors[0], ((x.joint, x.share) for x in self.discrepancy)
        lines += [
            f"  {100 * share:.2g} % of the torque of joint {joint} has no name: more is left than"
            " the error of the sensor"
            for joint, share in nameless(shares, own.test.improved, own.noise_floor)
            if self.verdict == Verdict.COMPLETE
        ]
        lines += [
            f"  untouched{e.of}: given {e.test.given:.3g}, calibrated"
            f" {e.test.calibrated:.3g}, improved {e.test.improved:.3g} {e.unit} (noise floor"
            f" {e.noise_floor:.3g} {e.unit})"
            for e in self.errors
        ]
        return "\n".join(lines)
