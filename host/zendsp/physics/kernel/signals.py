"""The information in a position sensor: quantiser edges, noise variance per sample, and the
smoothed motion.

While a joint crosses less than half a count per sample, a constant code says only that the position
lies in an interval. The moment at which the code changes says where it is to a fraction of a count.
So code changes are used as measurements, plateaus as intervals. Faster motion is treated as
position plus white noise of variance resolution²/12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.kernel.native import native
from zendsp.physics.kernel.smooth import moving_mean

Array = npt.NDArray[np.float64]

EDGE_FLOOR = 0.05  # counts: no edge of a real encoder is known better
PACE = 41  # samples, over which a speed is taken to tell moving from standing
MOVING = 0.75  # counts a sample: from there on rounding is as good as white
STANDING = 0.1  # counts a sample: below, a joint hardly moves
ENOUGH = 200  # samples of either kind that tell a variance
SPEED_OVER = 0.02  # s, over which the speed of measurements is taken
SLOW = 0.5  # counts a sample: below, a constant code says only where the position may lie
# counts of noise beside quantisation: from there on a code is a mean, no interval. Where a joint
# stands, codes that flip say again and again that it is at their edge, each wrong by the noise;
# their mean is wrong by exp(-2 pi^2 noise^2) / pi, which is less
DITHERED = 0.2

# of a position's span: an angle or a counter that begins anew falls by all of its range, which the
# joint has then passed through
ALL_OF_RANGE = 0.9

# of a lattice: the steps that are looked at, and how they lie
SMALL = 1e-9  # of the span: a smaller step is rounding of the numbers
SMALLEST = 0.001  # quantile of the steps that is taken for one count, to begin with
ONE = 1.5  # counts: a step below is one count
STEPS = 10  # that must be there to tell
COUNTED = 200  # counts: of longer steps the digits printed no longer tell whole ones
# of a set value on its position: slope, and R^2 (tests/diagnosis/test_input_units.py has commands
# on either side)
SAME, FOLLOWED = (0.8, 1.25), 0.9
OFF, ON = 0.02, 0.98  # of a count off a whole one at most, in so many of the steps

STRETCH = 100  # samples that are looked at together, where impacts are kept out
FOURTH = 70  # sum of the squared binomials of a fourth difference
MEDIAN = 0.6745  # median absolute deviation of a normal variable of standard deviation 1

# of noise without a lattice: how differences over twice the samples grow
SMOOTH_GROWTH = 12.0  # less than the 16 of a smooth motion
WHITE_GROWTH = 1.2  # more than the 1 of white noise
PER_STRIDE = 100  # samples a sample of stride

# of a joint that hardly moves
FLIPS = 20  # changes of the code that must be there to tell
BACK = 0.25  # of them that go back: below, it is motion
STEADY = (0.05, 0.5)  # counts a sample: motion in which noise makes codes go to and fro
PASSED = 200.0  # counts that such motion must cover to tell
BENDS = 0.1  # counts a sample: by which the speed over a longer time is another one at most
BINS, LEVELS = 64, 61  # of speed, and of noise, that are looked at
NOISIEST = 3.0  # counts: of more noise the codes of a slow motion jump rather than go to and fro
FEW_SAMPLES = 0.4  # counts of noise at least, where all changes go back and few samples stand
# Rounding noise of s counts, over all places between two codes: a variance of s / sqrt(pi) while s
# is small, and s^2 + 1/12 from a third of a count on, where the two meet.
MEET = 0.17


@dataclass(frozen=True)
class Measurement:
    """Per sample: value, half width of the interval that says nothing, variance (negative: no
    information). Shapes (n,).
    """

    value: Array
    half: Array
    variance: Array
    resolution: float
    noise: float  # standard deviation of what is not quantisation

    @property
    def std(self) -> float:
        """Standard deviation of a reading of a moving joint."""
        return math.hypot(self.noise, self.resolution / math.sqrt(12))


@dataclass(frozen=True)
class Motion:
    """Smoothed q, qd, qdd (3, n), their variances of q, qd and of the unexplained acceleration (3,
    n).
    """

    states: Array
    variances: Array
    bandwidth: float


def is_set_value(command: Array, position: Array) -> bool:
    """Whether a command is the position in its numbers, (n,) each, as a set value of it is."""
    u, y = command - command.mean(), position - position.mean()
    power, both = float(y @ y), float(u @ y)
    if power <= 0 or not SAME[0] < both / power < SAME[1]:
        return False
    return both**2 > FOLLOWED * power * float(u @ u)


def find_resolution(y: Array) -> float:
    """The smallest step of a quantised signal, 0 where it is not on a lattice.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Position, any unit.

    Returns
    -------
    float
        Step in the unit of ``y``.
    """
    steps = np.abs(np.diff(y))
    span = float(np.ptp(y))
    steps = steps[steps > SMALL * max(span, 1e-12)]
    if len(steps) < STEPS:
        return 0.0
    step = float(np.quantile(steps, SMALLEST))
    small = steps[steps < ONE * step]
    step = float(np.mean(small))
    ratio = steps / step
    close = ratio < COUNTED
    if close.sum() < STEPS:
        return 0.0
    off = np.abs(ratio[close] - np.round(ratio[close]))
    return step if np.mean(off < OFF) > ON else 0.0


def measure(y: Array, sample_time: float, resolution: float, noise: float = 0.0) -> Measurement:
    """The measurements of quantised samples, each with a variance.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Position, rad or m.
    sample_time : float
        s.
    resolution : float
        Counts step, rad or m; 0 where unknown or continuous.
    noise : float
        Standard deviation of the sensor noise beside quantisation, rad or m.
    """
    n = len(y)
    white = resolution**2 / 12 + noise**2
    if resolution <= 0 or noise > DITHERED * resolution:
        floor = max(white, (1e-9 * max(float(np.ptp(y)), 1e-9)) ** 2)
        return Measurement(y.astype(float), np.zeros(n), np.full(n, floor), resolution, noise)
    window = max(5, round(SPEED_OVER / sample_time))
    speed = np.abs(np.gradient(moving_mean(y, window, "edge"), sample_time))
    speed = moving_mean(speed, window, "edge")
    slow = speed * sample_time < SLOW * resolution
    change = np.zeros(n, bool)
    change[1:] = np.abs(np.diff(y)) > 0.5 * resolution
    value, half, variance = y.astype(float).copy(), np.zeros(n), np.full(n, white)
    starts = np.flatnonzero(np.r_[True, change[1:]])
    run = np.diff(np.r_[starts, n])
    length = np.repeat(run, run)
    half[slow] = 0.5 * resolution
    variance[slow] = white * length[slow]
    edge = slow & change
    travel = np.abs(y[edge] - y[np.flatnonzero(edge) - 1])
    one = travel < ONE * resolution
    k = np.flatnonzero(edge)[one]
    direction = np.sign(y[k] - y[k - 1])
    step = np.minimum(speed[k] * sample_time, resolution)
    value[k] = 0.5 * (y[k] + y[k - 1]) + 0.5 * direction * step
    half[k] = 0.0
    variance[k] = step**2 / 12 + (EDGE_FLOOR * resolution) ** 2 + noise**2
    return Measurement(value, half, variance, resolution, noise)


def means(series: Array, every: int) -> Array:
    """Means over so many samples each, (..., n // every)."""
    if every < 2:
        return series
    count = series.shape[-1] // every
    groups = series[..., : count * every].reshape(*series.shape[:-1], count, every)
    return np.ascontiguousarray(groups.mean(axis=-1))


def thin_measurement(measurement: Measurement, q: Array, every: int) -> Measurement:
    """One measurement in place of several: their weighted mean, at the time of the first.

    Parameters
    ----------
    q : ndarray, shape (n,)
        The smoothed motion, along which each is brought to the time of the first.

    Returns
    -------
    Measurement
        The first one unchanged, where none says more than an interval.
    """
    count = len(q) // every
    value, half, variance, path = (
        a[: count * every].reshape(count, every)
        for a in (measurement.value, measurement.half, measurement.variance, q)
    )
    says = (half == 0) & (variance > 0)
    weight = np.where(says, 1.0 / np.where(says, variance, 1.0), 0.0)
    total = weight.sum(axis=1)
    any_says = total > 0
    per = 1.0 / np.where(any_says, total, 1.0)
    off = (weight * (value - path)).sum(axis=1) * per
    return Measurement(
        np.where(any_says, path[:, 0] + off, value[:, 0]),
        np.where(any_says, 0.0, half[:, 0]),
        np.where(any_says, per, variance[:, 0]),
        measurement.resolution,
        measurement.noise,
    )


def smooth(measurement: Measurement, sample_time: float, known: Array | None = None) -> Motion:
    """The smoothed motion behind the measurements, given assumed parts of its acceleration.

    Each part is scaled to make the measurements likeliest, since a model's inertia may be far off.
    The rest of the acceleration is a random walk, whose strength maximises the likelihood too.

    Parameters
    ----------
    sample_time : float
        s.
    known : ndarray, shape (n, parts)
        rad/s² or m/s², held over each sample.
    """
    n = len(measurement.value)
    span = float(np.ptp(measurement.value)) or 1e-6
    window = max(5, round(SPEED_OVER / sample_time))
    early = measurement.value[: 4 * window]
    v0 = (
        float(np.polyfit(np.arange(len(early)) * sample_time, early, 1)[0])
        if len(early) > 3
        else 0.0
    )
    parts = np.zeros((n, 1)) if known is None else known
    size = max(float(np.std(parts.sum(axis=1))), span)
    work, out, var = np.empty(14 * n), np.empty((3, n)), np.empty((3, n))
    gains = work[9 * n :].reshape(n, 5)  # of a run: the last two are a variance and an error each
    says = measurement.variance > 0

    def run(strength: float, acceleration: Array) -> float:
        begin = sample_time, strength, 3 * size, v0
        return _smoothed(measurement, begin, acceleration, work, out, var)

    def errors(strength: float, acceleration: Array) -> Array:
        """Errors of one step, in standard deviations."""
        run(strength, acceleration)
        error: Array = gains[says, 4] / np.sqrt(gains[says, 3])
        return error

    def likeliest(strength: float) -> tuple[float, float, Array]:
        """Minus twice the log likelihood of a strength, the strength, and the scaled parts of the
        acceleration; the one-step errors are linear in these scales.
        """
        alone = errors(strength, np.zeros(n))
        less = [alone - errors(strength, part) for part in parts.T]
        brought = parts @ np.linalg.lstsq(np.stack(less, axis=1), alone, rcond=None)[0]
        return run(strength, brought), strength, brought

    strengths = size * 10.0 ** np.arange(-2.0, 3.6, 0.5)
    _, strength, brought = min(map(likeliest, strengths), key=lambda found: found[0])
    run(strength, brought)
    states = np.stack([out[0], out[1], out[2] + brought])
    return Motion(states, var.copy(), strength)


def blurred(measurement: Measurement, sample_time: float, motion: Motion) -> Array:
    """The error of a smoothed motion's mean acceleration over each sample, (n,): one draw of what
    the sensor's noise brings and the smoothing takes away (Durbin and Koopman 2002).
    """
    n, rng = len(measurement.value), np.random.default_rng(0)
    steps = motion.bandwidth * math.sqrt(sample_time) * rng.standard_normal(n)
    late = np.cumsum(steps)  # acceleration at the end of each sample; a line leads to it
    early = late - steps
    speed = np.r_[0.0, np.cumsum(0.5 * (early + late))[:-1]] * sample_time
    moved = speed * sample_time + (early / 3 + late / 6) * sample_time**2
    noise = np.sqrt(np.maximum(measurement.variance, 0.0)) * rng.standard_normal(n)
    seen = replace(measurement, value=np.r_[0.0, np.cumsum(moved)[:-1]] + noise)
    out, begin = np.empty((3, n)), (sample_time, motion.bandwidth, motion.bandwidth, 0.0)
    _smoothed(seen, begin, np.zeros(n), np.empty(14 * n), out, np.empty((3, n)))
    error = out[1] - speed
    return np.diff(error, append=error[-1:]) / sample_time


def _smoothed(
    measurement: Measurement, begin: tuple[float, float, float, float], acceleration: Array,
    work: Array, out: Array, var: Array,
) -> float:
    """Minus twice the log likelihood of a smoothed motion; ``work``, ``out`` and ``var`` are
    written. ``begin``: sample time, strength, spread of the first acceleration, first speed.
    """
    lib, p = native(), native().doubles
    sample_time, strength, spread, v0 = begin
    value: float = lib.lib.zf_smooth(
        len(measurement.value),
        sample_time,
        strength,
        spread,
        p(np.ascontiguousarray(acceleration)),
        p(measurement.value),
        p(measurement.half),
        p(measurement.variance),
        float(measurement.value[0]),
        v0,
        p(work),
        p(out),
        p(var),
    )
    return value


def noise_beside_quantisation(y: Array, resolution: float) -> float:
    """Standard deviation of sensor noise that the resolution does not explain.

    From codes that go to and fro where the motion is slow. Where that is too seldom, or the noise
    larger than a fifth of a count, from fourth differences of fast motion: there rounding is as
    good as white. Where it is nowhere fast, from the codes of a joint that hardly moves.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Position, rad or m.
    resolution : float
        rad or m, 0 where unknown.

    Returns
    -------
    float
        rad or m.
    """
    if resolution <= 0:
        return _coloured(y)
    slowly = _to_and_fro(y, resolution)
    if slowly is not None and slowly < DITHERED:
        return resolution * slowly
    fourth = np.diff(y, 4)
    pace = np.abs(np.gradient(moving_mean(y, PACE, "edge")))[4:] / resolution
    moving = pace > MOVING
    if moving.sum() >= ENOUGH:
        return float(np.sqrt(max(0.0, _usual_variance(fourth[moving]) - resolution**2 / 12)))
    if slowly is not None:
        return resolution * slowly
    return resolution * _dither(np.diff(y) / resolution, pace < STANDING)


def _to_and_fro(y: Array, resolution: float) -> float | None:
    """Noise in counts, at most ``NOISIEST``, from how often the counts of a slow motion go back and
    forth; None where there is too little of such motion.

    Between samples v counts apart, with a noise of s counts, a code changes by |v + sqrt(2) s z| in
    the mean, z normal: more than v, the more so the slower the motion. Without noise each stretch
    of such motion has as many changes as counts it is long, to the rounding of its two ends,
    sqrt(1/6): what that explains (two deviations) is no noise. By the root of their own number, as
    if they came at random, 0.12 counts were nothing in two recordings of three.
    """
    if len(y) < 5 * PACE:
        return None
    speed, usual = (_slopes(y / resolution, over)[1:] for over in (PACE, 4 * PACE + 1))
    v, seen = np.abs(speed), np.abs(usual)  # chosen by the same speed, the noisy ones were chosen
    use = (seen > STEADY[0]) & (seen < STEADY[1]) & (np.abs(speed - usual) < BENDS)
    v, changes = v[use], float(np.abs(np.diff(y))[use].sum()) / resolution
    if v.sum() < PASSED:
        return None
    stretches = np.count_nonzero(np.diff(use.astype(int)) > 0) + int(use[0])
    if changes - v.sum() < 2.0 * np.sqrt(stretches / 6.0):
        return 0.0
    count, edges = np.histogram(v, bins=BINS)
    speeds = 0.5 * (edges[1:] + edges[:-1])

    def changed(noise: float) -> float:
        spread = np.sqrt(2.0) * noise
        far = np.exp(-0.5 * (speeds / spread) ** 2)
        inside = np.array([math.erf(x) for x in speeds / spread / np.sqrt(2.0)])
        return float(count @ (spread * np.sqrt(2 / np.pi) * far + speeds * inside))

    levels = np.geomspace(1e-3, NOISIEST, LEVELS)
    return float(np.interp(changes, [changed(level) for level in levels], levels))


def _slopes(y: Array, over: int) -> Array:
    """Slope of the cubic through so many samples around each, per sample; at the ends, where there
    are fewer, not a number.
    """
    half = over // 2
    weights = np.linalg.pinv(np.vander(np.arange(-half, half + 1.0), 4, increasing=True))[1]
    out = np.full(len(y), np.nan)
    out[half : len(y) - half] = np.convolve(y - y[0], weights[::-1], mode="valid")
    return out


def _spread(fourth: Array) -> float:
    """Standard deviation of the white noise behind fourth differences; their median absolute
    deviation keeps impacts out.
    """
    return float(np.median(np.abs(fourth - np.median(fourth))) / MEDIAN / np.sqrt(FOURTH))


def _usual_variance(fourth: Array) -> float:
    """Variance of the white noise behind fourth differences: the median over stretches of time
    keeps impacts out. That of single ones would not do: at a whole number of counts a sample the
    rounding is now next to none, now half a count.
    """
    squares = np.array_split(fourth**2, max(1, len(fourth) // STRETCH))
    return float(np.median([np.mean(part) for part in squares])) / FOURTH


def _coloured(y: Array) -> float:
    """Noise of a signal without a lattice, including what a filter left at lower frequencies.

    Differences over 2, 4, 8 samples see noise that a filter took out of neighbouring ones: they
    grow, ever less, to what there was before the filter. White noise stays the same; a smooth
    motion grows by 16 each time, and ever on.
    """
    best, growth = _spread(np.diff(y, 4)), SMOOTH_GROWTH
    for stride in (2, 4, 8):
        if len(y) < PER_STRIDE * stride:
            break
        a, b, c, d, e = (y[k * stride : len(y) - (4 - k) * stride] for k in range(5))
        wider = _spread(e - 4 * d + 6 * c - 4 * b + a)
        if not WHITE_GROWTH * best < wider < growth * best:
            break
        best, growth = wider, wider / best
    return best


def _dither(steps: Array, still: npt.NDArray[np.bool_]) -> float:
    """Noise in counts from how often the counts of an almost resting joint go back and forth; 0
    where they do not.

    Parameters
    ----------
    steps : ndarray, shape (n - 1,)
        Differences of the codes, counts.
    still : ndarray of bool, shape (n - 4,)
        Of each fourth difference, whether the joint moves by less than a tenth of a count a sample.
    """
    flips = steps[np.abs(steps) > 0.5]
    back = float(np.mean(flips[1:] * flips[:-1] < 0)) if len(flips) > FLIPS else 0.0
    if back <= BACK:
        return 0.0
    if still.sum() < ENOUGH:
        return FEW_SAMPLES * back
    variance = float(np.mean(np.diff(steps, 3)[still] ** 2)) / FOURTH
    counts = np.sqrt(np.pi) * variance if variance < MEET else np.sqrt(variance - 1 / 12)
    return float(counts)
