"""Live streams: the newest samples of chosen channels, published as they come, at a bounded cost.

Rows that a slow viewer missed are skipped and counted, never queued: neither the loop nor the link
waits for a viewer.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from zendsp_protocol import messages as m
from zendsp_protocol.codec import encode
from zendsp_protocol.errors import Refused, ZendspError
from zendsp_protocol.states import Clock, RecorderState
from zendsp_protocol.version import PROTOCOL
from zendsp_target.api import AcquireConfig, RuntimeApi
from zendsp_target.threads import start_thread

log = logging.getLogger(__name__)
STREAMS = range(1, 8)
SHORTEST_S = 0.001  # between polls: half of the promised lag
LONGEST_S = 3600.0  # more is as good as never, and too much for the clocks
SHORTEST_FAST_S = 0.01  # where simulated time runs ahead, viewers cannot follow every row anyway
RING_S = 0.5  # of rows that are held, for a poll that is late
RETRY_S = 0.25  # after the stream's program went away
LOOK_S = 1.0  # between looks whether anybody still subscribes
UNWATCHED_S = 5.0  # then a stream ends: its viewer went without saying so


class Send(Protocol):
    """Publish one message of a stream to its viewers, given the names under which they are known.
    """

    def __call__(
        self, stream: int, users: frozenset[str], payload: bytes, header: bytes
    ) -> None: ...


@dataclass
class Stream:
    """One live stream and who looks at it."""

    number: int
    config: AcquireConfig
    interval: float
    window: int
    # hosts, and the names under which they are known
    viewers: dict[str, str] = field(default_factory=dict)
    users: frozenset[str] = frozenset()  # these names; an empty one for the target's own user
    session: int = 0
    columns: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    next_row: int = 0
    skipped: int = 0
    due: float = 0.0
    broken: bool = False
    look: float = 0.0  # when to look for subscribers next
    watched: float = field(default_factory=time.monotonic)  # when there was one last


class LiveStreams:
    """Polls the runtime's rings from one thread and publishes new rows."""

    def __init__(
        self, runtime: RuntimeApi, send: Send, watched: Callable[[int, frozenset[str]], bool]
    ) -> None:
        self._runtime = runtime
        self._send = send
        self._watched = watched
        self._lock = threading.RLock()
        self._streams: dict[int, Stream] = {}
        self._sessions = itertools.count(1)
        self._wake = threading.Event()
        self._end = False
        self._thread = start_thread("live", self._run)

    def open(
        self,
        channels: list[str],
        decimation: int,
        interval: float,
        window: int,
        viewer: str,
        user: str = "",
    ) -> Stream:
        """Open a stream, or join one of the same channels; return its number.

        Parameters
        ----------
        decimation : int
            Samples per row.
        interval : float
            s between messages at the least.
        window : int
            Rows of one message at the most.
        viewer : str
            The host.
        user : str
            Name under which it is known; empty for the target's own user.

        Raises
        ------
        Refused
            All seven are in use by others.
        AcquisitionError
            No such channel.
        """
        status = self._runtime.status()
        sample_time = decimation / status.rate_hz
        shortest = SHORTEST_S if status.clock == Clock.REAL else SHORTEST_FAST_S
        interval = min(max(shortest, interval), LONGEST_S)
        window = max(1, min(window, 1 << 16))
        ring = max(RING_S, 2 * window * sample_time if status.clock == Clock.FAST else 0.0)
        config = AcquireConfig(tuple(channels), decimation, seconds=ring, continuous=True)
        with self._lock:
            for stream in self._streams.values():
                if (
                    stream.config.channels == config.channels
                    and stream.config.decimation == decimation
                ):
                    self._look(stream, {**stream.viewers, viewer: user})
                    stream.watched = time.monotonic()
                    stream.interval = min(stream.interval, interval)
                    stream.due = min(stream.due, time.monotonic() + interval)
                    stream.window = max(stream.window, window)
                    self._wake.set()
                    return stream
            free = [number for number in STREAMS if number not in self._streams]
            if not free:
                users = sorted(
                    {viewer for stream in self._streams.values() for viewer in stream.viewers}
                )
                raise Refused(
                    f"all {len(STREAMS)} live streams are in use by {', '.join(users)}; close one"
                )
            stream = Stream(free[0], config, interval, window)
            self._look(stream, {viewer: user})
            self._start(stream)
            self._streams[stream.number] = stream
        self._wake.set()
        return stream

    def close_stream(self, number: int, viewer: str) -> None:
        """Leave a stream; it ends with its last viewer."""
        with self._lock:
            stream = self._streams.get(number)
            if stream is None:
                return
            self._look(
                stream, {other: user for other, user in stream.viewers.items() if other != viewer}
            )

    def forget(self, viewer: str) -> None:
        """Leave all streams of a host that is gone."""
        with self._lock:
            for number in list(self._streams):
                self.close_stream(number, viewer)

    def keep(self, may_look: Callable[[str], bool]) -> None:
        """End the views of users who may no longer look."""
        with self._lock:
            for stream in list(self._streams.values()):
                kept = {viewer: user for viewer, user in stream.viewers.items() if may_look(user)}
                if len(kept) < len(stream.viewers):
                    self._look(stream, kept)

    def _look(self, stream: Stream, viewers: dict[str, str]) -> None:
        """Set the viewers of a stream; it ends with the last one."""
        stream.viewers, stream.users = viewers, frozenset(viewers.values())
        if not viewers and self._streams.pop(stream.number, None) is not None:
            self._stop(stream.number)

    def close(self) -> None:
        """End the thread and all streams."""
        self._end = True
        self._wake.set()
        self._thread.join(2.0)
        with self._lock:
            for number in list(self._streams):
                self._stop(number)
            self._streams.clear()

    def _start(self, stream: Stream) -> None:
        status = self._runtime.acquire_configure(stream.number, stream.config)
        self._runtime.acquire_start(stream.number)
        stream.columns, stream.units = status.channels, status.units
        stream.session = next(self._sessions)
        stream.next_row, stream.broken = 0, False

    def _stop(self, number: int) -> None:
        try:
            self._runtime.acquire_stop(number)
        except ZendspError as error:
            log.debug("live stream %d was gone already: %s", number, error)

    def _run(self) -> None:
        while not self._end:
            with self._lock:
                now = time.monotonic()
                for stream in list(self._streams.values()):
                    if now >= stream.look and self._abandoned(stream, now):
                        del self._streams[stream.number]
                        self._stop(stream.number)
                    elif now >= stream.due:
                        stream.due = now + self._serve(stream)
                due = min((min(s.due, s.look) for s in self._streams.values()), default=None)
            if due is None:
                self._wake.wait()
                self._wake.clear()
            else:
                # a viewer that comes meanwhile does not wait for those before it
                self._wake.wait(max(0.0, due - time.monotonic()))
                self._wake.clear()

    def _abandoned(self, stream: Stream, now: float) -> bool:
        """Whether nobody has subscribed for long enough; subscribers are counted only once in a
        while.
        """
        stream.look = now + LOOK_S
        if self._watched(stream.number, stream.users):
            stream.watched = now
        return now - stream.watched > UNWATCHED_S

    def _serve(self, stream: Stream) -> float:
        """Publish new rows and return the time to wait, s."""
        try:
            if stream.broken:
                self._start(stream)
            status = self._runtime.acquire_status(stream.number)
            # a new program was loaded: its rings are new as well
            if status.state in (RecorderState.IDLE, RecorderState.DONE):
                stream.broken = True
                return RETRY_S
            first = max(stream.next_row, status.first, status.count - stream.window)
            if status.count <= first:
                return stream.interval
            rows = self._runtime.acquire_read(stream.number, first, status.count - first)
        except (ZendspError, OSError) as error:  # no file is left, or no memory
            if not stream.broken:
                log.debug("live stream %d waits: %s", stream.number, error)
            stream.broken = True
            return RETRY_S
        # a message has no place for a gap: what follows one is a message of its own
        cuts = [row for row, _ in status.gaps if first < row < first + len(rows)]
        for begin, end in itertools.pairwise((first, *cuts, first + len(rows))):
            self._publish(stream, status, begin, rows[begin - first : end - first])
        return stream.interval

    def _publish(
        self, stream: Stream, status: Any, first: int, rows: npt.NDArray[np.float64]
    ) -> None:
        stream.skipped += first - stream.next_row
        stream.next_row = first + len(rows)
        missing = max((missed for row, missed in status.gaps if row <= first), default=0)
        header = m.LiveHeader(
            v=PROTOCOL,
            session=stream.session,
            first=first,
            rows=len(rows),
            columns=stream.columns,
            tick=status.start_tick + (first + missing) * status.decimation,
            decimation=status.decimation,
            lost=stream.skipped,
        )
        self._send(stream.number, stream.users, rows.tobytes(), encode(header))
