"""Where a curve crosses the trigger level."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def last_crossing(t: Floats, y: Floats, level: float, edge: str, latest: float) -> float | None:
    """The time of the newest crossing not after ``latest``, interpolated linearly between samples;
    None where there is none.

    Parameters
    ----------
    t, y : ndarray, shape (n,)
        Times in s and values of the source; crossings next to a NaN do not count.
    level : float
        Trigger level in the unit of ``y``.
    edge : str
        ``"rising"``, ``"falling"`` or ``"both"``.
    latest : float
        s; leaves room for what must be shown after the trigger.
    """
    above = y >= level
    with np.errstate(invalid="ignore"):
        rising = ~above[:-1] & above[1:]
        falling = above[:-1] & ~above[1:]
    hit = rising if edge == "rising" else falling if edge == "falling" else rising | falling
    hit &= np.isfinite(y[:-1]) & np.isfinite(y[1:]) & (t[1:] <= latest)
    where = np.flatnonzero(hit)
    if len(where) == 0:
        return None
    i = int(where[-1])
    share = (level - y[i]) / (y[i + 1] - y[i])
    return float(t[i] + share * (t[i + 1] - t[i]))
