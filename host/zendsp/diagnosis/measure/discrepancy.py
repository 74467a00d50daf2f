"""The discrepancy: the torque that nothing named explains, how large it is, and what it depends on.

An observer that keeps a model on the measured motion corrects its velocity; that correction, as a
torque, is what the model lacks, whatever hidden states the model has. Part of it is sensor noise
that went through the observer: how much follows from the sensor's variance, by sending noise of
that variance the same way. What is larger is the discrepancy (Kennedy and O'Hagan 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.ndimage import binary_closing
from scipy.stats import norm

from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, effective_inertia
from zendsp.physics.model import Model
from zendsp.physics.predict import response, run

Array = npt.NDArray[np.float64]

# rad/s of the observers; slower ones see less of a torque, and far less noise
BANDS = (64.0, 32.0, 16.0, 8.0)
# s, over which energies are summed before their variance is taken; less where there would be
BLOCK = 0.5
BLOCKS = 12  # fewer, but never less than an observer remembers
SETTLE = 0.4  # s, of the observers, at most a tenth of a recording
DRAWS = 4  # of sensor noise
ROWS = 8000  # rows of a regression
# pieces of a function of state, as multiples: broad shapes, and narrow ones
DETAILS = (1, 3)
BRIEF = 0.4  # of the time at most: what acts for longer is no disturbance that comes and goes
# of the energy outside of that time, against what a random torque that is normally distributed has
# there
CONCENTRATED = 0.4
BURST, OF_PEAK = 10.0, 0.05  # times the median of the energy, and of its largest: a burst
REVISITED = 0.3  # of that time, in states that the joint is in at other times too, without it
MANY, FEW = 12, 3  # intervals: in recordings that no model was fitted to, and in the others


@dataclass(frozen=True)
class Size:
    """RMS torque as a part of the RMS torque of the recordings: the estimate, and where it lies
    with 95 % probability.
    """

    value: float
    low: float
    high: float


def band_of(record: JointRecord, band: float) -> float:
    """The observer's bandwidth that a recording's sample time allows, rad/s."""
    return min(band, 0.25 / record.sample_time)


def as_torque(record: JointRecord, model: Model, innovations: Array, band: float) -> Array:
    """Torque by which an observer with such weighted innovations corrects a model, (..., n), N m or
    N; its own delay taken out.
    """
    _, k2, w = record.gains(band)
    factor = (
        np.where(w > 0, k2 / np.maximum(w, 1e-300), 0.0)
        * effective_inertia(record, model)
        / record.sample_time
    )
    lag = round(np.sqrt(2) / band / record.sample_time)
    out = -innovations * factor
    moved = np.zeros_like(out)
    moved[..., : out.shape[-1] - lag] = out[..., lag:]
    return moved


def lacking(data: Data, model: Model, joint: int, band: float) -> list[Array]:
    """Torque that a model lacks, one array (n,) a recording, N m or N."""
    out = []
    for rec in data.records:
        record = rec[joint - 1]
        here = band_of(record, band)
        r = run(record, model, here, inner=data.inner).innovations
        out.append(as_torque(record, model, np.clip(r, -1e6, 1e6), here))
    return out


def kept(record: JointRecord, band: float) -> slice:
    """Samples of a recording after its observer has settled."""
    lag = round(np.sqrt(2) / band_of(record, band) / record.sample_time)
    skip = min(record.n // 10, round(max(SETTLE, 4.0 / band) / record.sample_time))
    return slice(skip, max(skip + 1, record.n - lag))


def noise(record: JointRecord, model: Model, band: float) -> float:
    """Mean square of the torque that the sensor's noise alone makes, (N m)² or N²."""
    here = band_of(record, band)
    draws = np.random.default_rng(0).standard_normal((DRAWS, record.n))
    draws *= np.sqrt(np.maximum(record.measurement.variance, 0.0))
    r = response(
        record, here, effective_inertia(record, model), np.zeros(record.n), draws, on_sensor=True
    )
    return float(np.mean(as_torque(record, model, r, here)[:, kept(record, band)] ** 2))


def energy_blocks(
    data: Data, squares: Sequence[Array], joint: int, band: float
) -> tuple[Array, Array]:
    """Sums over blocks of time of some series, one a recording, and the number of samples in each
    block.
    """
    sums, counts = [], []
    seconds = sum(rec[joint - 1].n * rec[joint - 1].sample_time for rec in data.records)
    block = max(min(BLOCK, seconds / BLOCKS), 8.0 / band)
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
    model : Model
    joint : int
        1-based.

    Returns
    -------
    Size
        Of several observers the one that shows most beyond its own uncertainty decides.
    """
    scale = mean_square(data, joint)
    best = Size(0.0, 0.0, float("inf"))
    for band in BANDS:
        found = lacking(data, model, joint, band)
        of_sensor = [noise(rec[joint - 1], model, band) for rec in data.records]
        excess = [d**2 - v for d, v in zip(found, of_sensor, strict=True)]
        sums, counts = energy_blocks(data, excess, joint, band)
        total, error = float(sums.sum()), deviation(sums)
        mean, spread = total / counts.sum() / scale, error / counts.sum() / scale
        # what the noise model itself may be wrong by
        spread = float(np.hypot(spread, 0.1 * float(np.mean(of_sensor)) / scale))
        value, low, high = (float(np.sqrt(max(0.0, mean + k * spread))) for k in (-1.0, -2.0, 2.0))
        best = Size(max(best.value, value), max(best.low, low), min(best.high, max(high, best.low)))
    return Size(best.value, best.low, max(best.high, best.value))


def difference(data: Data, one: Model, other: Model, joint: int, band: float = BANDS[0]) -> float:
    """RMS torque between two models along the recordings, as a part of the RMS torque; the sensor's
    noise cancels.
    """
    total = count = 0.0
    pairs = zip(
        lacking(data, one, joint, band),
        lacking(data, other, joint, band),
        data.records,
        strict=True,
    )
    for a, b, rec in pairs:
        use = kept(rec[joint - 1], band)
        total += float(np.sum((a[use] - b[use]) ** 2))
        count += len(a[use])
    return float(np.sqrt(total / max(count, 1.0) / mean_square(data, joint)))


def mean_square(data: Data, joint: int) -> float:
    """Mean square of the torque at a joint over recordings."""
    total = sum(rec[joint - 1].scale.torque ** 2 * rec[joint - 1].n for rec in data.records)
    return max(total / max(sum(rec[0].n for rec in data.records), 1), 1e-300)


# --- what a lacking torque depends on


def _splines(u: Array, count: int) -> Array:
    """Quadratic B-splines over [0, 1], (count, n)."""
    degree = 2
    knots = np.r_[np.zeros(degree), np.linspace(0, 1, count - degree + 1), np.ones(degree)]
    matrix: Array = BSpline.design_matrix(np.clip(u, 0.0, 1.0 - 1e-9), knots, degree).toarray().T
    return matrix


def _products(a: Array, b: Array) -> Array:
    return np.asarray((a[:, None, :] * b[None, :, :]).reshape(-1, a.shape[1]))


@dataclass(frozen=True)
class Ranges:
    """Where a joint's variables lie: limits of position, of speed and of command, and of the other
    joints' positions.
    """

    position: tuple[float, float]
    speed: float
    command: tuple[float, float]
    others: dict[int, tuple[float, float]]


def ranges_of(data: Data, joint: int) -> Ranges:
    """Ranges over all recordings."""
    records = [rec[joint - 1] for rec in data.records]
    q = np.concatenate([r.motion.states[0] for r in records])
    v = np.concatenate([np.abs(r.motion.states[1]) for r in records])
    u = np.concatenate([r.command for r in records])
    others = {}
    for other in (joint - 1, joint + 1):
        if 1 <= other <= data.joints:
            p = np.concatenate([rec[other - 1].motion.states[0] for rec in data.records])
            others[other] = (float(p.min()), float(p.max()))
    return Ranges(
        (float(q.min()), float(q.max())),
        max(float(np.quantile(v, 0.98)), 1e-12),
        (float(np.quantile(u, 0.005)), float(np.quantile(u, 0.995))),
        others,
    )


def _unit(x: Array, limits: tuple[float, float]) -> Array:
    return np.asarray((x - limits[0]) / max(limits[1] - limits[0], 1e-300))


def shapes(
    rec: Sequence[JointRecord], joint: int, mechanism: str, ranges: Ranges, detail: int = 1
) -> Array:
    """Torques over time, (columns, n), whose sums are all that a mechanism may do, whatever its
    law: functions of its own variables, with ``detail`` times as many pieces along each.
    """
    record = rec[joint - 1]
    q, v, _ = record.motion.states
    place = _unit(q, ranges.position)
    sign = np.tanh(v / (0.02 * ranges.speed))
    fast = np.sqrt(np.clip(np.abs(v) / ranges.speed, 0.0, 1.0))
    if mechanism == "position_torque":
        columns = [_splines(place, 14 * detail)]
        for other, limits in ranges.others.items():
            there = _unit(rec[other - 1].motion.states[0], limits)
            columns.append(_products(_splines(place, 5), _splines(there, 5)))
        return np.concatenate(columns)
    if mechanism == "dry_friction":
        level = sign * _splines(fast, 6 * detail)
        return np.concatenate([level, _products(sign * _splines(place, 8), _splines(fast, 3))])
    if mechanism == "fluid_friction":
        return _splines(0.5 + 0.5 * np.clip(v / ranges.speed, -1, 1), 8 * detail)
    if mechanism == "actuator":
        command = _unit(record.command, ranges.command)
        return np.concatenate([_splines(command, 10 * detail), command * _splines(place, 6)])
    return np.zeros((0, record.n))


STRUCTURED = ("position_torque", "dry_friction", "fluid_friction", "actuator")


@dataclass(frozen=True)
class Structure:
    """What a mechanism's own variables predict of the torque that a model lacks, on recordings that
    the prediction was not fitted to.

    ``size`` is its RMS as a part of the RMS torque, ``share`` its part of the lacking energy beyond
    the noise, ``z`` its evidence in standard deviations over blocks of time.
    """

    size: float
    share: float
    z: float


def structure(
    parts: Sequence[Data], model: Model, joint: int, mechanisms: Sequence[str]
) -> Structure:
    """How much of what a model lacks is a function of the own variables of some mechanisms.

    Parameters
    ----------
    parts : sequence of Data
        Each part is predicted by a function that was fitted to all the others (cross-fitting).
    model : Model
    joint : int
        1-based.
    mechanisms : sequence of str
        Of ``STRUCTURED``.

    Returns
    -------
    Structure
    """
    best = Structure(0.0, 0.0, 0.0)
    whole = replace(parts[0], records=tuple(r for part in parts for r in part.records))
    scale = mean_square(whole, joint)
    ranges = ranges_of(whole, joint)
    stride = max(1, sum(rec[0].n for rec in whole.records) // ROWS)
    for band, detail in product(BANDS[:3], DETAILS):
        made = [_seen(part, model, joint, mechanisms, ranges, band, detail) for part in parts]
        if not made[0][0][0].shape[0]:
            return best
        normals = [
            _normal(part, seen, joint, band, stride) for part, seen in zip(parts, made, strict=True)
        ]
        sums, counts, excess = [], [], 0.0
        for k, (part, seen) in enumerate(zip(parts, made, strict=True)):
            others = [n for i, n in enumerate(normals) if i != k]
            square = np.sum([n[0] for n in others], axis=0)
            level = float(np.trace(square)) / len(square)
            theta = np.linalg.solve(
                square + 1e-3 * level * np.eye(len(square)), np.sum([n[1] for n in others], axis=0)
            )
            gains = [lack**2 - (lack - theta @ columns) ** 2 for columns, lack in seen]
            for (_, lack), rec in zip(seen, part.records, strict=True):
                use = kept(rec[joint - 1], band)
                excess += float(np.sum(lack[use] ** 2 - noise(rec[joint - 1], model, band)))
            found = energy_blocks(part, gains, joint, band)
            sums.append(found[0])
            counts.append(found[1])
        gained = np.concatenate(sums)
        total, error = float(gained.sum()), deviation(gained)
        z = total / error if error > 0 else 0.0
        size = float(np.sqrt(max(0.0, total) / np.concatenate(counts).sum() / scale))
        if size > best.size and z > 1.0:
            best = Structure(size, min(1.0, total / excess) if excess > 0 else 1.0, z)
    return best


def _seen(
    data: Data,
    model: Model,
    joint: int,
    mechanisms: Sequence[str],
    ranges: Ranges,
    band: float,
    detail: int,
) -> list[tuple[Array, Array]]:
    """Columns (m, n) and lacking torque (n,), one pair a recording."""
    lacks = lacking(data, model, joint, band)
    return [
        (_columns(rec, model, joint, mechanisms, ranges, band, detail), lack)
        for rec, lack in zip(data.records, lacks, strict=True)
    ]


def _normal(
    data: Data, seen: Sequence[tuple[Array, Array]], joint: int, band: float, stride: int
) -> tuple[Array, Array]:
    """Normal equations of a part, thinned: squares (m, m), products (m,)."""
    m = seen[0][0].shape[0]
    square, product = np.zeros((m, m)), np.zeros(m)
    for (columns, lack), rec in zip(seen, data.records, strict=True):
        use = kept(rec[joint - 1], band)
        a, d = columns[:, use][:, ::stride], lack[use][::stride]
        square += a @ a.T
        product += a @ d
    return square, product


def _columns(
    rec: Sequence[JointRecord],
    model: Model,
    joint: int,
    mechanisms: Sequence[str],
    ranges: Ranges,
    band: float,
    detail: int,
) -> Array:
    record = rec[joint - 1]
    here = band_of(record, band)
    raw = np.concatenate([shapes(rec, joint, m, ranges, detail) for m in mechanisms])
    r = response(record, here, effective_inertia(record, model), np.zeros(record.n), raw)
    return as_torque(record, model, r, here)


# --- what comes and goes with time


@dataclass(frozen=True)
class Bursts:
    """Times (s) in which nearly all of a lacking torque acts, though the joint is in the same
    states at other times.

    ``share`` is their part of its energy, ``peak`` the largest torque (N m or N), ``rms`` its RMS
    within them.
    """

    intervals: tuple[tuple[float, float], ...]
    share: float
    peak: float
    rms: float


def _states(
    rec: Sequence[JointRecord], joint: int, use: slice, q: Array, v: Array
) -> list[npt.NDArray[np.float64]]:
    """Cells of the states that a joint is in, (n,) each: place, direction and speed; the way since
    it last turned round; the place of each neighbour, with the direction.
    """

    def places(x: Array, count: int) -> Array:
        return np.floor((count - 0.01) * _unit(x, (float(x.min()), float(x.max()))))

    fast = np.minimum(2, np.floor(np.abs(v) / max(float(np.std(v)), 1e-300)))
    forward = (v > 0).astype(float)
    turns = np.flatnonzero(np.diff(forward)) + 1
    since = np.zeros(len(q), int)
    since[turns] = turns
    way = np.abs(q - q[np.maximum.accumulate(since)])
    cells = [6 * places(q, 20) + 3 * forward + fast, 2 * places(way, 20) + forward]
    for other in (joint - 1, joint + 1):
        if 1 <= other <= len(rec):
            cells.append(2 * places(rec[other - 1].motion.states[0][use], 20) + forward)
    return cells


def bursts(
    data: Data, model: Model, joint: int, band: float = 32.0, many: int = MANY
) -> Bursts | None:
    """Find the times outside of which a model lacks next to nothing; None where there are none
    such.

    Parameters
    ----------
    data : Data
    model : Model
    joint : int
        1-based.
    band : float
        Of the observer, rad/s.
    many : int
        Intervals; more come and go with something else than time.

    Returns
    -------
    Bursts or None
    """
    found = lacking(data, model, joint, band)
    spans: list[tuple[float, float]] = []
    inside = outside = peak = 0.0
    count = covered = met = 0
    levels, masks = [], []
    for lack, rec in zip(found, data.records, strict=True):
        record = rec[joint - 1]
        use = kept(record, band)
        width = max(3, round(3.0 / band / record.sample_time))
        levels.append(np.convolve(lack**2, np.ones(width) / width, mode="same")[use])
    quiet = float(np.quantile(np.concatenate(levels), 0.5))
    for level, lack, rec in zip(levels, found, data.records, strict=True):
        record = rec[joint - 1]
        use = kept(record, band)
        high = level > max(BURST * quiet, OF_PEAK * float(level.max()))
        high = binary_closing(np.pad(high, 1), iterations=max(1, round(0.25 / record.sample_time)))[
            1:-1
        ]
        masks.append(high)
        q, v = record.motion.states[0][use], record.motion.states[1][use]
        seen = [np.isin(c, np.unique(c[~high])) for c in _states(rec, joint, use, q, v)]
        met += int(np.all(seen, axis=0)[high].sum())
        energy = lack[use] ** 2
        inside += float(energy[high].sum())
        outside += float(energy[~high].sum())
        count += len(high)
        covered += int(high.sum())
        change = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
        start = record.t0 + use.start * record.sample_time
        spans += [
            (start + a * record.sample_time, start + (b - 1) * record.sample_time)
            for a, b in zip(change[::2].tolist(), change[1::2].tolist(), strict=True)
        ]
        # a smooth peak: single samples are noise, and the observer's own ringing at the edges
        if high.any():
            width = max(3, round(3.0 / band / record.sample_time))
            smooth = np.convolve(lack[use], np.ones(width) / width, mode="same")
            peak = max(peak, float(np.quantile(np.abs(smooth[high]), 0.95)))
    share = inside / max(inside + outside, 1e-300)
    if not spans or covered > BRIEF * count or met < REVISITED * covered or len(spans) > many:
        return None
    z = float(norm.isf(0.5 * covered / count))
    # of a random torque's energy, in its largest values for so long
    by_chance = 2.0 * (z * float(norm.pdf(z)) + float(norm.sf(z)))
    if 1.0 - share > CONCENTRATED * (1.0 - by_chance):
        return None
    return Bursts(tuple(spans), share, peak, float(np.sqrt(inside / max(covered, 1))))
