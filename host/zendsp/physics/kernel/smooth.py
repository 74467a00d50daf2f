"""Rows smoothed along time as scipy has it: importing its filters takes a second."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# beyond the ends: the row mirrored, or its last value
Ends = Literal["symmetric", "edge"]
ROWS = 4096  # of which the windows are sorted at a time


def moving_mean(x: npt.NDArray[Any], width: int, ends: Ends = "symmetric") -> Array:
    """Mean of ``width`` values about each value of a row, (n,); one more before than after where
    that is even.
    """
    row = np.pad(np.asarray(x, np.float64), (width // 2, width - width // 2 - 1), ends)
    first = np.cumsum(row[:width])[-1]
    return np.asarray(np.cumsum(np.concatenate([[first], row[width:] - row[:-width]])) / width)


def gaussian(rows: Array, sigma: float) -> Array:
    """Rows (rows, n) smoothed with a Gaussian of standard deviation ``sigma`` samples; beyond the
    ends they keep their last values.
    """
    reach = int(4.0 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    padded = np.pad(rows, ((0, 0), (reach, reach)), "edge")
    return np.stack([np.convolve(row, weights / weights.sum(), mode="valid") for row in padded])


def lowpassed(row: Array, cutoff: float, rate: float) -> Array:
    """A row (n,) without what is faster than ``cutoff`` Hz: a Butterworth filter of fourth order,
    forwards and backwards, at ``rate`` Hz; beyond its ends the row is turned about them.
    """
    turned = np.pad(row, len(row) - 1, "reflect", reflect_type="odd")
    at = np.fft.rfftfreq(len(turned), 1.0 / rate)
    with np.errstate(over="ignore"):
        warped = np.tan(np.pi * at / rate) / np.tan(np.pi * cutoff / rate)
        gain = 1.0 / (1.0 + warped**8)
    slow = np.fft.irfft(np.fft.rfft(turned) * gain, len(turned))
    return np.asarray(slow[len(row) - 1 :][: len(row)])


def polynomial(
    x: npt.NDArray[Any], window: int, degree: int, order: int = 0, step: float = 1.0,
    ends: Literal["interp", "wrap"] = "interp",
) -> Array:
    """Rows along time, (n,) or (n, columns), or their derivative of an ``order``, by the polynomial
    through ``window`` (odd) samples about each (Savitzky and Golay 1964). The first and the last
    half window are read off the first and the last polynomial; with "wrap", the row is a period.
    """
    rows = np.asarray(x, np.float64)
    flat, half = rows.reshape(len(rows), -1), window // 2
    at = np.arange(-half, half + 1) / max(half, 1)  # of order one: the powers stay apart
    # from the samples of a window to the coefficients of its polynomial
    solve = np.linalg.pinv(np.vander(at, degree + 1, increasing=True))
    read = np.zeros((window, degree + 1))  # from these to what is asked for, at each sample
    for power in range(order, degree + 1):
        read[:, power] = math.perm(power, order) * at ** (power - order)
    weights = read @ solve / (step * max(half, 1)) ** order
    long = np.pad(flat, ((half, half), (0, 0)), "wrap")
    kernel = weights[half, ::-1]
    out = np.column_stack([np.convolve(column, kernel, "valid") for column in long.T])
    if ends == "interp":
        out[:half], out[-half:] = weights[:half] @ flat[:window], weights[-half:] @ flat[-window:]
    return np.asarray(out.reshape(rows.shape), np.float64)


def widened(mask: npt.NDArray[np.bool_], around: int) -> npt.NDArray[np.bool_]:
    """Where a mask (n,) is true within so many samples before and after."""
    count = np.cumsum(np.pad(mask, (around + 1, around)))
    return np.asarray(count[2 * around + 1 :] > count[: len(mask)])


def moving_median(row: Array, width: int) -> Array:
    """Median of ``width`` values about each value of a row, (n,), whose last values go on beyond
    it; one more before than after, and the upper of two medians, where that is even.
    """
    whole = np.pad(row, (width // 2, width - width // 2 - 1), "edge")
    windows = np.lib.stride_tricks.sliding_window_view(whole, width)
    some = [windows[i : i + ROWS] for i in range(0, len(row), ROWS)]  # each is copied
    return np.concatenate([np.partition(w, width // 2, axis=1)[:, width // 2] for w in some])
