"""Orders at which a torque repeats with the position, beyond the grids of the effects.

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
from zendsp.physics.effects.axes import HARMONICS

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
    along = [r.motion.states[0] for r in records]
    span = max(float(np.ptp(q)) for q in along)
    apart = math.pi / max(span, 1e-9)
    begin = math.ceil(least / apart) + 1
    end = min(math.floor(finest(records) / apart), begin + MOST_ORDERS)
    if first.slides or end - begin < 3:
        return []
    # a transform of so many cells of the position has the orders k * apart
    cells = 2 * CELLS_OF_A_WAVE * end
    wide = 2.0 * math.pi / (apart * cells)
    sums = np.zeros(cells)
    for q, values in zip(along, series, strict=True):
        sums += np.bincount(np.floor(q / wide).astype(np.int64) % cells, values, cells)
    power = np.abs(np.fft.rfft(sums)[begin : end + 1]) ** 2
    blocks = np.array_split(power, max(1, len(power) // NEIGHBOURS))
    usual = np.concatenate([np.full(len(b), np.median(b)) for b in blocks])
    clear = power / np.maximum(usual, 1e-300)
    top = 1 + np.flatnonzero((clear[1:-1] >= clear[:-2]) & (clear[1:-1] >= clear[2:]))
    sure = math.log2(len(power) / CHANCE_ORDER)
    best = sorted(top[clear[top] > sure], key=lambda k: -clear[k])[:PEAKS]
    return [float(apart * (begin + k)) for k in best]
