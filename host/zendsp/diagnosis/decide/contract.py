"""report.json of the contract, as types; docs/diagnosis.md says what each key means.

A file holds null where a diagnosis has no finite number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NotRequired, TypedDict

from zendsp.physics.effects import get_effect
from zendsp_protocol.texts import enumerated

# times the sensor's error: a complete model that errs more says what it leaves, as 22 of 99 in a
# campaign did (seed 229); and a part of a joint's torque: less is not worth a sentence
BEYOND, LEAST_NAMELESS = 2.0, 1e-3

# log-likelihood. Of 154 complete models of four makers none had more than 626, but for one that
# seemed late; a loose mass had 1196
FAR_LIKELIER = 1000.0
# the same for delays, lags and oscillating loads, which the step size of a simulator imitates. A
# complete model had 1871; a joint 5 ms late in a motion that its held-out recording does not have
# had 10368
FAR_LATER = 2000.0

# mechanisms in plain words
WORDS = {
    "dry_friction": "dry friction",
    "fluid_friction": "fluid friction",
    "friction": "friction, dry or fluid",  # without a law, see `Finding.word`
    "transmission": "a flexible or loose transmission",
    "position_torque": "a torque that depends on position",
    "inertia": "a mass or an inertia",
    "actuator": "the actuator",
    "measurement": "the measurement",
    "disturbance": "a disturbance",
}

NOT_SURELY = "not surely this law"  # first words of the reason of a near law


class Verdict(StrEnum):
    """What a diagnosis says of a machine, or a decision of a joint; compares as its text."""

    COMPLETE = "complete"
    MISSING = "missing"
    UNEXPLAINED = "unexplained"
    DISTURBANCE = "disturbance"  # of a joint alone: something pushes it

    def __repr__(self) -> str:
        return repr(self.value)


class Reason(StrEnum):
    """The reason that a hypothesis lost; its ``why`` has it in words."""

    NEAR = "near"  # the likeliest law, and it explains most of the missing torque
    TOO_SMALL = "too_small"  # surely there, but smaller than a finding has to be
    OTHER = "other"


@dataclass(frozen=True)
class Rejected:
    """A hypothesis that was fitted and lost. ``score``: its log-likelihood minus the winner's
    (negative: worse).
    """

    effect: str
    joint: int
    why: str
    score: float
    reason: Reason = Reason.OTHER


class EstimateReport(TypedDict):
    """A parameter, SI."""

    value: float
    std: float
    unit: str


class CurveReport(TypedDict):
    """A torque without a law, as a curve over the variable on which it depends."""

    variable: str
    unit: str
    at: list[float]
    torque: list[float]
    std: list[float]
    against_motion: bool


class PushedReport(TypedDict):
    """Another joint on which a disturbance acts."""

    joint: int
    rms: float
    peak: float


class DetailsReport(TypedDict, total=False):
    """Further numbers of a finding, from further sensors or of a body."""

    sensors: str
    compliance: float
    compliance_std: float
    weight: float  # of an added inertia
    also_on: list[PushedReport]
    torque: float  # friction within a transmission
    side: str  # of a torque sensor
    dry_before: float
    dry_after: float
    viscous_before: float
    viscous_after: float


class Further(TypedDict, total=False):
    """Keys that some findings have."""

    from_joint: int  # of a coupling
    law: str  # of a coupling
    intervals: list[list[float]]  # of a disturbance, s
    recordings: list[str]  # of a disturbance, one for each interval; of another load
    body: str
    curve: CurveReport  # of an unknown
    details: DetailsReport


class FindingReport(Further):
    """A missing effect."""

    effect: str
    joint: int
    parameters: dict[str, EstimateReport]
    confidence: float
    share: float
    indistinguishable: list[str]
    replaces: list[str]
    mechanism: str
    laws: dict[str, float]
    sentence: str


class LeftReport(TypedDict):
    """Torque that nothing named explains."""

    joint: int
    share: float | None
    interval: list[float]


class DetectableReport(TypedDict):
    """The smallest size that would have been seen."""

    joint: int
    mechanism: str
    effect: str
    size: float
    unit: str
    at: dict[str, float]  # the shape of the law that shows least, SI


class UndetectableReport(TypedDict):
    """An effect that would not have been seen even if large."""

    joint: int
    mechanism: str
    effect: str
    at: dict[str, float]


class RegionReport(TypedDict):
    """An interval of a joint's state in which the mismatch lies."""

    joint: int
    variable: str
    interval: list[float]
    unit: str
    share: float
    time_share: float


class WhereReport(TypedDict):
    """Where the model lacks something: intervals of time, s, and regions of the state."""

    time: list[list[float]]
    state: list[RegionReport]


class ErrorReport(TypedDict):
    """RMS position error of the three models."""

    given: float | None
    calibrated: float | None
    improved: float | None


class FitReport(TypedDict):
    """Errors on the recordings of the fit, held out, and untouched."""

    quantity: str
    unit: str
    estimation: ErrorReport
    heldout: ErrorReport
    test: ErrorReport
    noise_floor: float | None


class RejectedReport(TypedDict):
    """A hypothesis that lost."""

    effect: str
    joint: int
    why: str
    score: float


class NextReport(TypedDict):
    """The next recording."""

    sentence: str
    reference: str | None  # its file


class Report(TypedDict):
    """The whole report.json."""

    verdict: Verdict
    headline: str
    findings: list[FindingReport]
    refinements: list[FindingReport]
    discrepancy: list[LeftReport]
    detectable: list[DetectableReport]
    undetectable: list[UndetectableReport]
    where: WhereReport
    fit: FitReport
    fit_other_unit: list[FitReport]  # where joints slide and turn
    rejected: list[RejectedReport]
    next_recording: NextReport | None
    undriven: NotRequired[list[int]]  # joints whose command is zero throughout
    unexplained: str
    notes: list[str]
    seconds: float


def nameless(
    left: Iterable[tuple[int, float | None]], error: float | None, floor: float | None
) -> tuple[tuple[int, float], ...]:
    """The torque that a complete model leaves although the position errs by more than the sensor: a
    random torque of the machine, or something without a name.

    Parameters
    ----------
    left : iterable of (joint, share)
        Joint, and its unexplained torque as a part of the RMS torque, from ``discrepancy``.
error, floor : float
        RMS position error on untouched recordings, and that of the sensor alone, rad or m; None
        where not known.
    """
    if not times_off(error, floor):
        return ()
    return tuple((joint, share) for joint, share in left if share and share > LEAST_NAMELESS)


def times_off(error: float | None, floor: float | None) -> float:
    """The position error of a complete model over the least one, where it is well above that; else
    0.
    """
    if error is None or floor is None or not error > BEYOND * floor:
        return 0.0
    return error / max(floor, 1e-300)


def _likeliest(rejected: Iterable[Rejected]) -> list[Rejected]:
    """The likeliest hypothesis of each joint."""
    best: dict[int, Rejected] = {}
    for r in rejected:
        best[r.joint] = max(r, best.get(r.joint, r), key=lambda x: (x.score, x.effect, x.why))
    return [best[joint] for joint in sorted(best)]


def contradicted(rejected: Iterable[Rejected]) -> tuple[tuple[str, int], ...]:
    """Effects and joints that the recordings of the fit show to be missing and the untouched ones
    do not. The untouched motion may not show them, or too little of the likeliest. One that is too
    small there does not make a joint doubtful alone.
    """
    far = [
        r
        for r in rejected
        if r.score > (FAR_LATER if is_stepped(r.effect) else FAR_LIKELIER)
    ]
    joints = {r.joint for r in far if r.reason is not Reason.TOO_SMALL}
    return tuple((r.effect, r.joint) for r in _likeliest(far) if r.joint in joints)


def is_stepped(effect: str) -> bool:
    """Whether an effect may come from a simulator's step size, or from unknown commands between
    rows: delays, lags, and oscillating loads.
    """
    return get_effect(effect).family in ("timing", "transmission")


def nearest(verdict: Verdict, rejected: Iterable[Rejected]) -> tuple[tuple[str, int], ...]:
    """The effect nearest to the unexplained torque of each joint, with the joint."""
    if verdict != Verdict.UNEXPLAINED:
        return ()
    return tuple(
        (r.effect, r.joint) for r in _likeliest(r for r in rejected if r.reason is Reason.NEAR)
    )


def dark(left: Iterable[tuple[int, Sequence[float]]]) -> tuple[int, ...]:
    """The joints about which the recordings show nothing: all of their torque could be unexplained.

    Parameters
    ----------
    left : iterable of (joint, interval)
        Joint, and the interval of its unexplained torque as a part of the RMS torque, from
        ``discrepancy``.
    """
    return tuple(joint for joint, (_, high) in left if high >= 1.0)


def spans(times: Sequence[tuple[float, float]], recordings: Sequence[str], most: int = 4) -> str:
    """The first times, s, in words, with their recordings and the count of further ones.

    Examples
    --------
    >>> spans([(3.0, 4.0), (1.0, 2.0), (5.0, 6.0)], ["a", "a", "b"], most=2)
    '1.00–2.00 s, 3.00–4.00 s of a and 1 more'
    """
    names = dict.fromkeys(recordings[:most])
    told = [
        ", ".join(
            f"{a:.2f}–{b:.2f} s"
            for (a, b), n in sorted(zip(times[:most], recordings, strict=False))
            if n == name
        )
        + (f" of {name}" if name else "")
        for name in names
    ]
    return " and ".join([*told, *([f"{len(times) - most} more"] if len(times) > most else [])])


def listed(joints: Iterable[int]) -> str:
    """A list of joints in words.

    Examples
    --------
    >>> listed([3]), listed([3, 1, 2])
    ('joint 3', 'joints 1, 2 and 3')
    """
    numbers = sorted(joints)
    return f"joint{'s' * (len(numbers) > 1)} {enumerated(map(str, numbers))}"


def two_digits(value: float) -> str:
    """A number with two digits, and all those before the point: 100, not 1e+02."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
