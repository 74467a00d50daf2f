"""Where a drive cuts a command off, if a recording shows it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.physics.kernel.signals import find_resolution

Array = npt.NDArray[np.float64]
SEVERAL = 3  # updates in a row, and visits: once may be chance, twice a coincidence
SAME = 1e-3  # of the largest command: values that differ by less than half of this are the same
# A smooth maximum of curvature c is within a depth d of its top for 2 sqrt(2 d / c). Where a step
# below the top is as deep as the part of the top's own step, or deeper, this is sqrt(2) times as
# long with it. At a limit the command arrives with a slope, and it is hardly longer.
ROUNDED = 2**0.5


def is_cut_off(command: Array) -> bool:
    """Whether a command stays flat at its largest value, for several updates in several visits, as
    it does at a limit and not at a rounded peak.

    Parameters
    ----------
    command : ndarray, shape (n,)
        Of one joint, any unit, either sign. A value that stays until the next update, as where rows
        are faster than the loop, is one update.
    """
    size = np.abs(command[np.isfinite(command)])
    peak = float(size.max(initial=0.0))
    step = max(find_resolution(size), SAME * peak)
    top, beside = size > peak - 0.5 * step, size > peak - 1.5 * step
    if peak <= 0 or np.count_nonzero(beside) >= ROUNDED * np.count_nonzero(top):
        return False
    lengths, highest = _runs(np.where(top, peak, size))
    others = lengths[highest < peak]
    if not len(others):  # of a command with one level nobody knows who chose it
        return False
    visits = lengths[highest == peak] >= SEVERAL * np.median(others)
    return int(np.count_nonzero(visits)) >= SEVERAL


def _runs(values: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """The lengths of stretches of one value, and these values."""
    ends = np.flatnonzero(np.append(np.diff(values) != 0, True))
    return np.diff(ends, prepend=-1), values[ends]
