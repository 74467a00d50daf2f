"""A rolling picture, computed only where rows have come since the last one."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from zendsp.tui.scope.history import History
from zendsp.tui.scope.raster import envelope

Floats = npt.NDArray[np.float64]


class Rolling:
    """Keeps the dot columns of a rolling picture; those left of the newest row do not change.

    Column ``k`` lies between the times ``k·step`` and ``(k + 1)·step``, wherever it is drawn.
    """

    def __init__(self) -> None:
        self._of: tuple[History, float, int] | None = None  # history, step, columns
        self._latest = float("nan")  # s, of the newest row that was looked at
        self._first = 0  # column at the left border
        self._low = self._high = np.zeros((0, 0))

    def moves(self, history: History, step: float, columns: int) -> bool:
        """Whether there are rows that would change the picture."""
        latest = history.latest
        return self._of != (history, step, columns) or not (
            self._latest <= latest and math.floor(latest / step) == self._first + columns - 1
        )

    def look(self, history: History, step: float, columns: int) -> tuple[int, Floats, Floats]:
        """Return the column at the left border, and the lowest and highest values of all columns.

        Parameters
        ----------
        step : float
            Width of a column, s.
        columns : int
            Number of columns; the newest row is in the last one.

        Returns
        -------
        first : int
        low, high : ndarray, shape (columns, channels)
            As :func:`envelope` makes them of all rows.
        """
        latest = history.latest
        last = math.floor(latest / step) + 1 if math.isfinite(latest) else columns
        first = last - columns
        begin = first  # of what is made anew
        rolled = self._of == (history, step, columns) and self._latest <= latest
        if rolled and first >= self._first:
            begin = min(max(math.floor(self._latest / step), first), last)
        t, y = history.since(begin * step)
        fresh = envelope(t, y, begin * step, last * step, last - begin)
        if begin > first:
            kept = slice(first - self._first, begin - self._first)
            self._low = np.concatenate((self._low[kept], fresh[0]))
            self._high = np.concatenate((self._high[kept], fresh[1]))
        else:
            self._low, self._high = fresh
        self._of, self._latest, self._first = (history, step, columns), latest, first
        return first, self._low, self._high
