"""The fit that a person can read: position error of short free simulations, given, calibrated and
improved.

Each window restarts from the smoothed motion; what its unknown initial position and velocity
explain (a straight line) is removed, for all models alike. A perfect model leaves the sensor's own
noise: the noise floor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

WINDOW = 0.25  # s
MOST_STEPS = 64  # of the simulation within a sample
AWAY = 100.0  # rad or m: no joint goes that far within a window


def window_error(data: Data, model: Model, joint: int) -> Array:
    """Position error within windows, all recordings one after the other, rad or m; of a simulation
    that ran away, the joint's travel.
    """
    parts = []
    for rec in data.records:
        record = rec[joint - 1]
        size = max(16, round(WINDOW / record.sample_time))
        r = _free(record, model, data.bandwidth[joint - 1], max(data.inner, 4), size)
        travel = float(np.ptp(record.motion.states[0]))
        r = np.nan_to_num(np.clip(r, -travel, travel), nan=travel)
        count = record.n // size
        if not count:
            continue
        blocks = r[: count * size].reshape(count, size)
        x = np.linspace(-1.0, 1.0, size)
        level = blocks.mean(axis=1, keepdims=True)
        slope = blocks @ x / (x @ x)
        parts.append((blocks - level - slope[:, None] * x).ravel())
    return np.concatenate(parts) if parts else np.zeros(1)


def _free(record: JointRecord, model: Model, bandwidth: float, inner: int, size: int) -> Array:
    """Innovations of free windows; with shorter steps where the simulation runs away: viscous
    friction on next to no inertia is faster than the usual ones.
    """
    while True:
        r = run(record, model, bandwidth, inner=inner, free_every=size).innovations
        if inner >= MOST_STEPS or np.abs(r).max(initial=0.0) < AWAY:  # NaN: shorter
            return r
        inner *= 4


def standing_out(data: Data, errors: Array, others: Array, joint: int) -> float:
    """By how many standard deviations of chance the squares of some errors, as ``window_error``
    gives them, are expected to exceed those of others that are noise.
    """
    size = max(16, round(WINDOW / data.records[0][joint - 1].sample_time))
    change = errors - others
    by_chance = np.add.reduceat(2.0 * others * change, np.arange(0, len(change), size))
    return float(change @ change) / max(float(np.linalg.norm(by_chance)), 1e-300)


def rms(values: Array) -> float:
    """Root mean square; infinite where the simulation ran away."""
    value = float(np.sqrt(np.mean(np.minimum(values**2, 1e12))))
    return value if np.isfinite(value) else float("inf")


def model_error(data: Data, model: Model, joints: Sequence[int] = ()) -> float:
    """RMS over all recordings and over some joints, or all of them, rad or m."""
    some = joints or range(1, data.joints + 1)
    return rms(np.concatenate([window_error(data, model, j) for j in some]))


def noise_floor(data: Data, *joints: int) -> float:
    """What the sensor alone leaves in such windows: quantisation and noise, rad or m (RMS); of some
    joints, or of all.
    """
    squares, count = 0.0, 0
    for rec in data.records:
        for record in [rec[j - 1] for j in joints] or rec:
            m = record.measurement
            size = max(16, round(WINDOW / record.sample_time))
            left = 1.0 - 2.0 / size
            if m.resolution > 0:
                squares += (
                    record.n
                    * left
                    * _quantisation(record.position, record.motion.states[0], size) ** 2
                )
            else:
                squares += record.n * left * m.noise**2
            count += record.n
    return float(np.sqrt(squares / max(count, 1)))


def _quantisation(y: Array, smooth: Array, size: int) -> float:
    """RMS of measured minus smoothed position within windows, straight lines removed."""
    count = len(y) // size
    if not count:
        return float(np.std(y - smooth))
    blocks = (y - smooth)[: count * size].reshape(count, size)
    x = np.linspace(-1.0, 1.0, size)
    blocks = blocks - blocks.mean(axis=1, keepdims=True)
    blocks = blocks - (blocks @ x / (x @ x))[:, None] * x
    return rms(blocks.ravel())
