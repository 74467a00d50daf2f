"""Whether a law predicts better than its neighbours: the same torque, bent a little.

A law that a machine does not follow can still explain most of the missing torque. Its shape is then
wrong: the torque grows with the cube of the speed where the law has the square, or is smaller at
one end of the travel. A neighbour has as many numbers as the law, and no name. Where one predicts
better, the law is wrong (target and decoy, Elias and Gygi 2007). It is wrong, too, where the bend
itself, estimated beside all numbers of the model, surely is not zero: v² - v is near v³ along one
recording, and not near enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    as_seen,
    deviation,
    energy_blocks,
    kept,
    lacking,
)
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.structure import Ranges, counted, ranges_of, unit
from zendsp.physics.calibration.fit import Data, bounds_and_steps, joint_handles
from zendsp.physics.calibration.handles import Handle, get_values, set_values
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.observed import trace
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]

# difference of a neighbour from the law at the ends of the travel, or of the speeds; other values
# were not tried
BENT_BY = 0.7
SLOPE_STEP = 1e-3  # of a number's natural size, for slopes
TURNS_ROUND = 0.02  # of the speed: below, dry friction changes direction
# of a law's energy, as an observer sees it: with less where it counts, its shape is not seen. (A
# Stribeck curve of 12 mm/s, found to five digits, had 4 and 5 % away from reversals for the two
# slowest observers, beside what their memory of the reversals left, and "was" bent by 0.5)
LEAST_COUNTED = 0.1
OBSERVERS = 2  # that have to see a bend: what a single one sees may be its noise
LEAST_LOG = 1e-3  # of a law's size: below, its logarithm does not fall
RIDGE = 1e-9  # of the mean square of a column
# largest factor on a neighbour's torque: drag that merges with the model's viscous friction needed
# 11 to 75, right ones at most 1.2
LARGER = 3.0
BENDS_SURELY = 3.0  # standard deviations of a bend that is not zero
# of what a law leaves to an observer: a bend that takes up less may be its noise. A right spring
# under a coarse encoder had one that took up less
TAKEN_UP = 0.1


@dataclass(frozen=True)
class _Law:
    """A law and the ways to bend it, one array for each recording: slopes (1 + numbers, n) of the
    law, and logarithm of its size, place and speed (ways, n). Of a law that every machine has, the
    last two bends are laws themselves.
    """

    data: Data
    model: Model
    joint: int
    slopes: list[Array]
    ways: list[Array]


def against_neighbours(
    data: Data, fitted: Scored, term: Term, joint: int, error: float, turning: bool = True
) -> float:
    """The evidence for a law over the best of its neighbours.

    Parameters
    ----------
    data : Data
        All recordings. Law and neighbours have equally many numbers, so fitting favours neither.
    fitted : Scored
        The model with the law, without its refinements.
    term : Term
        The law, one of the terms of the model.
    joint : int
        1-based.
    error : float
        Possible error of any law, as a part of its size.
    turning : bool
        Whether torque at reversals counts.

    Returns
    -------
    float
        Standard deviations over blocks of time; of the observers that can tell, the second lowest,
        since what a single one sees may be its own noise, or too few blocks. Below 0 a neighbour
        predicts better, by more than a law's possible error. Where no observer can tell, since more
        stays unexplained than the law explains, it is not below 0. Minus infinite where the law is
        surely bent, by each of the two slowest observers, to which the sensor's noise means least.
        Infinite where the law is no function of the state, has no neighbours different enough, or
        hardly acts where it counts for most observers.
    """
    slopes = [_slopes(rec[joint - 1], fitted.model, term) for rec in data.records]
    rms = float(np.sqrt(np.mean(np.concatenate([law[0] for law in slopes]) ** 2)))
    moving = [counted(rec[joint - 1], BANDS[0], turning) for rec in data.records]
    there = sum(float(law[0] ** 2 @ use) for law, use in zip(slopes, moving, strict=True))
    if there < LEAST_COUNTED * sum(float(law[0] @ law[0]) for law in slopes) or rms == 0.0:
        return float("inf")
    common = get_effect(term.effect).common
    ways = [
        _ways(rec[joint - 1], law[0] / rms, ranges_of(data, joint), common)
        for rec, law in zip(data.records, slopes, strict=True)
    ]
    law = _Law(data, fitted.model, joint, slopes, ways)
    handles = [
        h
        for h in joint_handles(fitted.data, fitted.model, joint)
        if not (h.place == "term" and fitted.model.terms[h.index] is term)
    ]
    sizes = bounds_and_steps(fitted.data, fitted.model, handles)[2]
    seen = (_seen(law, handles, sizes, band, turning) for band in BANDS)
    each = [s for s in seen if s.energy >= LEAST_COUNTED * s.whole]
    if len(each) < OBSERVERS:
        return float("inf")
    if any(_surely(law, each[-OBSERVERS:], k, error) for k in range(len(ways[0]))):
        return float("-inf")
    found = [_ahead(law, seen, error) for seen in each]
    telling = [ahead for ahead, tells in found if tells] or [max(ahead, 0.0) for ahead, _ in found]
    return sorted(telling)[:OBSERVERS][-1]


@dataclass(frozen=True)
class _Seen:
    """What an observer sees, one array for each recording: the law and its slopes, derivatives by
    all other numbers, the torque that they have to explain, and the samples that count.
    """

    band: float
    own: list[Array]
    others: list[Array]
    wanted: list[Array]
    use: list[npt.NDArray[np.bool_]]

    @property
    def whole(self) -> float:
        """The sum of the squares of the law, counted or not."""
        return sum(float(made[0] @ made[0]) for made in self.own)

    @property
    def energy(self) -> float:
        """The sum of the squares of the law where it counts."""
        return sum(
            float(made[0] ** 2 @ there) for made, there in zip(self.own, self.use, strict=True)
        )


def _seen(
    law: _Law, handles: Sequence[Handle], sizes: Array, band: float, turning: bool
) -> _Seen:
    """A law as an observer of this bandwidth sees it."""
    own, lacks = (
        _as_seen(law, band, law.slopes), lacking(law.data, law.model, law.joint, band)
    )  # fmt: skip
    return _Seen(
        band,
        own,
        _others(law, handles, sizes, band, lacks),
        [lack + made[0] for lack, made in zip(lacks, own, strict=True)],
        [_used(rec[law.joint - 1], band, turning) for rec in law.data.records],
    )


def _as_seen(law: _Law, band: float, torques: Sequence[Array]) -> list[Array]:
    return [
        as_seen(rec[law.joint - 1], law.model, band, torque)
        for rec, torque in zip(law.data.records, torques, strict=True)
    ]


def _surely(law: _Law, each: Sequence[_Seen], way: int, error: float) -> bool:
    """Whether each observer sees that a law has to be bent in a way, surely, by more than its
    possible error, and to the same side.
    """
    found = [_bend(law, seen, way) for seen in each]
    sides = {math.copysign(1.0, bend) for bend, _ in found}
    return len(sides) == 1 and all(abs(b) > max(error, BENDS_SURELY * std) for b, std in found)


def _bend(law: _Law, seen: _Seen, way: int) -> tuple[float, float]:
    """The bend that a law needs in a way, estimated beside all numbers, and its standard deviation
    over blocks of time. None where the bend takes up as little of what the law leaves as noise of
    the motion does, or where it is another number of the model (a constant has no exponent).
    """
    rest, _ = _rest(seen.own, seen, seen.wanted)
    bent = [s[0] * ways[way] for s, ways in zip(law.slopes, law.ways, strict=True)]
    along, _ = _rest(seen.own, seen, [x[0] for x in _as_seen(law, seen.band, bent)])
    weight = sum(float(x @ x) for x in along)
    if weight <= RIDGE * seen.energy:
        return 0.0, math.inf
    bend = sum(float(x @ r) for x, r in zip(along, rest, strict=True)) / weight
    if bend**2 * weight < TAKEN_UP * sum(float(r @ r) for r in rest):
        return 0.0, math.inf
    scores = [x * (r - bend * x) for x, r in zip(along, rest, strict=True)]
    sums, _ = energy_blocks(law.data, scores, law.joint, seen.band)
    return bend, deviation(sums) / weight


def _ahead(law: _Law, seen: _Seen, error: float) -> tuple[float, bool]:
    """The standard deviations by which a law predicts better than its neighbours, for one observer;
    and whether that observer can tell them apart: what the law leaves has less energy than the law.
    A neighbour may absorb some of what stays.
    """
    left = [r**2 for r in _rest(seen.own, seen, seen.wanted)[0]]
    worst = float("inf")
    for by in _neighbours(law.ways):
        bent = [s * factor for s, factor in zip(law.slopes, by, strict=True)]
        other, times = _rest(_as_seen(law, seen.band, bent), seen, seen.wanted)
        more = [b**2 - a for a, b in zip(left, other, strict=True)]
        sums, _ = energy_blocks(law.data, more, law.joint, seen.band)
        total, spread = float(sums.sum()), deviation(sums)
        same = abs(total) < error**2 * seen.energy  # on these recordings it equals the law
        # a neighbour that needs a larger factor imitates another number of the model
        if not same and times < LARGER:
            worst = min(worst, total / spread if spread > 0 else 0.0)
    return worst, sum(float(each.sum()) for each in left) <= seen.energy


def _used(record: JointRecord, band: float, turning: bool) -> npt.NDArray[np.bool_]:
    """The samples that count, (n,)."""
    use = np.zeros(record.n, bool)
    use[kept(record, band)] = True
    return use & counted(record, band, turning)


def _slopes(record: JointRecord, model: Model, term: Term) -> Array:
    """The torque of a law along the measured motion, and its derivative by each of its free
    numbers, (1 + numbers, n).
    """
    floor = TURNS_ROUND * float(np.abs(record.motion.states[1]).max())
    law = -trace(record, model, (term,), floor)
    rows = [law]
    for name, q in term.parameters.items():
        if q.free:
            step = SLOPE_STEP * max(abs(q.value), SLOPE_STEP)
            moved = {**term.parameters, name: replace(q, value=q.value + step)}
            there = replace(term, parameters=moved)
            rows.append((-trace(record, model, (there,), floor) - law) / step)
    return np.array(rows)


def _ways(record: JointRecord, law: Array, ranges: Ranges, common: bool) -> Array:
    """The ways in which a law of RMS 1 can be bent, (ways, n): it grows faster or slower than by
    the law (the logarithm of its size); along the travel; with speed (both from -1 to 1). For a law
    that every machine has the last two are laws themselves.
    """
    power: Array = np.log(np.maximum(np.abs(law), LEAST_LOG))
    if common:
        return power[None]
    q, v, _ = record.motion.states
    place = 2.0 * np.clip(unit(q, ranges.position), 0.0, 1.0) - 1.0
    speed = 2.0 * np.clip(np.abs(v) / ranges.speed, 0.0, 1.0) - 1.0
    return np.stack([power, place, speed])


def _neighbours(ways: Sequence[Array]) -> list[list[Array]]:
    """Factors, one array for each recording, by which each neighbour differs from a law."""
    power = [[np.exp(by * w[0]) for w in ways] for by in (0.5, -0.5)]
    return power + [
        [1.0 + by * w[k] for w in ways]
        for k in range(1, len(ways[0]))
        for by in (BENT_BY, -BENT_BY)
    ]


def _others(
    law: _Law, handles: Sequence[Handle], sizes: Array, band: float, lacks: Sequence[Array]
) -> list[Array]:
    """The derivative of the missing torque by every other free number, (numbers, n) for each
    recording.
    """
    x = get_values(law.model, handles)
    columns: list[list[Array]] = [[] for _ in lacks]
    for k, size in enumerate(sizes):
        there = x.copy()
        there[k] += SLOPE_STEP * size
        moved = lacking(law.data, set_values(law.model, handles, there), law.joint, band)
        for column, a, b in zip(columns, moved, lacks, strict=True):
            column.append((a - b) / SLOPE_STEP)
    return [
        np.array(c).reshape(len(handles), len(lack)) for c, lack in zip(columns, lacks, strict=True)
    ]


def _rest(
    shapes: Sequence[Array], seen: _Seen, wanted: Sequence[Array]
) -> tuple[list[Array], float]:
    """The remainder, (n,) for each recording, of a torque after a fit of ``shapes`` and all other
    numbers, 0 where it does not count; and the factor needed on the first shape.
    """
    rows = [np.concatenate(pair) for pair in zip(shapes, seen.others, strict=True)]
    count = len(rows[0])
    square, product = np.zeros((count, count)), np.zeros(count)
    for a, y, there in zip(rows, wanted, seen.use, strict=True):
        square, product = square + (a * there) @ a.T, product + a @ (y * there)
    scale = np.sqrt(np.diag(square))
    scale[scale == 0.0] = 1.0
    scaled = square / np.outer(scale, scale) + RIDGE * np.eye(count)
    theta = np.linalg.solve(scaled, product / scale) / scale
    rest = [(y - theta @ a) * there for a, y, there in zip(rows, wanted, seen.use, strict=True)]
    return rest, float(abs(theta[0])) if count else 0.0
