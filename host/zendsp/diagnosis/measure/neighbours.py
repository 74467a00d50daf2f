"""Whether a law predicts better than its neighbours: the same torque, bent a little.

A law that a machine does not follow can still explain most of what lacks; what is wrong with it is
then how it goes on: with the cube of the speed where it says the square, less at one end of the
travel. A neighbour has as many numbers as the law and nobody's name. Where one predicts better, the
law is not what acts (target and decoy, Elias and Gygi 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    deviation,
    energy_blocks,
    kept,
    lacking,
)
from zendsp.diagnosis.measure.structure import as_seen, counted, ranges_of, unit
from zendsp.physics.calibration.fit import Data, bounds_and_steps, joint_handles
from zendsp.physics.calibration.handles import get_values, set_values
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import trace
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]

BENT = 0.7  # by how much a neighbour differs at the ends of the travel, or of the speeds
STEP = 1e-3  # of a number's natural size, for slopes
SLOW = 0.02  # of the speed: below, dry friction turns round
RIDGE = 1e-9  # of the mean square of a column


def against_neighbours(
    parts: Sequence[Data],
    fitted: Data,
    model: Model,
    term: Term,
    joint: int,
    turning: bool = True,
) -> float:
    """By how much a law predicts better than the best of its neighbours.

    Parameters
    ----------
    parts : sequence of Data
        All recordings: law and neighbours have as many numbers, so neither gains by being fitted.
    fitted : Data
        What ``model`` was fitted to.
    model : Model
        With the law, and without what only refines it.
    term : Term
        The law, one of the terms of ``model``.
    joint : int
        1-based.
    turning : bool
        Whether what acts where the joint turns round counts.

    Returns
    -------
    float
        Standard deviations over blocks of time, in the median over observers; below 0 a neighbour
        predicts better. Infinite where the law is no function of the state, and has no neighbours.
    """
    whole = replace(parts[0], records=tuple(r for part in parts for r in part.records))
    laws = [_slopes(rec[joint - 1], model, term) for rec in whole.records]
    rms = float(np.sqrt(np.mean(np.concatenate([law[0] for law in laws]) ** 2)))
    if rms == 0.0:
        return float("inf")
    bent = [
        _bent(rec[joint - 1], law[0] / rms, whole, joint, get_effect(term.effect).common)
        for rec, law in zip(whole.records, laws, strict=True)
    ]
    ahead: list[list[float]] = []
    for band in BANDS[:3]:

        def seen(torques: Sequence[Array], band: float = band) -> list[Array]:
            return [
                as_seen(rec[joint - 1], model, band, torque)
                for rec, torque in zip(whole.records, torques, strict=True)
            ]

        others = _others(whole, fitted, model, term, joint, band)
        law = seen(laws)
        wanted = [
            lack + own[0] for lack, own in zip(lacking(whole, model, joint, band), law, strict=True)
        ]
        use = [_used(rec[joint - 1], band, turning) for rec in whole.records]
        error = _left_by(law, others, wanted, use)
        ahead.append([])
        for k in range(len(bent[0])):
            neighbour = seen([slopes * by[k] for slopes, by in zip(laws, bent, strict=True)])
            theirs = _left_by(neighbour, others, wanted, use)
            gain = [b - a for a, b in zip(error, theirs, strict=True)]
            sums, _ = energy_blocks(whole, gain, joint, band)
            spread = deviation(sums)
            ahead[-1].append(float(sums.sum()) / spread if spread > 0 else 0.0)
    return float(np.min(np.median(ahead, axis=0)))


def _used(record: JointRecord, band: float, turning: bool) -> npt.NDArray[np.bool_]:
    """Samples that count, (n,)."""
    use = np.zeros(record.n, bool)
    use[kept(record, band)] = True
    return use & counted(record, band, turning)


def _slopes(record: JointRecord, model: Model, term: Term) -> Array:
    """Torque of a law along the measured motion, and how it changes with each of its free numbers,
    (1 + numbers, n).
    """
    floor = SLOW * float(np.abs(record.motion.states[1]).max())
    law = -trace(record, model, (term,), floor)
    rows = [law]
    for name, q in term.parameters.items():
        if q.free:
            step = STEP * max(abs(q.value), STEP)
            moved = {**term.parameters, name: replace(q, value=q.value + step)}
            there = replace(term, parameters=moved)
            rows.append((-trace(record, model, (there,), floor) - law) / step)
    return np.array(rows)


def _bent(record: JointRecord, law: Array, whole: Data, joint: int, common: bool) -> list[Array]:
    """Factors, (n,) each, by which neighbours differ from a law of RMS 1: it grows faster or slower
    than by the law; along the travel; with speed. The last four of a law that every machine has are
    laws themselves.
    """
    size = np.abs(law)
    power = [np.sqrt(size), 1.0 / np.sqrt(np.maximum(size, 1e-3))]
    if common:
        return power
    ranges = ranges_of(whole, joint)
    q, v, _ = record.motion.states
    place = 2.0 * np.clip(unit(q, ranges.position), 0.0, 1.0) - 1.0
    speed = 2.0 * np.clip(np.abs(v) / ranges.speed, 0.0, 1.0) - 1.0
    return power + [1.0 + sign * BENT * along for along in (place, speed) for sign in (1.0, -1.0)]


def _others(
    whole: Data, fitted: Data, model: Model, term: Term, joint: int, band: float
) -> list[Array]:
    """How what lacks changes with every other free number, (numbers, n) a recording."""
    handles = [
        h
        for h in joint_handles(fitted, model, joint)
        if not (h.place == "term" and model.terms[h.index] is term)
    ]
    now, x = lacking(whole, model, joint, band), get_values(model, handles)
    columns: list[list[Array]] = [[] for _ in now]
    for k, size in enumerate(bounds_and_steps(fitted, model, handles)[2]):
        there = x.copy()
        there[k] += STEP * size
        moved = lacking(whole, set_values(model, handles, there), joint, band)
        for column, a, b in zip(columns, moved, now, strict=True):
            column.append((a - b) / STEP)
    return [np.array(c).reshape(len(handles), -1) for c in columns]


def _left_by(
    shapes: Sequence[Array],
    others: Sequence[Array],
    wanted: Sequence[Array],
    use: Sequence[npt.NDArray[np.bool_]],
) -> list[Array]:
    """Squares, (n,) a recording, of what stays of the ``wanted`` torque once ``shapes`` and all
    other numbers are fitted to it; 0 where it does not count.
    """
    rows = [np.concatenate(pair) for pair in zip(shapes, others, strict=True)]
    count = len(rows[0])
    square, product = np.zeros((count, count)), np.zeros(count)
    for a, y, there in zip(rows, wanted, use, strict=True):
        square, product = square + (a * there) @ a.T, product + a @ (y * there)
    scale = np.sqrt(np.diag(square)) + 1e-300
    theta = np.linalg.solve(
        square / np.outer(scale, scale) + RIDGE * np.eye(count), product / scale
    )
    return [
        (y - (theta / scale) @ a) ** 2 * there
        for a, y, there in zip(rows, wanted, use, strict=True)
    ]
