"""The discrepancy: the size of the torque that nothing named explains.

An observer that keeps a model on the measured motion corrects its velocity. That correction, as a
torque, is the missing torque, whatever hidden states the model has. A part of it is sensor noise
that passed through the observer; its size follows by sending noise of the sensor's variance through
the same observer. The rest is the discrepancy (Kennedy and O'Hagan 2001).
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
from zendsp.physics.calibration.observed import damping_along, response
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.smooth import widened
from zendsp.physics.model import Model
from zendsp.physics.robots.rigid import Basis

Array = npt.NDArray[np.float64]

# rad/s, of the observers; slower ones see less of a torque, and far less noise
BANDS = (64.0, 32.0, 16.0, 8.0)
# s, of blocks over which energy is summed before its variance is taken; shorter where there would
# be
ENERGY_BLOCK = 0.5
BLOCKS = 12  # fewer, but never less than an observer remembers
SETTLE = 0.4  # s, of the observers, at most a tenth of a recording
NOISE_DRAWS = 4  # of sensor noise
MODELS = 8  # models whose results a recording keeps
NINE_IN_TEN = 1.28  # standard deviations
TURNING = 0.1  # of a joint's speed: slower is a reversal
FASTEST = 0.98  # quantile used as a joint's speed, since a few samples may be spikes


@dataclass(frozen=True)
class Size:
    """An RMS torque as a part of that of the recordings: the estimate and its 95 % interval.
    ``often``: the estimates of nine in ten such recordings are below it. ``shown``: the estimate by
    an observer that surely sees something at all; infinite where nobody asked.
    """

    value: float
    low: float
    high: float
    often: float = 0.0
    shown: float = math.inf


@dataclass(frozen=True)
class Resisting:
    """Inertia and damping of a model along a recording, (n,) each, which resist a torque.
    ``known``: results computed from both.
    """

    model: Model
    inertia: Array
    damping: Array
    known: dict[Any, Any]


def resisting(record: JointRecord, model: Model) -> Resisting:
    """Inertia and damping along a recording, computed once for each of the latest models."""
    found: Resisting | None = record.resists.pop(id(model), None)
    if found is None:
        found = Resisting(
            model, effective_inertia(record, model), damping_along(record, model), {}
        )
    record.resists[id(model)] = found  # the latest; keeps the model, so that no other gets its id
    while len(record.resists) > MODELS:
        record.resists.pop(list(record.resists)[0], None)  # noqa: RUF015  as in ``run``
    return found


def band_of(record: JointRecord, band: float) -> float:
    """The observer's bandwidth that a recording's sample time allows, rad/s."""
    return min(band, 0.25 / record.sample_time)


def as_torque(record: JointRecord, model: Model, innovations: Array, band: float) -> Array:
    """The torque by which an observer corrects a model, from its weighted innovations, (..., n), N
    m or N; without the observer's delay.
    """
    factor, lag = correction(record, model, band)
    n = innovations.shape[-1]
    moved = np.empty_like(innovations)
    np.multiply(innovations[..., lag:], factor[lag:], out=moved[..., : n - lag])
    moved[..., n - lag :] = 0.0
    return moved


def correction(record: JointRecord, model: Model, band: float) -> tuple[Array, int]:
    """The torque by which an observer corrects a model per unit of weighted innovation, (n,), and
    the observer's delay in samples.

    A lasting error of speed is corrected in the position too, against the model's damping.
    """
    of = resisting(record, model)
    if ("correction", band) not in of.known:
        _, k2, w = record.gains(band)
        resists = of.inertia + np.sqrt(2.0) * of.damping / band
        factor = np.where(w > 0, k2 / np.maximum(w, 1e-300), 0.0) * resists / record.sample_time
        of.known["correction", band] = -factor
    return of.known["correction", band], correction_lag(record, band)


def correction_lag(record: JointRecord, band: float) -> int:
    """The delay of an observer's correction in samples."""
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
    """Torques over time, (m, n), as an observer of a band sees them. ``on_sensor``: they are
    additions to the measured position, which the observer takes for torques. ``rows``: the wanted
    samples, ascending, among the ``kept`` ones.
    """
    here, of = band_of(record, band), resisting(record, model)
    then = correction(record, model, here)
    return response(
        record, here, of.inertia, of.damping, raw, on_sensor=on_sensor, then=then, rows=rows
    )


def lacking(data: Data, model: Model, joint: int, band: float) -> list[Array]:
    """The missing torque of a model, one array (n,) for each recording, N m or N."""
    out = []
    for rec in data.records:
        record = rec[joint - 1]
        here = band_of(record, band)
        r = run(record, model, here, inner=data.inner, begun=True).innovations
        out.append(as_torque(record, model, np.clip(r, -1e6, 1e6), here))
    return out


def lasting(record: JointRecord, torque: Array, band: float) -> Array:
    """An observer's torques, (..., n), with each correction spread over the time since the one
    before. On a plateau of the encoder there is no correction; the next change of the count then
    corrects all at once, and its square would overstate the torque.
    """
    said = record.counted
    if bool(said.all()):
        return torque
    lag = correction_lag(record, band)
    since = np.r_[0, np.cumsum(said)[:-1]]  # numbers of the spans between corrections
    since = np.r_[since[lag:], np.arange(lag) + since[-1] + 1]
    length = np.bincount(since)[since]
    rows = torque.reshape(-1, record.n)
    even = [np.bincount(since, row)[since] / length for row in rows]
    return np.asarray(even).reshape(torque.shape)


def kept(record: JointRecord, band: float) -> slice:
    """The samples of a recording after its observer has settled."""
    lag = round(np.sqrt(2) / band_of(record, band) / record.sample_time)
    skip = min(record.n // 10, round(max(SETTLE, 4.0 / band) / record.sample_time))
    return slice(skip, max(skip + 1, record.n - lag))


def noise(record: JointRecord, model: Model, band: float, *, even: bool = False) -> float:
    """The mean square of the torque that noise of all joints' sensors and unknown commands between
    rows alone cause, (N m)² or N². ``even``: after ``lasting``.
    """
    known = resisting(record, model).known
    if ("noise", band, even) not in known:
        known["noise", band, even] = _noise(record, model, band, even)
    value: float = known["noise", band, even]
    return value


def _noise(record: JointRecord, model: Model, band: float, even: bool) -> float:
    """The result of ``noise``, computed."""
    draws = np.random.default_rng(0).standard_normal((NOISE_DRAWS, record.n))
    draws *= np.sqrt(np.maximum(record.measurement.variance, 0.0))
    seen = as_seen(record, model, band, draws, on_sensor=True)
    own = _energy(record, seen, band, even) + _of_commands(record, model, band, even)
    if record.beside is None:
        return own
    # without it the wrist of an arm, whose elbow had an encoder eight times coarser, lacked 1.4 %
    others = _felt_behind(record, model, band, record.beside)
    if others is None:
        others = as_seen(record, model, band, record.beside[np.newaxis])
    return own + _energy(record, others, band, even)


def _of_commands(record: JointRecord, model: Model, band: float, even: bool) -> float:
    """The mean square of the torque that an observer sees of unknown commands between rows, (N m)²
    or N².
    """
    if not record.between > 0.0:
        return 0.0
    draws = record.between * np.random.default_rng(1).standard_normal((NOISE_DRAWS, record.n))
    return _energy(record, as_seen(record, model, band, draws), band, even)


def unseen_commands(data: Data, model: Model, joint: int) -> float:
    """The RMS torque between two models that commands between rows, which nobody saw, may make
    alone, as the fastest observer sees it, as a part of the RMS torque; 0 where all are known. Such
    a command and the same one at another time differ by twice its energy.
    """
    records = [rec[joint - 1] for rec in data.records]
    total = 2.0 * sum(_of_commands(r, model, BANDS[0], even=False) * r.n for r in records)
    return math.sqrt(total / max(sum(r.n for r in records), 1) / mean_square(data, joint))


def _felt_behind(record: JointRecord, model: Model, band: float, torque: Array) -> Array | None:
    """The torque (1, n) that an observer sees of one (n,) which shakes a load behind a
    transmission; None where motor and load are one, or run away. A load that rings for long
    amplifies it: of a spring of 7 Hz with a damping ratio of 0.01, errors of the other joint's
    acceleration were 2 % of the torque, and unexplained.
    """
    if not any(get_effect(t.effect).family == "transmission" for t in model.at(record.joint)):
        return None
    nothing = np.zeros(record.n)
    fixed = record.basis.get("fixed", Basis(nothing, nothing))
    basis = {**record.basis, "fixed": replace(fixed, bias=fixed.bias + torque)}
    shaken = replace(record, basis=basis, _thinned=None, _once={}, runs={})
    here = band_of(record, band)
    seen, still = (run(r, model, here) for r in (shaken, record))
    if seen.diverged or still.diverged:
        return None
    moved = np.clip(seen.innovations - still.innovations, -1e6, 1e6)
    return as_torque(record, model, moved, here)[np.newaxis]


def _energy(record: JointRecord, seen: Array, band: float, even: bool) -> float:
    """The mean square of torques that an observer sees, once it has settled."""
    seen = lasting(record, seen, band_of(record, band)) if even else seen
    return float(np.mean(np.asarray(seen[..., kept(record, band)] ** 2)))


def energy_blocks(
    data: Data, squares: Sequence[Array], joint: int, band: float
) -> tuple[Array, Array]:
    """Sums over blocks of time of some series, one for each recording, and the number of samples in
    each block.
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
    """Standard deviation of the sum of a series with correlated neighbours (Newey and West 1987).
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
    """The size of the torque that a model leaves unexplained at a joint.

    Parameters
    ----------
    data : Data
        Recordings; only untouched ones give an honest figure.
    joint : int
        1-based.

    Returns
    -------
    Size
        The estimate is that of the observer that shows most beyond its own uncertainty. The upper
        limit is that of the fastest observer, which sees most of a torque. Where that is below what
        another shows, the stated sensor noise is too large, and the other gives the limit.
    """
    scale = mean_square(data, joint)
    # own: upper limit by the observer that shows most
    best, own = Size(0.0, 0.0, 0.0, shown=0.0), 0.0
    for band in holding(data, model, joint):
        found = _lasting(data, model, joint, band)
        of_sensor = [noise(rec[joint - 1], model, band, even=True) for rec in data.records]
        excess = [d**2 - v for d, v in zip(found, of_sensor, strict=True)]
        sums, counts = energy_blocks(data, excess, joint, band)
        total, error = float(sums.sum()), deviation(sums)
        mean, chance = total / counts.sum() / scale, error / counts.sum() / scale
        # the error of the noise model itself
        spread = float(np.hypot(chance, 0.1 * float(np.mean(of_sensor)) / scale))
        by_chance = NINE_IN_TEN * chance - spread if math.isfinite(chance) else -spread
        at = (mean - spread, mean - 2.0 * spread, mean + 2.0 * spread, mean + by_chance)
        value, low, high, often = (math.sqrt(max(0.0, x)) for x in at)
        own = high if value > best.value else own
        most = high if band == BANDS[0] else best.high
        shown = max(best.shown, value if low > 0.0 else 0.0)
        best = Size(max(best.value, value), max(best.low, low), most, max(best.often, often), shown)
    return best if best.high > best.value else replace(best, high=max(own, best.value))


def holding(data: Data, model: Model, joint: int) -> tuple[float, ...]:
    """The bands of the observers that hold a model to the motion, the fastest first and always.

    Friction that falls with the speed drives the model away from the motion. An observer slower
    than that shows the instability, not a torque: beside a true Stribeck curve with 50 rad/s, 8 %
    of the torque seemed to be missing at 32 rad/s and less, and 0.4 % at 64 rad/s.
    """
    away = runs_away(data, model, joint)
    return (BANDS[0], *(band for band in BANDS[1:] if band > away))


def runs_away(data: Data, model: Model, joint: int) -> float:
    """The largest rate at which friction that falls with the speed drives a model away from the
    motion, 1/s; 0 or less where it does not.
    """
    slope = sum(
        drops({name: q.value for name, q in t.parameters.items()})
        for t in model.at(joint)
        if (drops := get_effect(t.effect).drops) is not None
    )
    if not slope > 0.0:
        return 0.0
    return max(
        float(np.max((slope - of.damping) / of.inertia))
        for of in (resisting(rec[joint - 1], model) for rec in data.records)
    )


def _lasting(data: Data, model: Model, joint: int, band: float) -> list[Array]:
    """The missing torque after ``lasting``."""
    return [
        lasting(rec[joint - 1], lack, band_of(rec[joint - 1], band))
        for lack, rec in zip(lacking(data, model, joint, band), data.records, strict=True)
    ]


def beyond(size: float, known: float) -> float:
    """The part of an RMS torque beyond what is known to stay unexplained."""
    return float(np.sqrt(max(size**2 - known**2, 0.0)))


def surely_beyond(size: Size, known: float) -> float:
    """The part of a size beyond what is known to stay unexplained, by an observer that surely sees
    something; 0 where none does. A fast one may show most and not surely, and a slow one surely
    next to nothing.
    """
    return beyond(min(size.value, size.shown), known) if size.low > 0.0 else 0.0


def falls(data: Data, without: Model, having: Model, joint: int, least: float) -> bool:
    """Whether a term may reduce the energy of the missing torque by a part ``least`` of the term's
    own energy, for slow and fast observers alike, as it does where its torque is missing. (The
    sensor's noise cancels, whatever its size.)
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
    """The RMS torque between two models along the recordings, as a part of the RMS torque; the
    sensor's noise cancels.
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
    """The samples of reversals, (n,): below a tenth of the joint's speed, and an observer's memory
    before and after.
    """
    speed = np.abs(record.motion.states[1])
    slow = speed < TURNING * float(np.quantile(speed[kept(record, band)], FASTEST))
    around = max(1, round(2.0 / band / record.sample_time))
    return widened(slow, around)


def at_reversals(data: Data, one: Model, other: Model, joint: int) -> float:
    """The part of the energy between two models that acts at reversals, beyond the reversals' part
    of the time: 0 for a torque that acts always, 1 for one that acts only there, or where the joint
    does nothing but reverse.
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
    """The mean square of the torque at a joint over recordings."""
    total = sum(rec[joint - 1].scale.torque ** 2 * rec[joint - 1].n for rec in data.records)
    return max(total / max(sum(rec[0].n for rec in data.records), 1), 1e-300)
