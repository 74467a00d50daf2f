"""Whether a law predicts better than its neighbours: the same torque, bent a little.

A law that a machine does not follow can still explain most of the missing torque. Its shape is then
wrong: the torque grows with the cube of the speed where the law has the square, or is smaller at
one end of the travel. A neighbour has as many numbers as the law, and no name. Where one predicts
better, the law is wrong (target and decoy, Elias and Gygi 2007).
"""

from __future__ import annotations

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
from zendsp.physics.calibration.predict import trace
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]

# difference of a neighbour from the law at the ends of the travel, or of the speeds; other values
# were not tried
BENT_BY = 0.7
SLOPE_STEP = 1e-3  # of a number's natural size, for slopes
TURNS_ROUND = 0.02  # of the speed: below, dry friction changes direction
LEAST_COUNTED = 0.1  # of a law's energy: with less, its shape is not seen
RIDGE = 1e-9  # of the mean square of a column
# largest factor on a neighbour's torque: drag that merges with the model's viscous friction needed
# 11 to 75, right ones at most 1.2
LARGER = 3.0


@dataclass(frozen=True)
class _Law:
    """A law and its neighbours, one array for each recording: slopes (1 + numbers, n) of the law,
    and factors (n,) by which each neighbour differs from it.
    """

    data: Data
    model: Model
    joint: int
    slopes: list[Array]
    bent: list[list[Array]]


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
        Standard deviations over blocks of time; of all observers the second lowest, since what a
        single one sees may be its own noise, or too few blocks. Below 0 a neighbour predicts
        better, by more than a law's possible error, and the unexplained torque is smaller than the
        law. Infinite where the law is no function of the state, has no neighbours different enough,
        or hardly acts where it counts.
    """
    slopes = [_slopes(rec[joint - 1], fitted.model, term) for rec in data.records]
    rms = float(np.sqrt(np.mean(np.concatenate([law[0] for law in slopes]) ** 2)))
    moving = [counted(rec[joint - 1], BANDS[0], turning) for rec in data.records]
    there = sum(float(law[0] ** 2 @ use) for law, use in zip(slopes, moving, strict=True))
    if there < LEAST_COUNTED * sum(float(law[0] @ law[0]) for law in slopes) or rms == 0.0:
        return float("inf")
    common = get_effect(term.effect).common
    bent = [
        _bent(rec[joint - 1], law[0] / rms, ranges_of(data, joint), common)
        for rec, law in zip(data.records, slopes, strict=True)
    ]
    law = _Law(data, fitted.model, joint, slopes, bent)
    handles = [
        h
        for h in joint_handles(fitted.data, fitted.model, joint)
        if not (h.place == "term" and fitted.model.terms[h.index] is term)
    ]
    sizes = bounds_and_steps(fitted.data, fitted.model, handles)[2]
    return sorted(_ahead(law, handles, sizes, band, error, turning) for band in BANDS)[1]


def _ahead(
    law: _Law,
    handles: Sequence[Handle],
    sizes: Array,
    band: float,
    error: float,
    turning: bool,
) -> float:
    """How far a law is ahead of its neighbours for one observer, in standard deviations."""
    data, joint = law.data, law.joint

    def seen(torques: Sequence[Array]) -> list[Array]:
        return [
            as_seen(rec[joint - 1], law.model, band, torque)
            for rec, torque in zip(data.records, torques, strict=True)
        ]

    own, lacks = seen(law.slopes), lacking(data, law.model, joint, band)
    others = _others(law, handles, sizes, band, lacks)
    wanted = [lack + made[0] for lack, made in zip(lacks, own, strict=True)]
    use = [_used(rec[joint - 1], band, turning) for rec in data.records]
    left, _ = _left_by(own, others, wanted, use)

    def behind(shapes: Sequence[Array]) -> tuple[float, float, float]:
        """The torque that some shapes leave beyond the law's: in standard deviations, and its
        energy; and the factor needed on the first shape.
        """
        other, times = _left_by(shapes, others, wanted, use)
        more = [b - a for a, b in zip(left, other, strict=True)]
        sums, _ = energy_blocks(data, more, joint, band)
        total, spread = float(sums.sum()), deviation(sums)
        return (total / spread if spread > 0 else 0.0), total, times

    energy = sum(float(made[0] ** 2 @ there) for made, there in zip(own, use, strict=True))
    worst = float("inf")
    for k in range(len(law.bent[0])):
        bent = seen([s * by[k] for s, by in zip(law.slopes, law.bent, strict=True)])
        z, more, times = behind(bent)
        same = abs(more) < error**2 * energy  # on these recordings it equals the law
        # a neighbour that needs a larger factor imitates another number of the model
        if not same and times < LARGER:
            worst = min(worst, z)
    if sum(float(each.sum()) for each in left) > energy:
        worst = max(worst, 0.0)  # a neighbour may absorb some of what stays
    return worst


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


def _bent(record: JointRecord, law: Array, ranges: Ranges, common: bool) -> list[Array]:
    """Factors, (n,) each, of the neighbours of a law of RMS 1: it grows faster or slower than by
    the law; along the travel; with speed. For a law that every machine has the last four are laws
    themselves.
    """
    size = np.abs(law)
    power = [np.sqrt(size), 1.0 / np.sqrt(np.maximum(size, 1e-3))]
    if common:
        return power
    q, v, _ = record.motion.states
    place = 2.0 * np.clip(unit(q, ranges.position), 0.0, 1.0) - 1.0
    speed = 2.0 * np.clip(np.abs(v) / ranges.speed, 0.0, 1.0) - 1.0
    ways = (BENT_BY, -BENT_BY)
    return power + [1.0 + bent * along for along in (place, speed) for bent in ways]


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


def _left_by(
    shapes: Sequence[Array],
    others: Sequence[Array],
    wanted: Sequence[Array],
    use: Sequence[npt.NDArray[np.bool_]],
) -> tuple[list[Array], float]:
    """Squares, (n,) for each recording, of the remainder of the ``wanted`` torque after a fit of
    ``shapes`` and all other numbers, 0 where it does not count; and the factor needed on the first
    shape.
    """
    rows = [np.concatenate(pair) for pair in zip(shapes, others, strict=True)]
    count = len(rows[0])
    square, product = np.zeros((count, count)), np.zeros(count)
    for a, y, there in zip(rows, wanted, use, strict=True):
        square, product = square + (a * there) @ a.T, product + a @ (y * there)
    scale = np.sqrt(np.diag(square))
    scale[scale == 0.0] = 1.0
    scaled = square / np.outer(scale, scale) + RIDGE * np.eye(count)
    theta = np.linalg.solve(scaled, product / scale) / scale
    left = [(y - theta @ a) ** 2 * there for a, y, there in zip(rows, wanted, use, strict=True)]
    return left, float(abs(theta[0])) if count else 0.0
