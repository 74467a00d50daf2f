"""Whether time stamps are a rounding of an even clock."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

JITTER = 0.02  # of the sample time: below, stamps count as even
ALIKE = 1e-4, 3e-3  # of the usual step: steps that differ by less are the same step
ON_LATTICE = 0.1  # of the quantum: most that a step is off a whole number of quanta
SPARE = 0.25  # of the period beside the quantum: so much less leaves room to see a break
PRINTED = 1e-3  # of the quantum: error of its printed digits
PARTS = 16  # of a recording: in some of them no row is missing, where few are
FEW = 6  # steps of two quanta among those of one: rows missing by chance are as even as so few
RUN = 32  # rows, none missing, to begin with: where a tenth is missing, 3 in 100 runs are so
RUNS = 400  # looked at, over the recording
TRIED = 5  # of the runs in which no row is missing
GROWN = 8  # a part so large is added at each end, and still shows which rows are missing
HALVINGS = 20  # golden sections of an interval of sample times, to a ten thousandth of it
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class EvenClock:
    """A clock whose stamps are rounded.

    Attributes
    ----------
    period : float, s
        Between two samples.
    count : array, shape (n,)
        Number of each row's sample, from 0.
    quantum : float, s
        To which the stamps are rounded, or cut.
    """

    period: float
    count: Counts
    quantum: float


def even_clock(time: Array, stated: float | None = None) -> EvenClock | None:
    """The even clock of which stamps are a rounding, each within half a quantum, and within what
    counts as even beside it; None where there is none, or no rounding. Rows may be missing.

    Parameters
    ----------
    time : array, shape (n,), s
        Rising.
    stated : float, s, optional
        The sample time, which is taken where it agrees with the stamps.
    """
    for quantum in _quanta(time):
        found = _of_quantum(time, quantum)
        if found is not None:
            agrees = stated and _spread(time, found.count, stated) <= _most(quantum, stated)
            return EvenClock(stated, found.count, quantum) if stated and agrees else found
    return None


def _of_quantum(time: Array, quantum: float) -> EvenClock | None:
    """The result of ``even_clock`` for a quantum, by the stamps alone."""
    n = len(time)
    whole = _clock(time, np.arange(n), quantum)
    if whole is not None and not _few(whole):
        return whole
    # a row may be missing; a clock by which fewer are is likelier
    tried = [_grown(time, first, last, quantum) for first, last in _runs(time, quantum)]
    likely = [clock for clock in tried if clock is not None and not _few(clock)]
    return max(likely, key=lambda clock: clock.period, default=None)


def _few(clock: EvenClock) -> bool:
    """Whether a clock explains by its period a few steps of two quanta among those of one: there,
    rows are missing.
    """
    twice = float(clock.count[-1]) * (clock.period / clock.quantum - 1.0)
    return 0.5 < twice < FEW


def even_times(time: Array) -> Array:
    """Times, s, (n,), with stamps that are a rounding of an even clock put back to it."""
    if len(time) < 2 or not (np.diff(time) > 0).all():  # of no number neither
        return time
    clock = even_clock(time)
    return time if clock is None else time[0] + clock.period * clock.count


def usual_step(time: Array) -> float:
    """The usual time from row to row, s: the median, or of stamps with a coarse quantum the median
    of the means of short runs.
    """
    step = np.diff(time)
    usual = float(np.median(step))
    if len(step) < RUN or max(_quanta(time), default=0.0) < JITTER * usual:
        return usual
    whole = len(step) // RUN * RUN
    return float(np.median(step[:whole].reshape(-1, RUN).mean(axis=1)))


def _quanta(time: Array) -> list[float]:
    """The quanta to which stamps may be rounded, s, the finest first; none where no lattice is
    seen. Floating numbers have a coarser one at larger times, which few digits blur.
    """
    step = np.diff(time)
    parts = step, step[-(len(step) // 4) :]
    return sorted({_lattice(part, alike) for part in parts for alike in ALIKE} - {0.0})


def _lattice(step: Array, alike: float) -> float:
    """The difference of which all steps are whole multiples, 0 where there is none. ``alike``: part
    of the usual step within which steps are the same.
    """
    least = alike * float(np.median(step))
    ordered = np.sort(step)
    begins = np.r_[0, 1 + np.flatnonzero(np.diff(ordered) > least)]
    sizes = np.add.reduceat(ordered, begins) / np.diff(np.r_[begins, len(ordered)])
    if len(sizes) < 2:
        return 0.0
    quantum = float(min(np.min(np.diff(sizes)), sizes[0]))
    multiple = ordered / quantum  # every step: a smear of steps has a mean, too
    off = float(np.max(np.abs(multiple - np.round(multiple))))
    return quantum if off < ON_LATTICE else 0.0


def _runs(time: Array, quantum: float) -> list[tuple[int, int]]:
    """Runs of rows, first and last + 1, to begin with: long ones, and short ones in which no row is
    missing.
    """
    n = len(time)
    if n <= RUN:
        return []
    ends = np.linspace(0, n, PARTS + 1).astype(np.int64)
    begins = np.unique(np.linspace(0, n - RUN, min(RUNS, n // RUN)).astype(np.int64))
    one, other = np.triu_indices(RUN, 1)
    rows = time[begins[:, np.newaxis] + np.arange(RUN)]
    apart = rows[:, other] - rows[:, one]
    most = _most(quantum, float(np.median(np.diff(time))))
    # each pair of rows bounds the sample time
    clean = np.max((apart - most) / (other - one), axis=1) <= np.min(
        (apart + most) / (other - one), axis=1
    )
    found = begins[clean]
    chosen = np.unique(np.linspace(0, len(found) - 1, min(TRIED, len(found))).astype(np.int64))
    runs = [*pairwise(ends), *((first, first + RUN) for first in found[chosen])]
    return [(int(first), int(last)) for first, last in runs]


def _grown(time: Array, first: int, last: int, quantum: float) -> EvenClock | None:
    """The even clock that begins with the rows ``first`` to ``last - 1``, of which none is missing,
    and goes on to both ends; None where it breaks off.
    """
    n, here = len(time), [np.arange(last - first)]
    while True:
        clocks = (_clock(time[first:last], count, quantum) for count in here)
        found = next(filter(None, clocks), None)
        if found is None or last - first == n:
            return found
        left, period = time[first:last] - found.period * found.count, found.period
        low, high, most = float(left.min()), float(left.max()), _most(quantum, period)
        more = max(1, (last - first) // GROWN)
        first, last = max(0, first - more), min(n, last + more)
        # the stamps may go on in the middle of what is possible, or at either end of it
        middles = 0.5 * (low + high), low + most - 0.5 * period, high - most + 0.5 * period
        here = [np.round((time[first:last] - m) / period).astype(np.int64) for m in middles]


def _clock(time: Array, count: Counts, quantum: float) -> EvenClock | None:
    """The even clock by which rows have these numbers, from 0 on; None where there is none."""
    if (np.diff(count) < 1).any():
        return None
    period = _fitted(time, count, quantum)
    if _spread(time, count, period) > _most(quantum, period):
        return None
    return EvenClock(period, count - count[0], quantum)


def _fitted(time: Array, count: Counts, quantum: float) -> float:
    """The period by which even stamps are within the least distance of those given. That distance
    is a convex function of the period, and the ends bound it.
    """
    samples = max(1, int(count[-1] - count[0]))
    middle, half = (time[-1] - time[0]) / samples, quantum / samples
    low, high = middle - 2.0 * half, middle + 2.0 * half
    for _ in range(HALVINGS):
        away = GOLDEN * (high - low)
        if _spread(time, count, high - away) < _spread(time, count, low + away):
            high = low + away
        else:
            low = high - away
    return float(0.5 * (low + high))


def _spread(time: Array, count: Counts, period: float) -> float:
    """The width of the band about an even clock in which all stamps lie, s."""
    return float(np.ptp(time - period * count))


def _most(quantum: float, period: float) -> float:
    """The widest band of rounded stamps, s; of a period near the quantum all stamps would be in a
    wider one.
    """
    spare = min(JITTER * period, SPARE * (period - quantum))
    return quantum + max(spare, PRINTED * quantum) if period > (1.0 - PRINTED) * quantum else 0.0
