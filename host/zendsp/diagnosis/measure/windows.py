"""The position error of short free simulations, for people to read: of the given, calibrated and
improved model.

Each window restarts from the smoothed motion. A straight line, for the unknown initial position and
velocity, is removed alike for all models. A perfect model leaves the sensor's own noise: the noise
floor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import resisting
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import run
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

WINDOW = 0.25  # s
FEWEST_ROWS = 16  # rows of a window, where rows are seldom
MOST_STEPS = 64  # of the simulation within a sample
AWAY = 100.0  # rad or m: no joint goes that far within a window


def rows_of(sample_time: float) -> int:
    """The rows of a window."""
    return max(FEWEST_ROWS, round(WINDOW / sample_time))


def seconds_of(data: Data) -> float:
    """The length of the windows, s; of recordings at several rates, the longest."""
    return max(WINDOW, *(FEWEST_ROWS * rec[0].sample_time for rec in data.records))


def window_error(data: Data, model: Model, joint: int) -> Array:
    """The position error within windows, all recordings one after the other, rad or m; where a
    simulation diverged, the joint's travel.
    """
    parts = []
    for rec in data.records:
        record = rec[joint - 1]
        size = rows_of(record.sample_time)
        r = _free(record, model, data.bandwidth[joint - 1], max(data.inner, 4), size)
        travel = float(np.ptp(record.motion.states[0]))
        r = np.nan_to_num(np.clip(r, -travel, travel), nan=travel)
        count = record.n // size
        if not count:
            continue
        parts.append(_bent(r[: count * size].reshape(count, size)).ravel())
    return np.concatenate(parts) if parts else np.zeros(1)


def _free(record: JointRecord, model: Model, bandwidth: float, inner: int, size: int) -> Array:
    """Innovations of free windows, with shorter steps where the simulation diverges: viscous
    friction on hardly any inertia is too fast for the usual steps.
    """
    while True:
        r = run(record, model, bandwidth, inner=inner, free_every=size).innovations
        if inner >= MOST_STEPS or np.abs(r).max(initial=0.0) < AWAY:  # NaN: shorter
            return r
        inner *= 4


def standing_out(data: Data, errors: Array, others: Array, joint: int) -> float:
    """The expected excess of the squares of some errors of ``window_error`` over those of others
    that are noise, in standard deviations.
    """
    size = rows_of(data.records[0][joint - 1].sample_time)
    change = errors - others
    by_chance = np.add.reduceat(2.0 * others * change, np.arange(0, len(change), size))
    return float(change @ change) / max(float(np.linalg.norm(by_chance)), 1e-300)


def rms(values: Array) -> float:
    """Root mean square; infinite where the simulation diverged."""
    value = float(np.sqrt(np.mean(np.minimum(values**2, 1e12))))
    return value if np.isfinite(value) else float("inf")


def model_error(data: Data, model: Model, joints: Sequence[int] = ()) -> float:
    """RMS position error over all recordings and some or all joints, rad or m."""
    some = joints or range(1, data.joints + 1)
    return rms(np.concatenate([window_error(data, model, j) for j in some]))


def noise_floor(data: Data, *joints: int) -> float:
    """The RMS error in windows from the sensor alone (quantisation and noise), rad or m; over some
    joints, or all.
    """
    squares, count = 0.0, 0
    for rec in data.records:
        for record in [rec[j - 1] for j in joints] or rec:
            m = record.measurement
            size = rows_of(record.sample_time)
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


def least_error(data: Data, model: Model, *joints: int) -> float:
    """The RMS error in windows of a perfect model, rad or m: of the sensor, and of commands between
    rows that nobody saw, which drive the joint away from any model; over some joints, or all.
    """
    squares, count = 0.0, 0
    for rec in data.records:
        for record in [rec[j - 1] for j in joints] or rec:
            squares += _by_commands(record, model)
            count += record.n
    return math.hypot(noise_floor(data, *joints), math.sqrt(squares / max(count, 1)))


def mostly_below(data: Data, model: Model, joint: int) -> float:
    """The frequency, Hz, below which nine tenths of the energy of the position error within windows
    lie.
    """
    step, errors = data.records[0][joint - 1].sample_time, window_error(data, model, joint)
    size = rows_of(step)
    if len(errors) % size or any(rec[joint - 1].sample_time != step for rec in data.records):
        return math.nan  # recordings at several rates
    blocks = errors.reshape(-1, size) * np.hanning(size)
    energy = np.cumsum((np.abs(np.fft.rfft(blocks, 4 * size)) ** 2).sum(axis=0))
    at = int(np.searchsorted(energy, 0.9 * energy[-1]))
    return float(np.fft.rfftfreq(4 * size, step)[at])


def _by_commands(record: JointRecord, model: Model) -> float:
    """The sum of squares of the position error within windows by unknown commands."""
    size = rows_of(record.sample_time)
    count = record.n // size
    if not (record.between > 0.0 and count):
        return 0.0
    of = resisting(record, model)
    shape = count, size
    inertia, damping = (x[: count * size].reshape(shape) for x in (of.inertia, of.damping))
    pushed = record.between * np.random.default_rng(0).standard_normal(shape) / inertia
    speed, error = np.zeros(count), np.zeros(shape)
    keeps = np.exp(-record.sample_time * np.maximum(damping / inertia, 0.0))
    for k in range(1, size):
        error[:, k] = error[:, k - 1] + record.sample_time * speed
        speed = keeps[:, k] * (speed + record.sample_time * pushed[:, k])
    return record.n * rms(_bent(error).ravel()) ** 2


def _bent(blocks: Array) -> Array:
    """What straight lines leave of windows, (count, size)."""
    x = np.linspace(-1.0, 1.0, blocks.shape[1])
    blocks = blocks - blocks.mean(axis=1, keepdims=True)
    return blocks - (blocks @ x / (x @ x))[:, None] * x


def _quantisation(y: Array, smooth: Array, size: int) -> float:
    """RMS of measured minus smoothed position within windows, straight lines removed."""
    count = len(y) // size
    if not count:
        return float(np.std(y - smooth))
    return rms(_bent((y - smooth)[: count * size].reshape(count, size)).ravel())
