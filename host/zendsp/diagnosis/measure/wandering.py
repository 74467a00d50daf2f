"""Missing torque that is a friction whose level wanders with time, in each recording by itself."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import (
    BANDS,
    as_seen,
    deviation,
    energy_blocks,
    kept,
    lacking,
    mean_square,
)
from zendsp.diagnosis.measure.structure import Structure, counted, splines
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

PIECE = 2.5  # s of a spline over time: a friction that wanders takes seconds
TURN_S = 1.0  # s: what is fitted to and what is predicted take turns
SHRUNK = 1e-3  # of the mean square of the shapes
SIGN = 0.02  # of a joint's speed, over which friction changes its sign


def wanders(data: Data, model: Model, joint: int) -> Structure:
    """The part of the missing torque that follows the direction of motion, or the speed, with a
    level that changes with time. In each recording every other second is predicted from those
    between, and compared with a torque over time alone.

    A law of a friction over time says that its level is the same in every recording. The part that
    such a law leaves here follows something that differed between the recordings, such as the
    friction's own heat.
    """
    scale, best = mean_square(data, joint), Structure(0.0, 0.0, 0.0)
    for band in BANDS[:3]:
        gains = [
            _gain(rec[joint - 1], model, lack, band)
            for rec, lack in zip(data.records, lacking(data, model, joint, band), strict=True)
        ]
        sums, counts = energy_blocks(data, gains, joint, band)
        total, error = float(sums.sum()), deviation(sums)
        size = float(np.sqrt(max(0.0, total) / counts.sum() / scale))
        if size > best.size and error > 0.0:
            best = Structure(size, 0.0, total / error)
    return best


def _gain(record: JointRecord, model: Model, lack: Array, band: float) -> Array:
    """The gain of each sample when a friction over time predicts it, in place of a torque over
    time, (n,).
    """
    time = np.arange(record.n) * record.sample_time
    over = splines(time / max(time[-1], 1e-300), max(4, round(float(time[-1]) / PIECE)))
    _, v, _ = record.motion.states
    fast = max(float(np.quantile(np.abs(v), 0.98)), 1e-300)
    direction = np.tanh(v / (SIGN * fast))
    shapes = np.concatenate([over, direction * over, (v / fast) * over])
    seen = as_seen(record, model, band, shapes)
    use = np.zeros(record.n, bool)
    use[kept(record, band)] = True
    use &= counted(record, band, turning=False)
    first = np.floor(time / TURN_S) % 2 == 0
    errors = []
    for columns in (seen[: len(over)], seen):
        guess = np.zeros(record.n)
        for here, there in ((first, ~first), (~first, first)):
            guess[there] = _fitted(columns[:, use & here], lack[use & here]) @ columns[:, there]
        errors.append((lack - guess) ** 2)
    return np.where(use, errors[0] - errors[1], 0.0)


def _fitted(columns: Array, lack: Array) -> Array:
    """The numbers of the shapes (columns, n) that predict a torque (n,) best."""
    square = columns @ columns.T
    level = SHRUNK * float(np.trace(square)) / len(square)
    if not level > 0.0:
        return np.zeros(len(columns))
    found = np.linalg.solve(square + level * np.eye(len(square)), columns @ lack)
    return np.asarray(found, float)
