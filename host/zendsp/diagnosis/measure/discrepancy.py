"""The discrepancy: the torque that nothing named explains, how large it is, and what it depends on.

An observer that keeps a model on the measured motion corrects its velocity; that correction, as a
torque, is what the model lacks, whatever hidden states the model has. Part of it is sensor noise
that went through the observer: how much follows from the sensor's variance, by sending noise of
that variance the same way. What is larger is the discrepancy (Kennedy and O'Hagan 2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord, effective_inertia
from zendsp.physics.calibration.predict import damping_along, response, run
from zendsp.physics.kernel.smooth import widened
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

# rad/s of the observers; slower ones see less of a torque, and far less noise
BANDS = (64.0, 32.0, 16.0, 8.0)
# s, over which energies are summed before their variance is taken; less where there would be
ENERGY_BLOCK = 0.5
BLOCKS = 12  # fewer, but never less than an observer remembers
SETTLE = 0.4  # s, of the observers, at most a tenth of a recording
NOISE_DRAWS = 4  # of sensor noise
MODELS = 8  # of which a recording keeps what was worked out
NINE_IN_TEN = 1.28  # standard deviations
TURNING = 0.1  # of a joint's speed: below, it turns round
FASTEST = 0.98  # quantile that stands for a joint's speed: a few samples may be spikes


@dataclass(frozen=True)
class Size:
    """RMS torque as a part of the RMS torque of the recordings: the estimate, and where it lies
    with 95 % probability; ``often``: below it are the estimates of nine such recordings in ten.
    """

    value: float
    low: float
    high: float
    often: float = 0.0


@dataclass(frozen=True)
class Resisting:
    """What resists a torque along a recording in a model: inertia and damping, (n,) each.
    ``known``: what else was worked out of both.
    """

    model: Model
    inertia: Array
    damping: Array
    known: dict[Any, Any]


def resisting(record: JointRecord, model: Model) -> Resisting:
    """What resists a torque along a recording, worked out once for each of the latest models."""
    found: Resisting | None = record.resists.get(id(model))
    if found is None:
        found = Resisting(
            model, effective_inertia(record, model), damping_along(record, model), {}
        )
        record.resists[id(model)] = found  # keeps the model, so that no other gets its id
        while len(record.resists) > MODELS:
            record.resists.pop(list(record.resists)[0], None)  # noqa: RUF015  as in ``run``
    return found


def band_of(record: JointRecord, band: float) -> float:
    """The observer's bandwidth that a recording's sample time allows, rad/s."""
    return min(band, 0.25 / record.sample_time)


def as_torque(record: JointRecord, model: Model, innovations: Array, band: float) -> Array:
    """Torque by which an observer with such weighted innovations corrects a model, (..., n), N m or
    N; its own delay taken out.
    """
    factor, lag = correction(record, model, band)
    n = innovations.shape[-1]
    moved = np.empty_like(innovations)
    np.multiply(innovations[..., lag:], factor[lag:], out=moved[..., : n - lag])
    moved[..., n - lag :] = 0.0
    return moved


def correction(record: JointRecord, model: Model, band: float) -> tuple[Array, int]:
    """Torque by which an observer corrects a model for a unit of weighted innovation, (n,), and
    the samples by which it is late.

    An error of speed that lasts is corrected in the position too: the model's damping resists it.
    """
    _, k2, w = record.gains(band)
    of = resisting(record, model)
    resists = of.inertia + np.sqrt(2.0) * of.damping / band
    factor = np.where(w > 0, k2 / np.maximum(w, 1e-300), 0.0) * resists / record.sample_time
    return -factor, correction_lag(record, band)


def correction_lag(record: JointRecord, band: float) -> int:
    """Samples by which an observer's correction is late."""
    return min(record.n, round(math.sqrt(2.0) / band / record.sample_time))


def as_seen(
    record: JointRecord,
    model: Model,
    band: float,
    raw: npt.NDArray[np.floating[Any]],
    *,
    on_sensor: bool = False,
    rows: npt.NDArray[np.int32] | None = None,
) -> Array:
    """Torques over time, (m, n), as an observer of a band sees them; ``on_sensor``: what it takes
    for torques of what the sensor adds to the position. ``rows``: the samples that are wanted,
    ascending, of those that are ``kept``.
    """
    here, of = band_of(record, band), resisting(record, model)
    then = correction(record, model, here)
    return response(
        record, here, of.inertia, of.damping, raw, on_sensor=on_sensor, then=then, rows=rows
    )


def lacking(data: Data, model: Model, joint: int, band: float) -> list[Array]:
    """Torque that a model lacks, one array (n,) a recording, N m or N."""
    out = []
    for rec in data.records:
        record = rec[joint - 1]
        here = band_of(record, band)
        r = run(record, model, here, inner=data.inner).innovations
        out.append(as_torque(record, model, np.clip(r, -1e6, 1e6), here))
    return out


def lasting(record: JointRecord, torque: Array, band: float) -> Array:
    """What an observer takes for torques, (..., n), each correction as the torque that lasted since
    the one before. On a plateau of the encoder there is none, and the change of the code makes up
    for all of it at once: its square says nothing of the torque.
    """
    said = record.counted
    if bool(said.all()):
        return torque
    lag = correction_lag(record, band)
    since = np.r_[0, np.cumsum(said)[:-1]]  # samples up to a correction, and it, are of one kind
    since = np.r_[since[lag:], np.arange(lag) + since[-1] + 1]
    length = np.bincount(since)[since]
    rows = torque.reshape(-1, record.n)
    even = [np.bincount(since, row)[since] / length for row in rows]
    return np.asarray(even).reshape(torque.shape)


def kept(record: JointRecord, band: float) -> slice:
    """Samples of a recording after its observer has settled."""
    lag = round(np.sqrt(2) / band_of(record, band) / record.sample_time)
    skip = min(record.n // 10, round(max(SETTLE, 4.0 / band) / record.sample_time))
    return slice(skip, max(skip + 1, record.n - lag))


def noise(record: JointRecord, model: Model, band: float, *, even: bool = False) -> float:
    """Mean square of the torque that the sensor's noise alone makes, (N m)² or N²; and what the
    command does between rows. ``even``: as ``lasting`` sees it.
    """
    known = resisting(record, model).known
    if ("noise", band, even) not in known:
        known["noise", band, even] = _noise(record, model, band, even)
    value: float = known["noise", band, even]
    return value


def _noise(record: JointRecord, model: Model, band: float, even: bool) -> float:
    """As ``noise``, worked out."""
    rng, shape = np.random.default_rng(0), (NOISE_DRAWS, record.n)
    draws = rng.standard_normal(shape)
    draws *= np.sqrt(np.maximum(record.measurement.variance, 0.0))
    seen = as_seen(record, model, band, draws, on_sensor=True)
    if record.between > 0.0:
        draws = rng.standard_normal(shape)
        seen = np.stack([seen, as_seen(record, model, band, record.between * draws)])
    seen = lasting(record, seen, band_of(record, band)) if even else seen
    squares = np.asarray(seen[..., kept(record, band)] ** 2)
    return float(np.mean(squares)) * (2.0 if record.between > 0.0 else 1.0)


def energy_blocks(
    data: Data, squares: Sequence[Array], joint: int, band: float
) -> tuple[Array, Array]:
    """Sums over blocks of time of some series, one a recording, and the number of samples in each
    block.
    """
    sums, counts = [], []
    seconds = sum(rec[joint - 1].n * rec[joint - 1].sample_time for rec in data.records)
    block = max(min(ENERGY_BLOCK, seconds / BLOCKS), 8.0 / band)
    for series, rec in zip(squares, data.records, strict=True):
        record = rec[joint - 1]
        use = series[kept(record, band)]
        size = max(10, round(block / record.sample_time))
        count = max(1, len(use) // size)
        for part in np.array_split(use, count):
            sums.append(float(part.sum()))
            counts.append(len(part))
    return np.array(sums), np.array(counts, float)


def deviation(values: Array) -> float:
    """Standard deviation of the sum of a series whose neighbours resemble each other (Newey and
    West 1987).
    """
    n = len(values)
    if n < 3:
        return float("inf")
    x = values - values.mean()
    total = float(x @ x)
    lags = max(1, round(0.75 * n ** (1 / 3)))
    for k in range(1, lags + 1):
        total += 2.0 * (1.0 - k / (lags + 1.0)) * float(x[k:] @ x[:-k])
    return float(np.sqrt(max(total, 0.1 * float(x @ x)) * n / (n - 1)))


def discrepancy(data: Data, model: Model, joint: int) -> Size:
    """How large the torque is that a model leaves unexplained at a joint.

    Parameters
    ----------
    data : Data
        Recordings; only those that neither the fit nor a choice has touched give an honest figure.
    joint : int
        1-based.

    Returns
    -------
    Size
        Of several observers the one that shows most beyond its own uncertainty decides; the fastest
        sees most of a torque, and says how large it may be at most. Where that is less than another
        shows, the noise is less than the model of the sensor says, and the other says it.
    """
    scale = mean_square(data, joint)
    best, own = Size(0.0, 0.0, 0.0), 0.0  # own: at most, by the observer that shows most
    for band in BANDS:
        found = _lasting(data, model, joint, band)
        of_sensor = [noise(rec[joint - 1], model, band, even=True) for rec in data.records]
        excess = [d**2 - v for d, v in zip(found, of_sensor, strict=True)]
        sums, counts = energy_blocks(data, excess, joint, band)
        total, error = float(sums.sum()), deviation(sums)
        mean, chance = total / counts.sum() / scale, error / counts.sum() / scale
        # what the noise model itself may be wrong by
        spread = float(np.hypot(chance, 0.1 * float(np.mean(of_sensor)) / scale))
        by_chance = NINE_IN_TEN * chance - spread if math.isfinite(chance) else -spread
        at = (mean - spread, mean - 2.0 * spread, mean + 2.0 * spread, mean + by_chance)
        value, low, high, often = (math.sqrt(max(0.0, x)) for x in at)
        own = high if value > best.value else own
        most = high if band == BANDS[0] else best.high
        best = Size(max(best.value, value), max(best.low, low), most, max(best.often, often))
    return best if best.high > best.value else replace(best, high=max(own, best.value))


def _lasting(data: Data, model: Model, joint: int, band: float) -> list[Array]:
    """``lacking``, as ``lasting`` sees it."""
    return [
        lasting(rec[joint - 1], lack, band_of(rec[joint - 1], band))
        for lack, rec in zip(lacking(data, model, joint, band), data.records, strict=True)
    ]


def beyond(size: float, known: float) -> float:
    """What of an RMS torque is more than what is known to stay unexplained."""
    return float(np.sqrt(max(size**2 - known**2, 0.0)))


def falls(data: Data, without: Model, having: Model, joint: int, least: float) -> bool:
    """Whether having a term may make the energy of what lacks less by a part ``least`` of the
    energy of the term's own torque, as slow observers see it and as fast ones: so it does where
    that torque lacks. (The sensor's noise cancels, whatever its size.)
    """
    for band in BANDS:
        pairs = zip(
            _lasting(data, without, joint, band), _lasting(data, having, joint, band), strict=True
        )
        spare = [a**2 - b**2 - least * (a - b) ** 2 for a, b in pairs]
        sums, _ = energy_blocks(data, spare, joint, band)
        if float(sums.sum()) + 2.0 * deviation(sums) < 0.0:
            return False
    return True


def difference(data: Data, one: Model, other: Model, joint: int, band: float = BANDS[0]) -> float:
    """RMS torque between two models along the recordings, as a part of the RMS torque; the sensor's
    noise cancels.
    """
    total = count = 0.0
    pairs = zip(
        _lasting(data, one, joint, band),
        _lasting(data, other, joint, band),
        data.records,
        strict=True,
    )
    for a, b, rec in pairs:
        use = kept(rec[joint - 1], band)
        total += float(np.sum((a[use] - b[use]) ** 2))
        count += len(a[use])
    return float(np.sqrt(total / max(count, 1.0) / mean_square(data, joint)))


def reversals(record: JointRecord, band: float) -> npt.NDArray[np.bool_]:
    """Where a joint turns round, (n,): below a tenth of its speed, and as long before and after as
    an observer remembers.
    """
    speed = np.abs(record.motion.states[1])
    slow = speed < TURNING * float(np.quantile(speed[kept(record, band)], FASTEST))
    around = max(1, round(2.0 / band / record.sample_time))
    return widened(slow, around)


def at_reversals(data: Data, one: Model, other: Model, joint: int) -> float:
    """Part of the energy of the torque between two models that acts where the joint turns round,
    beyond the part of the time that it does: 0 for what acts always, 1 for what acts only there,
    and where the joint does nothing else.
    """
    band = BANDS[0]
    pairs = zip(
        lacking(data, one, joint, band),
        lacking(data, other, joint, band),
        data.records,
        strict=True,
    )
    there = total = turning = count = 0.0
    for a, b, rec in pairs:
        record = rec[joint - 1]
        use = kept(record, band)
        energy, turns = (a[use] - b[use]) ** 2, reversals(record, band)[use]
        there += float(energy[turns].sum())
        total += float(energy.sum())
        turning += float(turns.sum())
        count += len(turns)
    if turning >= count:
        return 1.0
    time = turning / count
    return (there / max(total, 1e-300) - time) / (1.0 - time)


def mean_square(data: Data, joint: int) -> float:
    """Mean square of the torque at a joint over recordings."""
    total = sum(rec[joint - 1].scale.torque ** 2 * rec[joint - 1].n for rec in data.records)
    return max(total / max(sum(rec[0].n for rec in data.records), 1), 1e-300)
