"""Turns curves into braille dots, with NumPy only; it knows nothing of terminals.

A terminal cell holds 2 × 4 dots. A curve is reduced to the interval of values that it takes within
each dot column, so that a spike of one sample is seen at any zoom. The intervals are filled into a
raster of booleans; eight booleans make one character.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

# Unicode braille: bit of each dot within a cell, rows from top to bottom, columns from left to
# right.
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
DOTS_X, DOTS_Y = 2, 4


def envelope(t: Floats, y: Floats, start: float, end: float, columns: int) -> tuple[Floats, Floats]:
    """Return the lowest and highest value of each curve within each dot column.

    The curve is taken as straight lines between samples. The values at the column borders count for
    both neighbours, so that a drawn curve is connected, however few or many samples a column holds;
    a NaN opens a gap.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times in s, increasing.
    y : ndarray, shape (n, channels)
        Values; NaN or infinity where there is none.
    start, end : float
        Left and right border of the picture, s, ``end > start``.
    columns : int
        Number of dot columns.

    Returns
    -------
    low, high : ndarray, shape (columns, channels)
        NaN where a curve has no value.
    """
    channels = y.shape[1]
    low = np.full((columns, channels), np.nan)
    high = np.full((columns, channels), np.nan)
    if len(t) == 0 or columns < 1 or not end > start:
        return low, high
    first = max(int(np.searchsorted(t, start, "left")) - 1, 0)
    last = min(int(np.searchsorted(t, end, "right")) + 1, len(t))
    x = (t[first:last] - start) * (columns / (end - start))
    part = np.where(np.isfinite(y[first:last]), y[first:last], np.nan)

    inside = (x >= 0.0) & (x <= columns)
    if inside.any():
        column = np.minimum(x[inside].astype(np.int64), columns - 1)
        begins = np.flatnonzero(np.diff(column, prepend=-1))
        low[column[begins]] = np.fmin.reduceat(part[inside], begins, axis=0)
        high[column[begins]] = np.fmax.reduceat(part[inside], begins, axis=0)

    borders = np.arange(columns + 1, dtype=np.float64)
    for k in range(channels):
        at = np.interp(borders, x, part[:, k], left=np.nan, right=np.nan)
        low[:, k] = np.fmin(low[:, k], np.fmin(at[:-1], at[1:]))
        high[:, k] = np.fmax(high[:, k], np.fmax(at[:-1], at[1:]))
    return low, high


def fill(low: Floats, high: Floats, bottom: float, top: float, rows: int) -> npt.NDArray[np.bool_]:
    """Return the raster of one curve: every dot between ``low`` and ``high`` of its column is set.

    Parameters
    ----------
    low, high : ndarray, shape (columns,)
        As from :func:`envelope`.
    bottom, top : float
        Values at the lowest and the highest dot row, ``top > bottom``. What lies outside is clipped
        away.
    rows : int
        Number of dot rows.

    Returns
    -------
    ndarray of bool, shape (rows, columns)
    """
    seen = np.isfinite(low) & np.isfinite(high) & (high >= bottom) & (low <= top)
    scale = (rows - 1) / (top - bottom)
    upper = np.where(
        seen, np.rint((top - np.where(seen, np.minimum(high, top), top)) * scale), rows
    )
    lower = np.where(
        seen, np.rint((top - np.where(seen, np.maximum(low, bottom), top)) * scale), -1
    )
    row = np.arange(rows)[:, None]
    return np.asarray((row >= upper) & (row <= lower))


def encode(dots: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """Pack a dot raster into braille cells.

    Parameters
    ----------
    dots : ndarray of bool, shape (4·height, 2·width)

    Returns
    -------
    ndarray of uint8, shape (height, width)
        The low byte of the character U+2800 + code; 0 is an empty cell.
    """
    bits = dots.view(np.uint8)
    code = np.zeros((dots.shape[0] // DOTS_Y, dots.shape[1] // DOTS_X), dtype=np.uint8)
    for (row, column), bit in np.ndenumerate(_BITS):
        code |= bits[row::DOTS_Y, column::DOTS_X] * bit
    return code


def braille(codes: npt.NDArray[np.uint8]) -> str:
    """Return one row of cell codes as text; empty cells become spaces."""
    points = codes.astype("<u4") + 0x2800
    points[codes == 0] = 0x20
    return points.tobytes().decode("utf-32-le")
