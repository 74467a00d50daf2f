"""The rows of the scope: a ring of bounded size that one thread fills and the screen reads."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class History:
    """The newest rows of up to eight channels with their times; the oldest are overwritten.

    Parameters
    ----------
    channels : int
        Number of columns, 0 … 8.
    rows : int
        Capacity. At 1 kHz the default holds 131 s in 9 MB.
    """

    def __init__(self, channels: int, rows: int = 131_072) -> None:
        self.channels = channels
        self._rows = rows
        self._t = np.zeros(rows)
        self._y = np.zeros((rows, channels))
        self._count = 0  # rows written since the beginning, monotonic
        self._last_tick = -1
        self._step = 0
        self._lock = threading.Lock()

    def chosen(self, columns: Sequence[int]) -> History:
        """A history of other columns that keeps the rows so far; a column -1 is a new one, of NaN
        until now.
        """
        found = History(len(columns), self._rows)
        with self._lock:
            found._t[:] = self._t
            for k, column in enumerate(columns):
                found._y[:, k] = self._y[:, column] if column >= 0 else np.nan
            found._count, found._last_tick = self._count, self._last_tick
            found._step = self._step
        return found

    @property
    def count(self) -> int:
        """Rows written since the beginning; it changes exactly when there is something new to draw.
        """
        return self._count

    def append(self, ticks: npt.NDArray[np.int64], rows: Floats, period_s: float) -> None:
        """Add rows, newest last. A jump in the ticks leaves a row of NaN, so that the curve shows a
        gap.

        Parameters
        ----------
        ticks : ndarray of int64, shape (n,)
            Sample numbers. A number not above the last one means a restarted target: the history
            begins anew.
        rows : ndarray, shape (n, channels)
        period_s : float
            Time of one tick, s.
        """
        if len(ticks) == 0:
            return
        with self._lock:
            if ticks[0] <= self._last_tick:
                if ticks[-1] > self._last_tick and ticks[0] > self._last_tick - 10_000:
                    fresh = ticks > self._last_tick  # the same rows came twice
                    ticks, rows = ticks[fresh], rows[fresh]
                else:
                    self._count, self._step = 0, 0
            elif self._count and self._step and ticks[0] - self._last_tick > 2 * self._step:
                self._put(
                    np.array([(self._last_tick + self._step) * period_s]),
                    np.full((1, self.channels), np.nan),
                )
            if len(ticks) > 1:
                self._step = int(ticks[-1] - ticks[-2])
            self._put(np.asarray(ticks * period_s, dtype=np.float64), rows)
            self._last_tick = int(ticks[-1])

    def _put(self, t: Floats, y: Floats) -> None:
        n = len(t)
        if n > self._rows:
            t, y = t[-self._rows :], y[-self._rows :]
            self._count += n - self._rows
            n = self._rows
        at = self._count % self._rows
        room = min(n, self._rows - at)
        self._t[at : at + room], self._y[at : at + room] = t[:room], y[:room]
        self._t[: n - room], self._y[: n - room] = t[room:], y[room:]
        self._count += n

    def newest(self, most: int | None = None) -> tuple[Floats, Floats]:
        """Copies of the newest rows in order: times, shape (n,), and values, shape (n, channels).
        """
        with self._lock:
            n = min(self._count, self._rows, self._rows if most is None else most)
            end = self._count % self._rows
            if n <= end:
                return self._t[end - n : end].copy(), self._y[end - n : end].copy()
            old = slice(self._rows - (n - end), self._rows)
            return (
                np.concatenate((self._t[old], self._t[:end])),
                np.concatenate((self._y[old], self._y[:end])),
            )

    def since(self, start: float) -> tuple[Floats, Floats]:
        """Copies of the rows not older than ``start`` (s), and of the one before them."""
        with self._lock:
            held = min(self._count, self._rows)
            end = self._count % self._rows
            n = int(np.count_nonzero(self._recent(held, end) >= start)) if held else 0
        return self.newest(min(n + 1, held))

    def _recent(self, held: int, end: int) -> Floats:
        return self._t[:end] if held < self._rows else self._t

    @property
    def latest(self) -> float:
        """Time of the newest row, s; NaN where there is none."""
        with self._lock:
            return float(self._t[(self._count - 1) % self._rows]) if self._count else float("nan")

    def clear(self) -> None:
        """Drop all rows."""
        with self._lock:
            self._count, self._last_tick, self._step = 0, -1, 0
