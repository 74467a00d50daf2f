"""The given numbers that calibration moved, and what they tell in words. As they stand they are no
findings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zendsp.diagnosis.decide.claims import Claim
from zendsp.diagnosis.decide.findings import Estimate, number
from zendsp.diagnosis.decide.thresholds import PLAIN, SURE, TIED, TOLERANCE
from zendsp.diagnosis.measure.curve import FRICTION
from zendsp.diagnosis.search.body_hypotheses import LIMITS, calibrated
from zendsp.physics.effects import mechanism_of
from zendsp.physics.model import CALLED, TREES, Model, Quantity, per_joint
from zendsp.physics.term_numbers import file_model

FAR = 3.0  # standard deviations
AS_FACTOR = 10.0  # a change beyond is said as a factor, not in per cent
G = 9.81  # m/s²
MOVED_NUMBERS = "calibration moves"  # how such a note begins, after its joint


def moved(given: Model, calibrated: Model, *, off: bool = False) -> list[str]:
    """The given numbers that calibration moved beyond their tolerance, in words, joint by joint.
    They are no findings, but may be what a user looks for.

    Parameters
    ----------
    off : bool
        The report says that the given numbers were off. Where none is beyond its tolerance, those
        that surely moved are told; where none did so alone, all of them.
    """
    given, calibrated = file_model(given), file_model(calibrated)
    tests: list[Callable[[_Number], bool]] = [lambda n: n.is_far]
    if off:
        tests += [lambda n: n.is_sure, lambda n: n.new.value != n.given.value]
    return next(filter(None, (_told(given, calibrated, test) for test in tests)), [])


def _told(given: Model, calibrated: Model, is_told: Callable[[_Number], bool]) -> list[str]:
    """The given numbers that pass a test, in words, joint by joint."""
    out = []
    for joint in range(1, given.joints + 1):
        numbers = (*_numbers(given, calibrated, joint), *_gain(given, calibrated, joint))
        far = [n for n in numbers if is_told(n)]
        if far:
            text = f"{MOVED_NUMBERS} {', '.join(map(str, far))}"
            # a single number of a simulator is of no joint
            own = all(not n.effect and len(given.mechanism[n.key]) == 1 for n in far)
            if given.kind not in CALLED or not own:
                text = f"joint {joint}: {text}"
            factor = one_factor(given, calibrated, joint)
            if factor is not None:
                text += f": all alike, as a torque gain of {1.0 / factor.value:.3g} would"
            if given.kind in TREES and any(n.effect == "inertia" for n in far):
                text += (
                    "; where only its own acceleration shows it, a link or a payload of another"
                    " mass is the same"
                )
            out.append(text + _along_link(given, far))
    return out


def weight_gone(given: Model, improved: Model, joint: int) -> bool:
    """Whether calibration takes the stated weight of a joint's mechanism away: something else was
    taken for it.
    """
    before, after = (m.mechanism.get("gravity", ()) for m in (given, improved))
    if len(before) < joint or not before[joint - 1].free or not before[joint - 1].value:
        return False
    stated, left = before[joint - 1].value, after[joint - 1]
    return abs(left.value) < max(TOLERANCE * abs(stated), PLAIN * left.std)


def _along_link(given: Model, far: Sequence[_Number]) -> str:
    """The point on link 2 of a planar arm whose mass moved its p2 and p3, where both have grown: it
    adds m x² to the one and m l1 x to the other. As uncertain as the given numbers.
    """
    grown = {n.key: n for n in far if not n.effect and n.new.value > n.given.value}
    if given.kind != "planar2r" or not {"p2", "p3"} <= set(grown):
        return ""
    length = given.mechanism["l1"][0].value
    inertia, weight = (
        Estimate(
            (n.new.value - n.given.value) * times,
            math.hypot(max(TOLERANCE * n.given.value, n.given.std), n.new.std) * times,
            unit,
        )
        for n, times, unit in ((grown["p2"], 1.0, "kg m²"), (grown["p3"], G / length, "N m"))
    )
    where = known_point(inertia, weight)
    return f"; {where} along link 2 would do that to p2 and p3" if where else ""


def undone(
    given: Model, improved: Model, claim: Claim, values: Mapping[str, Estimate]
) -> tuple[str, ...]:
    """A coupling, where an inertia at the second joint of a planar arm undoes there what
    calibration moved its own (p2) by: both together are by algebra one by the first joint's
    acceleration.
    """
    if given.kind != "planar2r" or claim.effect != "inertia" or claim.term.joint != 2:
        return ()
    before, after = given.mechanism["p2"][0], improved.mechanism["p2"][0]
    by, amount = after.value - before.value, values["amount"]
    std = math.hypot(after.std, amount.std)
    is_one = before.free and abs(by) > SURE * std and abs(by + amount.value) < SURE * std
    return ("coupling",) if is_one else ()


def friction_moved(given: Model, calibrated: Model, joint: int) -> bool:
    """Whether calibration moved a number of a joint's friction beyond its tolerance."""
    return any(
        n.is_far and n.effect and mechanism_of(n.effect) in FRICTION
        for n in _numbers(given, calibrated, joint)
    )


def count_moved(given: Model, calibrated: Model) -> int:
    """The count of given numbers that calibration moved beyond their tolerance."""
    joints = range(1, given.joints + 1)
    return sum(n.is_far for joint in joints for n in _numbers(given, calibrated, joint))


def bodies_wrong(given: Model, improved: Model) -> int:
    """The count of body numbers of a planar arm that moved beyond their tolerance."""
    if given.kind != "planar2r":
        return 0
    moves = [
        (q, improved.mechanism[key][i])
        for key in calibrated(given)
        for i, q in enumerate(given.mechanism[key])
    ]
    return sum(
        abs(new.value - q.value) > max(LIMITS.calibrated * abs(q.value), LIMITS.far * q.std)
        for q, new in moves
    )


@dataclass(frozen=True)
class _Number:
    """A free number of the given model, and what calibration made of it."""

    effect: str  # of its term; empty where it belongs to the mechanism
    key: str
    given: Quantity
    new: Quantity

    @property
    def is_far(self) -> bool:
        """Whether calibration moved it beyond its tolerance."""
        given, new = self.given.value, self.new
        change = abs(new.value - given)
        return bool(given) and change > math.hypot(TOLERANCE * given, FAR * new.std)

    @property
    def is_sure(self) -> bool:
        """Whether calibration surely moved it, be it within its tolerance."""
        return abs(self.new.value - self.given.value) > FAR * self.new.std

    def __str__(self) -> str:
        given, new = self.given.value, self.new.value
        name = f"{self.effect.replace('_', ' ')} {self.key}".lstrip()
        by = f" ({times(new / given - 1.0)})" if given else ""
        return f"{name} {given:.4g} to {new:.4g}{by}"


def one_factor(given: Model, calibrated: Model, joint: int) -> Estimate | None:
    """The one factor by which calibration multiplied all free numbers of a joint, three or more,
    beyond their tolerance; None where there is no such factor. Each given number is off by its own
    tolerance, and so is its ratio: their weighted mean is surely not 1, and they do not contradict
    it (χ²).
    """
    from scipy.special import chdtrc

    numbers = [n for n in _numbers(given, calibrated, joint) if n.given.value]
    if len(numbers) < 3 or not all(n.is_far for n in numbers):
        return None
    ratios = np.array([n.new.value / n.given.value for n in numbers])
    known = [max(TOLERANCE, abs(n.given.std / n.given.value)) for n in numbers]
    fitted = [n.new.std / n.given.value for n in numbers]
    variances = np.square(np.mean(ratios) * np.array(known)) + np.square(fitted)
    factor, std = float(np.average(ratios, weights=1.0 / variances)), sum(1.0 / variances) ** -0.5
    apart = float(np.sum((ratios - factor) ** 2 / variances))
    if abs(factor - 1.0) < FAR * std or chdtrc(len(ratios) - 1, apart) < TIED:
        return None
    return Estimate(factor, float(std), "1")


def _numbers(given: Model, calibrated: Model, joint: int) -> Iterator[_Number]:
    """The free numbers of a joint."""
    for key, items in given.mechanism.items():
        index = joint - 1 if len(items) > 1 else 0
        if (joint == 1 or len(items) > 1) and items[index].free:
            yield _Number("", key, items[index], calibrated.mechanism[key][index])
    left = list(calibrated.at(joint))
    for old in given.at(joint):
        new = next((t for t in left if t.effect == old.effect), None)
        if new is None:
            continue  # something else stands in its place
        left.remove(new)
        for key, q in old.parameters.items():
            if q.free:
                yield _Number(old.effect, key, q, new.parameters.get(key, q))


def _gain(given: Model, calibrated: Model, joint: int) -> Iterator[_Number]:
    """The torque gain of a joint's drive, where it is free."""
    if given.actuator.gain_free:
        before, after = (per_joint(m.actuator.gain, joint, 1.0) for m in (given, calibrated))
        yield _Number("actuator", "gain", Quantity(before, True), Quantity(after, True))


def point_of(inertia: Estimate, weight: Estimate) -> dict[str, Estimate]:
    """The point mass on the axis of a pendulum that adds this inertia (kg m²) and weight (N m)."""
    of_weight, of_inertia = weight.std / weight.value, inertia.std / inertia.value
    mass, reach = weight.value**2 / (G**2 * inertia.value), G * inertia.value / weight.value
    return {
        "mass": Estimate(mass, abs(mass) * math.hypot(2.0 * of_weight, of_inertia), "kg"),
        "com_x": Estimate(reach, reach * math.hypot(of_weight, of_inertia), "m"),
    }


def known_point(inertia: Estimate, weight: Estimate) -> str:
    """The mass and place of such a point, in words; empty where it may be next to nothing, or
    anywhere.
    """
    body = point_of(inertia, weight)
    if any(known.value < FAR * known.std for known in body.values()):
        return ""
    return f"{number(body['mass'])} at {number(body['com_x'])}"


def times(change: float) -> str:
    """A relative change in words; below 1 % with one digit, and beyond a factor of ten as the
    factor, and as a unit's where it is one of a thousand.

    Examples
    --------
    >>> times(0.38), times(-0.0031), times(24.0), times(-0.999)
    ('+38 %', '-0.3 %', 'a factor of 25', 'a factor of 0.001: a unit?')
    """
    factor, percent = 1.0 + change, 100 * change
    if not factor > 0.0 or 1.0 / AS_FACTOR <= factor <= AS_FACTOR:
        return f"{percent:+.0f} %" if abs(percent) >= 1.0 else f"{percent:+.1g} %"
    thousands = math.log(factor, 1e3)
    unit = ": a unit?" if abs(thousands - round(thousands)) < TOLERANCE else ""
    return f"a factor of {factor:.2g}{unit}"
