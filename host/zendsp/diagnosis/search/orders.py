"""Orders at which a torque repeats with the position, between and beyond the grids of the effects.

Behind a gear a motor's poles pass a hundred times a turn and more, and not a whole number of times;
a harmonic drive of ratio 50 errs 100 times. A spectrum over the angle, in place of a hypothesis
for each order, costs a Fourier transform.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects.axes import HARMONICS, LEAST_ORDER, PERIODS

Array = npt.NDArray[np.float64]

MOST_ORDERS = 4000
CELLS_OF_A_WAVE = 8  # of the position within the shortest wave
NEIGHBOURS = 64  # orders among which a peak stands out
PEAKS = 4  # the highest ones are tried
# chance that the highest of all orders looked at stands out by as much where nothing repeats
CHANCE_ORDER = 0.01


def finest(records: Sequence[JointRecord]) -> float:
    """The highest order that recordings of one joint show, 1/rad: a wave spans four counts of the
    position, and four samples at the typical speed.
    """
    first = records[0]
    counts, seen = first.measurement.resolution, first.scale.speed * first.sample_time
    return math.pi / (2.0 * max(counts, seen))


def outstanding(
    records: Sequence[JointRecord], series: Sequence[Array], least: float = HARMONICS
) -> list[float]:
    """The orders of a rotary joint above ``least`` at which a series repeats with the position, the
    clearest first.

    Parameters
    ----------
    records : sequence of JointRecord
        Of one joint.
    series : sequence of ndarray, shape (n,)
        One of each recording.

    Returns
    -------
    list of float
        1/rad. Each stands out of its neighbours by more than the highest of all that are looked at
        does by chance: a power r times the median has a chance of 2^-r.
    """
    first = records[0]
    apart = _apart(records)
    begin = math.ceil(least / apart) + 1
    end = min(math.floor(finest(records) / apart), begin + MOST_ORDERS)
    if first.slides or end - begin < 3:
        return []
    power = _spectrum(records, series, apart, end)[begin:]
    blocks = np.array_split(power, max(1, len(power) // NEIGHBOURS))
    usual = np.concatenate([np.full(len(b), np.median(b)) for b in blocks])
    clear = power / np.maximum(usual, 1e-300)
    sure = math.log2(len(power) / CHANCE_ORDER)
    best = [k for k in _tops(clear) if clear[k] > sure][:PEAKS]
    return [float(apart * (begin + k)) for k in best]


def between(records: Sequence[JointRecord], series: Sequence[Array]) -> list[float]:
    """The orders of a rotary joint up to ``HARMONICS`` at which a series repeats the most with the
    position, without those that a whole one stands for; none of a joint that turns less than a
    turn. Parameters as for `outstanding`.

    A wave that passes a few times a turn has side lobes, since the joint passes each place at other
    speeds: it need not stand out of its neighbours, but is the highest. What turns behind a gear
    repeats after several turns of its motor; these orders, among which trends lie, are apart.
    """
    apart = _apart(records)
    if records[0].slides or apart > 0.5:  # of the way from one whole order to the next
        return []
    fine = 0.5 * apart
    slow, first = math.ceil(2 * PERIODS * apart / fine), math.ceil(LEAST_ORDER / fine)
    power = _spectrum(records, series, fine, math.floor(HARMONICS / fine))
    found: list[float] = []
    for begin, end in ((slow, first), (first, len(power))):
        peaks = [fine * (begin + k) for k in _tops(power[begin:end])]
        found += [n for n in peaks if not round(n) or abs(n - round(n)) > apart][:PEAKS]
    return found


def _apart(records: Sequence[JointRecord]) -> float:
    """The distance of orders that the longest travel tells apart, 1/rad."""
    return math.pi / max(1e-9, *(float(np.ptp(r.motion.states[0])) for r in records))


def _tops(power: Array) -> list[int]:
    """Where a spectrum has its peaks, the highest first."""
    top = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:]))
    return sorted(top.tolist(), key=lambda k: -power[k])


def _spectrum(
    records: Sequence[JointRecord], series: Sequence[Array], apart: float, end: int
) -> Array:
    """The power of a series of position at the orders k ``apart``, k from 0 to ``end``."""
    cells = 2 * CELLS_OF_A_WAVE * end
    wide = 2.0 * math.pi / (apart * cells)
    sums = np.zeros(cells)
    for record, values in zip(records, series, strict=True):
        at = np.floor(record.motion.states[0] / wide).astype(np.int64) % cells
        sums += np.bincount(at, values, cells)
    return np.asarray(np.abs(np.fft.rfft(sums)[: end + 1]) ** 2)
