"""Live views: the newest samples of chosen channels, to iterate over, handed to a callback, or read
when wanted.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import zenoh

from zendsp.errors import LinkError, ZendspError
from zendsp.link.background import Listener, background
from zendsp.link.requests import Part, Requests
from zendsp_protocol import codec, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.views import curves, sentence

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]
else:
    np = Lazily("numpy")

# Messages that may wait for the thread that takes them. Zenoh keeps with each the whole packet of
# 64 kB that it came in: 17 MB, and a quarter of a second at the shortest interval.
WAITING = 256
SHOWN = 600  # points of a curve in a notebook
PICTURE_S = 0.2  # between pictures in a notebook
BACKLOG = 256  # blocks that an iterator may lag behind before the oldest are dropped


@dataclass(frozen=True)
class LiveBlock:
    """Rows that arrived together.

    Attributes
    ----------
    t : ndarray, shape (rows,), s
        Since the start of the program.
    data : ndarray, shape (rows, columns)
    tick : int
        Of the first row.
    gap : int
        Rows missing between the block before and this one.
    """

    t: FloatArray
    data: FloatArray
    tick: int
    gap: int


class _Window:
    """The last rows of a view, in two arrays, with a row of NaN where rows are missing.

    Blocks are not kept as they are: one of a single row takes ten times the memory of its numbers,
    and a thousand may come each second.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self._rows, self._end = rows, 0
        self._t, self._data = np.empty(0), np.empty((0, columns))

    def append(self, block: LiveBlock) -> None:
        """Add a block; of one that is longer than the window, its last rows."""
        if block.gap and self._end:
            self._put(block.t[:1], np.nan)
        self._put(block.t[-self._rows :], block.data[-self._rows :])

    def _put(self, t: FloatArray, data: FloatArray | float) -> None:
        if self._end + len(t) > len(self._t):  # room for as many rows again
            old_t, old = self.rows()
            self._end = len(old_t)
            room = min(2 * (self._end + len(t)), 2 * self._rows)
            self._t, self._data = np.empty(room), np.empty((room, old.shape[1]))
            self._t[: self._end], self._data[: self._end] = old_t, old
        new = slice(self._end, self._end + len(t))
        self._t[new], self._data[new] = t, data
        self._end = new.stop

    def newest(self) -> tuple[float, list[float]]:
        """Time and values of the last row."""
        return float(self._t[self._end - 1]), list(self._data[self._end - 1].tolist())

    def rows(self) -> tuple[FloatArray, FloatArray]:
        """Copies of times (N,) and data (N, columns)."""
        kept = slice(max(0, self._end - self._rows), self._end)
        return self._t[kept].copy(), self._data[kept].copy()


class LiveView:
    """A subscription to the newest samples; close it, or use it in a ``with``.

    There are three ways to read it: iterate over blocks, give a callback, or read `latest` and
    `window` whenever the screen is drawn (the cheapest).
    """

    def __init__(
        self,
        requests: Requests,
        asked: verbs.LiveOpen,
        history: float,
        callback: Callable[[LiveBlock], None] | None,
    ) -> None:
        self._requests = requests
        self._asked = asked
        self._callback = callback
        self._history = history
        self._lock = threading.Condition()
        self._closed = False
        self._subscriber: Listener | None = None
        self._stream = -1
        self._reset()
        self._open()
        requests.link.on_return(self._reopen)

    def _reset(self) -> None:
        self._blocks: deque[LiveBlock] = deque(maxlen=BACKLOG)
        self._window: _Window | None = None  # of the session that runs
        self._session = -1
        self._next_row = 0
        self.lost = 0
        self.received = 0

    def _open(self) -> None:
        opened: m.LiveOpened = self._requests.link.request("live_open", self._asked)
        self.columns = opened.channels
        self.units = opened.units
        self.sample_time = opened.sample_time
        self._rows_kept = max(1, round(self._history / opened.sample_time))
        self._rate = self._asked.decimation / opened.sample_time
        self._stream = opened.stream
        # A ring: a slow callback loses its own oldest rows (counted as lost), and never holds up
        # the link.
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(WAITING)
        subscriber = self._requests.link.session.declare_subscriber(opened.key, ring)
        self._subscriber = Listener(subscriber, self._take, "live")

    def _reopen(self) -> None:
        """Subscribe again after an outage, in which the target has forgotten this viewer."""
        if self._closed:
            return
        try:
            if self._subscriber is not None:
                self._subscriber.undeclare()
            self._open()
        except ZendspError:
            return  # the target lives but has no such program now; the view stays silent

    def _take(self, sample: zenoh.Sample) -> None:
        if sample.attachment is None:
            return
        try:
            header: m.LiveHeader = codec.decode(sample.attachment.to_bytes(), m.LiveHeader)
            data = np.frombuffer(sample.payload.to_bytes(), dtype="<f8").reshape(
                header.rows, len(header.columns)
            )
        except (LinkError, ValueError):
            return  # a message that is not ours, or damaged, is no reason to fall over
        t = (header.tick + header.decimation * np.arange(header.rows)) / self._rate
        with self._lock:
            fresh = header.session != self._session
            gap = 0 if fresh else max(0, header.first - self._next_row)
            self._session, self._next_row = header.session, header.first + header.rows
            self.lost += gap
            self.received += header.rows
            block = LiveBlock(t, data, header.tick, gap)
            if fresh or self._window is None:
                self._named(header.columns)
                self._window = _Window(self._rows_kept, len(header.columns))
            self._blocks.append(block)
            self._window.append(block)
            self._lock.notify_all()
        if self._callback is not None:
            self._callback(block)

    def _named(self, columns: tuple[str, ...]) -> None:
        """Take over the names of the columns: another program may have a longer array."""
        if columns != self.columns:
            units = {
                name.partition("[")[0]: unit
                for name, unit in zip(self.columns, self.units, strict=True)
            }
            self.units = tuple(units.get(name.partition("[")[0], "") for name in columns)
            self.columns = columns

    def __iter__(self) -> Iterator[LiveBlock]:
        """Yield blocks as they arrive, until the view is closed."""
        while (block := self.next_block()) is not None:
            yield block

    def next_block(self, timeout: float | None = None) -> LiveBlock | None:
        """Wait for the next block; None when the view is closed or ``timeout`` s have passed."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._lock:
            while not self._blocks and not self._closed:
                left = 0.2 if deadline is None else min(0.2, deadline - time.monotonic())
                if left <= 0.0:
                    return None
                self._lock.wait(left)
            return self._blocks.popleft() if self._blocks else None

    def latest(self) -> dict[str, float]:
        """The newest value of each column, with the time as ``t``; empty before the first sample.
        """
        with self._lock:
            if self._window is None:
                return {}
            t, row = self._window.newest()
            return {"t": t, **dict(zip(self.columns, row, strict=True))}

    def window(self) -> tuple[FloatArray, FloatArray]:
        """The last ``history`` s: times (N,) and data (N, columns), with one row of NaN for a gap.
        """
        with self._lock:
            if self._window is None:
                return np.empty(0), np.empty((0, len(self.columns)))
            return self._window.rows()

    def _skipped(self) -> str:
        """The number of rows that the view had no time for, in words; a recording keeps all."""
        return f", {self.lost} more not shown (a recording keeps all)" if self.lost else ""

    def __repr__(self) -> str:
        state = "closed" if self._closed else f"{self.received} rows{self._skipped()}"
        return f"<LiveView {', '.join(self.columns)}: {state}>"

    def _repr_html_(self) -> str:
        """The last ``history`` s as curves, a few hundred points of each."""
        t, data = self.window()
        step = max(1, len(t) // SHOWN)
        names = [
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(self.columns, self.units, strict=True)
        ]
        columns = [(name, data[::step, k].tolist()) for k, name in enumerate(names)]
        return curves(t[::step].tolist(), columns) + sentence(repr(self))

    def _ipython_display_(self) -> None:
        """Draw it in a notebook, and go on drawing until it is closed."""
        from IPython.display import display

        def picture() -> dict[str, str]:
            return {"text/html": self._repr_html_(), "text/plain": repr(self)}

        shown = display(picture(), raw=True, display_id=True)  # type: ignore[no-untyped-call]

        def draw() -> None:
            while not self._closed:
                time.sleep(PICTURE_S)
                shown.update(picture(), raw=True)

        background("live-picture", draw)

    def close(self) -> None:
        """End the subscription; the stream on the target ends with its last viewer."""
        if self._closed:
            return
        self._closed = True
        self._requests.link.forget(self._reopen)  # or the link would keep what this view holds
        with self._lock:
            self._lock.notify_all()
        if self._requests.link.closed:
            return
        if self._subscriber is not None:
            self._subscriber.undeclare()
        # Gone with the target, or noticed by it when this host's token vanishes.
        with contextlib.suppress(ZendspError):
            self._requests.request("live_close", stream=self._stream)

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LiveViews(Part):
    """Live views of a target's channels."""

    def live(
        self,
        *channels: str | Sequence[str],
        decimation: int = 1,
        interval: float = 0.001,
        history: float = 10.0,
        callback: Callable[[LiveBlock], None] | None = None,
    ) -> LiveView:
        """Follow channels live.

        Parameters
        ----------
        *channels : str, or sequence of str
            Variables, elements ``"q[0]"``, or built-in signals. As the last expression of a
            notebook's cell the view draws itself until it is closed.
        decimation : int
            Every how many samples a row is taken.
        interval : float, s
            Between messages at the least: 1 ms for the least lag, 20 ms for a screen at a fraction
            of the cost.
        history : float, s
            Kept for `LiveView.window`.
        callback : callable, optional
            Called with each `LiveBlock` in a thread of the view's own; a slow one loses
            rows.
        """
        names = [n for c in channels for n in ([c] if isinstance(c, str) else c)]
        asked = verbs.LiveOpen(channels=names, decimation=decimation, interval=interval)
        return LiveView(self._requests, asked, history, callback)
