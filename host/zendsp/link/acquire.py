"""Acquisition: configure, start, load in checked chunks, and the Recording with all its circumstances."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, LinkError, Refused, RunnerDied
from zendsp.link.parameters import ParameterSets
from zendsp.link.variables import plain
from zendsp.recording import Channel, ParameterChange, Recording
from zendsp.recording.names import split_element
from zendsp_protocol import codec
from zendsp_protocol import messages as m
from zendsp_protocol.chunks import folded_crc, gaps
from zendsp_protocol.version import PROTOCOL

FloatArray = npt.NDArray[np.float64]
Trigger = m.Trigger
PATIENCE_S = 30.0  # for a broken link to come back
REQUEST_BYTES = 64 << 20  # rows asked for at once: what is lost at most when the link breaks
POLL_S = 0.02


class Rows:
    """Rows as they arrive, each chunk checked and put in its place."""

    def __init__(self, columns: int, rows: int) -> None:
        self.data: FloatArray = np.empty((rows, columns))
        self.pieces: list[tuple[int, int]] = []
        self.origin = 0

    def take(self, attachment: bytes, payload: bytes) -> None:
        """Accept one chunk.

        Raises
        ------
        AcquisitionError
            Its checksum or its size is wrong; what came before is kept.
        """
        header: m.ChunkHeader = codec.decode(attachment, m.ChunkHeader)
        if folded_crc(payload) != header.crc or len(payload) != 8 * header.rows * header.columns:
            raise AcquisitionError(
                f"rows {header.first}…{header.first + header.rows} arrived damaged (checksum)"
            )
        place = header.first - self.origin
        self.data[place : place + header.rows] = np.frombuffer(payload, "<f8").reshape(
            header.rows, header.columns
        )
        self.pieces.append((header.first, header.rows))

    @property
    def count(self) -> int:
        """Rows received."""
        return sum(rows for _, rows in self.pieces)


class Acquisition(ParameterSets):
    """Methods of a target that concern acquisition."""

    def acquire(
        self,
        channels: Sequence[str],
        seconds: float,
        decimation: int = 1,
        trigger: Trigger | None = None,
        start: bool = False,
        take: bool = False,
        note: str = "",
        progress: Callable[[float], None] | None = None,
        timeout: float | None = None,
        patience: float = PATIENCE_S,
    ) -> Recording:
        """Record channels for some time and bring the data home.

        Parameters
        ----------
        channels : sequence of str
            Variables, elements ``"q[0]"``, or built-in signals.
        seconds : float, s
            Of the target's time.
        decimation : int
            Every how many samples a row is taken.
        trigger : Trigger, optional
            Wait for ``source`` to cross ``level``; ``pre_s`` seconds before it are kept.
        start : bool
            Also start the (loaded or paused) program together with the recording and pause it afterwards: the first row is
            the first sample, and on the fast clock the result is the same each time.
        take : bool
            Also when another host is recording.
        note : str
            Kept in the recording.
        progress : callable, optional
            Called with the fraction done.
        timeout : float, s, optional
            Of real time, for the data to be complete. Default: none with a trigger, else twice the time plus 10 s.
        patience : float, s
            For a broken link to come back; the transfer resumes where it stopped.

        Returns
        -------
        Recording
            ``lost`` counts what the target could not keep; zero is the promise.

        Raises
        ------
        AcquisitionError
            No such channel, or more rows than the target can keep.
        Refused
            The program does not run, or another host is recording.
        RunnerDied
            The program crashed meanwhile; :meth:`acquire_load` brings home what was recorded until then.
        """
        status: m.Status = self.request("status")
        if status.state != "running" and not start:
            raise Refused(
                f"nothing to record: the program is {status.state}; start it first, or give start=True"
            )
        self.acquire_configure(channels, seconds, decimation, trigger, take=take)
        self.request("acquire_start")
        if start:
            # The row of the last wanted sample is written in that sample: so many ticks and not one more.
            self.request("start", ticks=max(1, round(seconds * status.rate_hz)))
        if timeout is None and trigger is None:
            timeout = 2.0 * seconds + 10.0
        return self.acquire_finish(timeout, note, progress, patience)

    def acquire_configure(
        self,
        channels: Sequence[str],
        seconds: float = 1.0,
        decimation: int = 1,
        trigger: Trigger | None = None,
        continuous: bool = False,
        take: bool = False,
    ) -> m.AcquireStatus:
        """Set what the recorder records; ``continuous`` keeps the last ``seconds`` in a ring until stopped."""
        names = [channels] if isinstance(channels, str) else list(channels)
        result: m.AcquireStatus = self.request(
            "acquire_configure",
            channels=names,
            seconds=seconds,
            decimation=decimation,
            trigger=trigger,
            continuous=continuous,
            take=take,
        )
        return result

    def acquire_start(self, force: bool = False) -> None:
        """Start or arm the recorder; ``force`` fires the trigger by hand."""
        self.request("acquire_start", force=force)

    def acquire_stop(self) -> None:
        """Stop the recorder; what it holds stays loadable."""
        self.request("acquire_stop")

    def acquire_status(self) -> m.AcquireStatus:
        """State of the recorder."""
        result: m.AcquireStatus = self.request("acquire_status")
        return result

    def acquire_load(
        self, note: str = "", progress: Callable[[float], None] | None = None, patience: float = PATIENCE_S
    ) -> Recording:
        """Bring home what the recorder holds, also after a crash of the program.

        Raises
        ------
        AcquisitionError
            Nothing was recorded.
        """
        status: m.AcquireStatus = self._insist("acquire_status", patience)
        if status.count <= status.first:
            raise AcquisitionError(
                f"nothing was recorded (the recorder is {status.state}); start it and the program"
            )
        data = self.load_rows(
            status.first, status.count - status.first, len(status.channels), progress, patience
        )
        return self._recording(status, status.first, data, note, patience)

    def acquire_finish(
        self,
        timeout: float | None = 60.0,
        note: str = "",
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> Recording:
        """Wait until the recorder has all it wants and load it; a continuous ring is stopped as it is.

        Parameters
        ----------
        timeout : float, s, optional
            Of real time; None waits for ever.

        Raises
        ------
        AcquisitionError
            Not complete within ``timeout``, or the program no longer runs.
        RunnerDied
            The program crashed; :meth:`acquire_load` brings home what there is.
        """
        status: m.AcquireStatus = self._insist("acquire_status", patience)
        if status.wanted == 0 and status.state == "running":
            self.acquire_stop()
        self._wait_done(timeout, patience, progress)
        return self.acquire_load(note, None, patience)

    def load_rows(
        self,
        first: int,
        count: int,
        columns: int,
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> FloatArray:
        """Load rows of the recorder, shape ``(count, columns)``; resumes after a broken link."""
        rows = Rows(columns, count)
        rows.origin = first
        each = max(1, REQUEST_BYTES // (8 * columns))
        while missing := gaps(rows.pieces, first, count):
            start, length = missing[0]
            arguments = {"first": start, "count": min(length, each)}
            try:
                self.link.stream("acquire_read", arguments, rows.take)
            except LinkError:
                if self.link.closed or not self.link.wait_alive(patience):
                    raise
            if progress is not None:
                progress(rows.count / count)
        return rows.data

    def _insist(self, verb: str, patience: float, **arguments: Any) -> Any:
        """Send a request that does no harm when repeated, again after each outage."""
        while True:
            try:
                return self.request(verb, **arguments)
            except LinkError:
                if self.link.closed or not self.link.wait_alive(patience):
                    raise

    def _wait_done(
        self, timeout: float | None, patience: float, progress: Callable[[float], None] | None
    ) -> m.AcquireStatus:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            status: m.AcquireStatus = self._insist("acquire_status", patience)
            if progress is not None and status.wanted:
                progress(min(1.0, (status.count - status.first) / status.wanted))
            if status.state in ("done", "idle") and status.count - status.first >= status.wanted:
                return status
            overall: m.Status = self._insist("status", patience)
            if overall.state == "crashed":
                raise RunnerDied(f"{overall.crash}. What was recorded until then: acquire_load()")
            if status.state in ("done", "idle"):
                return status  # ended before it was full, by a host
            if overall.state != "running" and self._insist("acquire_status", patience).state not in (
                "done",
                "idle",
            ):
                self.request("acquire_stop")
                raise AcquisitionError(
                    f"the program was {overall.state} before the recording was complete "
                    f"({status.count} of {status.wanted} rows); acquire_load() brings home what there is"
                )
            if deadline is not None and time.monotonic() > deadline:
                raise AcquisitionError(
                    f"the recording is not complete after {timeout:g} s ({status.count} of {status.wanted} rows, "
                    f"{status.state}); acquire_load() brings home what there is"
                )
            time.sleep(POLL_S)

    def _recording(
        self, status: m.AcquireStatus, first: int, data: FloatArray, note: str, patience: float
    ) -> Recording:
        overall: m.Status = self._insist("status", patience)
        program: m.Program = self._insist("program", patience)
        info: m.Info = self._insist("info", patience)
        start_tick = status.start_tick + first * status.decimation
        ticks = start_tick + status.decimation * np.arange(len(data))
        last = int(ticks[-1]) if len(ticks) else 0
        log = [
            change for change in self._insist("log", patience, since=program.log_start) if change.tick <= last
        ]
        try:
            parameters = dict(self.parameters().values)
        except (Refused, RunnerDied, LinkError):
            parameters = {}  # the program is gone; its log still tells
        return Recording(
            t=ticks / overall.rate_hz,
            data=data,
            channels=join_channels(status.channels, status.units),
            sample_time=status.decimation / overall.rate_hz,
            start_tick=start_tick,
            decimation=status.decimation,
            trigger_row=status.trigger_row - first if status.trigger_row >= 0 else -1,
            lost=status.lost,
            timing=_plain_timing(overall.timing),
            log=tuple(_change(change) for change in log),
            parameters=parameters,
            sources=dict(program.sources),
            compiler=program.compiler,
            flags=tuple(program.flags),
            machine=overall.machine,
            target=self.link.target,
            versions={**info.versions, "protocol": str(PROTOCOL), "host": _host_version()},
            created=time.time(),
            note=note,
            extra={"program": overall.program, "scheduling": overall.scheduling, "clock": overall.clock},
        )


def join_channels(columns: Sequence[str], units: Sequence[str]) -> tuple[Channel, ...]:
    """Turn the target's list of columns into channels: a run ``q[0], q[1], …`` is one vector ``q``."""
    channels: list[Channel] = []
    for name, unit in zip(columns, units, strict=True):
        element = split_element(name)
        if element and element[1] > 0 and channels and channels[-1] == Channel(element[0], unit, element[1]):
            channels[-1] = Channel(element[0], unit, element[1] + 1)
        elif element and element[1] == 0:
            channels.append(Channel(element[0], unit, 1))
        else:
            channels.append(Channel(name, unit))
    vectors = {c.name for c in channels if c.width > 1}
    alone = {name for name in columns if (e := split_element(name)) and e[1] == 0 and e[0] not in vectors}
    return tuple(Channel(f"{c.name}[0]", c.unit) if f"{c.name}[0]" in alone else c for c in channels)


def _plain_timing(timing: m.Timing) -> dict[str, Any]:
    return {name: plain(value) for name, value in msgspec.structs.asdict(timing).items()}


def _change(change: m.Change) -> ParameterChange:
    return ParameterChange(
        change.tick, change.host_time, change.name, plain(change.old), plain(change.new), change.author
    )


def _host_version() -> str:
    return f"zendsp {metadata.version('zendsp')}, python {platform.python_version()}"
