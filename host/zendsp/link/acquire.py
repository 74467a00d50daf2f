"""Acquisition: configure, start, wait or follow, and bring the Recording home."""

from __future__ import annotations

import contextlib
import numbers
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import msgspec

from zendsp.errors import (
    AcquisitionError,
    Refused,
    TooLarge,
    ZendspError,
)
from zendsp.here.uninterrupted import uninterrupted
from zendsp.link.parameters import ParameterSets
from zendsp.link.requests import PATIENCE_S, Requests
from zendsp.link.transfer import Transfers, need_channels, room
from zendsp.link.wait_recorded import ENDED, POLL_S, wait_done
from zendsp.prompt import shows_progress
from zendsp_protocol import messages as m
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.states import Clock, ProgramState, RecorderState

if TYPE_CHECKING:
    import numpy as np

    from zendsp.recording import Recording
    from zendsp.recording.names import FloatArray
else:
    np = Lazily("numpy")

Trigger = m.Trigger
END_S = 2.0  # for the loop to see that a ring was stopped
SHORTEST_RING_S = 0.25  # a shorter one could not be followed on a busy machine


def _check_seconds(seconds: object) -> None:
    """Refuse a time that is no positive number of seconds; the message names the argument."""
    if not isinstance(seconds, numbers.Real) or isinstance(seconds, bool):
        raise AcquisitionError(f"seconds = {seconds!r}: give a number, in s, for example 2.0")


class Recorder(Transfers):
    """The recorder of a target: acquisitions, and their rows brought to this host.

    Parameters
    ----------
    requests : Requests
    parameters : ParameterSets
        Of the same target: every recording carries them.
    """

    def __init__(self, requests: Requests, parameters: ParameterSets) -> None:
        super().__init__(requests)
        self._parameters = parameters

    @shows_progress
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
        pauses: bool = True,
    ) -> Recording:
        """Record channels for some time and return the recording. Ctrl-C, and an error of
        ``progress``, end the recording on the target too; `acquire_load` then returns what was
        recorded.

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
            Also start the (loaded or paused) program together with the recording and pause it
            afterwards: the first row is the first sample, and on the fast clock the result is the
            same each time.
        take : bool
            Also when another host is recording.
        note : str
            Kept in the recording.
        progress : callable, optional
            Called with the fraction done.
        timeout : float, s, optional
            Of real time, for the data to be complete. Default: none with a trigger, else twice the
            time plus 10 s.
        patience : float, s
            For a broken link to come back; the transfer resumes where it stopped.
        pauses : bool
            They also pause a program that was started with the recording. False: who asks sees to
            it.

        Returns
        -------
        Recording
            ``lost`` counts what the target could not keep; zero is the promise.

        Raises
        ------
        AcquisitionError
            No such channel, or more rows than the target can keep. On the real clock and without a
            trigger, rows are fetched while they are recorded: only the host's memory counts.
        Refused
            The program does not run, another host is recording, or one took the recorder over
            (`take`).
        RunnerDied
            The program crashed meanwhile; `acquire_load` brings home what was recorded until
            then.
        """
        _check_seconds(seconds)
        status: m.Status = self.request("status")
        if status.state != ProgramState.RUNNING and not start:
            need_channels(self.request, channels, status)
            raise Refused(
                f"nothing to record: the program is {status.state}; start it first, or with the"
                " recording (--start, start=True)"
            )
        ring_s, begun = self._configure_shot(
            channels, seconds, decimation, trigger, take, status.clock == Clock.REAL
        )
        if timeout is None and trigger is None:
            timeout = 2.0 * seconds + 10.0
        try:
            begun = self._start(begun)
            if start:
                # The row of the last wanted sample is written in that sample: so many ticks and not
                # one more.
                self.request("start", ticks=max(1, round(seconds * status.rate_hz)))
            if ring_s < seconds:
                wanted = max(1, round(seconds * status.rate_hz / decimation))
                return self._follow(begun, wanted, note, timeout, patience, progress)
            return self._finish(begun, timeout, note, progress, patience)
        except ZendspError:
            raise
        except BaseException as error:  # Ctrl-C, or of `progress`: nobody waits for it any more
            with uninterrupted(), contextlib.suppress(ZendspError):
                if start and pauses:
                    self.request("pause")
                self._end_ring(begun, 0.0)
                error.add_note("rows recorded until then are kept: acquire_load() brings them home")
            raise

    def _configure_shot(
        self,
        channels: Sequence[str],
        seconds: float,
        decimation: int,
        trigger: Trigger | None,
        take: bool,
        may_follow: bool,
    ) -> tuple[float, int]:
        """Configure a shot, or a ring as long as the target's memory allows; return the seconds
        that it holds, and its number.
        """
        try:
            status = self.acquire_configure(channels, seconds, decimation, trigger, take=take)
            return seconds, status.begun
        except TooLarge as error:
            # Only a loop that keeps to real time can be followed; and a trigger needs the whole
            # shot in one piece.
            if trigger is not None or not may_follow:
                raise
            held = seconds / 2.0
            while True:
                try:
                    status = self.acquire_configure(
                        channels, held, decimation, continuous=True, take=take
                    )
                    return held, status.begun
                except TooLarge:
                    held /= 2.0
                    if held < SHORTEST_RING_S:
                        raise error from None

    def _follow(
        self,
        begun: int,
        wanted: int,
        note: str,
        timeout: float | None,
        patience: float,
        progress: Callable[[float], None] | None,
    ) -> Recording:
        """Load rows while they are recorded, for shots that do not fit into the target's memory."""
        deadline = None if timeout is None else time.monotonic() + timeout
        status: m.AcquireStatus = self._ask("acquire_status", patience, begun)
        data = room(wanted, len(status.channels))
        have = gone = 0
        while have < wanted:
            status = self._ask("acquire_status", patience, begun)
            if status.first > have:  # overwritten before they were fetched: NaN, and counted
                first = min(status.first, wanted)
                data[have:first] = np.nan
                gone += first - have
                have = first
            count = min(status.count, wanted) - have
            if count > 0:
                try:
                    data[have : have + count] = self.load_rows(
                        have, count, len(status.channels), None, patience, begun
                    )
                    have += count
                except AcquisitionError:
                    # the oldest of them were overwritten on the way: look again where the ring
                    # begins
                    continue
                if progress is not None:
                    progress(have / wanted)
                continue
            if status.state != RecorderState.RUNNING or (
                deadline is not None and time.monotonic() > deadline
            ):
                raise AcquisitionError(
                    f"the recording ended after {have} of {wanted} rows ({status.state})"
                )
            time.sleep(POLL_S)
        self._ask("acquire_stop", 0.0, begun)
        status = msgspec.structs.replace(
            status, state=RecorderState.DONE, lost=max(status.lost, gone), wanted=wanted
        )
        return self._described(status, 0, data, note, patience)

    def acquire_configure(
        self,
        channels: Sequence[str],
        seconds: float = 1.0,
        decimation: int = 1,
        trigger: Trigger | None = None,
        continuous: bool = False,
        take: bool = False,
    ) -> m.AcquireStatus:
        """Set what the recorder records.

        Parameters
        ----------
        channels, decimation, trigger, take
            As for `acquire`.
        seconds : float, s
            Length of the shot, or of the ring.
        continuous : bool
            Keep the last ``seconds`` in a ring until stopped.

        Returns
        -------
        AcquireStatus

        Raises
        ------
        AcquisitionError
            No such channel, or more than the target's memory holds.
        Refused
            Another host is recording, has just set a recording up, or loads its rows.
        """
        _check_seconds(seconds)
        whole = isinstance(decimation, numbers.Integral) and not isinstance(decimation, bool)
        if not whole or decimation < 1:
            raise AcquisitionError(
                f"decimation = {decimation!r}: every how many samples to keep one, a whole number"
                " of 1 or more"
            )
        names = [channels] if isinstance(channels, str) else list(channels)
        twice = [name for k, name in enumerate(names) if name in names[:k]]
        if twice:  # found out by the recording's end it would cost the recording
            raise AcquisitionError(f"{twice[0]}: is named twice; name each channel once")
        result: m.AcquireStatus = self.request(
            "acquire_configure", channels=names, seconds=seconds, decimation=decimation,
            trigger=trigger, continuous=continuous, take=take,
        )
        self._begun = result.begun
        return result

    def acquire_start(self, force: bool = False) -> None:
        """Start or arm the recorder; ``force`` fires the trigger by hand.

        Raises
        ------
        Refused
            Another host took the recorder over since this one set it up, or is recording.
        """
        self._start(self._begun, force)

    def _start(self, begun: int | None, force: bool = False) -> int:
        """Start the recording of a number; return the number of its rows."""
        status: m.AcquireStatus = self._ask("acquire_start", None, begun, force=force)
        self._begun = status.begun
        return status.begun

    def acquire_stop(self) -> None:
        """Stop the recorder; what it holds stays loadable.

        Raises
        ------
        Refused
            Another host took the recorder over since this one set it up.
        """
        self._ask("acquire_stop", None, self._begun)

    def acquire_status(self) -> m.AcquireStatus:
        """State of the recorder."""
        result: m.AcquireStatus = self.request("acquire_status")
        return result

    def acquire_load(
        self,
        note: str = "",
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> Recording:
        """Load the rows that the recorder holds by now and return the recording, also after a crash
        of the program; `acquire_finish` waits for all of them.

        Parameters
        ----------
        note, progress, patience
            As for `acquire`.

        Returns
        -------
        Recording

        Raises
        ------
        AcquisitionError
            Nothing was recorded.
        Refused
            Another host took the recorder over since this one set it up; asked again, this brings
            home what that one recorded.
        """
        return self._load(self._begun, note, progress, patience)

    def _load(
        self,
        begun: int | None,
        note: str,
        progress: Callable[[float], None] | None,
        patience: float,
    ) -> Recording:
        status: m.AcquireStatus = self._ask("acquire_status", patience, begun)
        if status.count <= status.first:
            raise AcquisitionError(
                f"nothing was recorded (the recorder is {status.state}); start it and the program"
            )
        data = self.load_rows(
            status.first, status.count - status.first, len(status.channels), progress, patience,
            status.begun,
        )
        return self._described(status, status.first, data, note, patience)

    def _described(
        self, status: m.AcquireStatus, first: int, data: FloatArray, note: str, patience: float
    ) -> Recording:
        """The recording of loaded rows; the target is told that it is brought home."""
        from zendsp.link.metadata import describe  # with NumPy: not before there are rows

        recording = describe(self._parameters, status, first, data, note, patience)
        if status.state in ENDED:
            with contextlib.suppress(ZendspError):  # the rows are here
                self.request("acquire_status", begun=status.begun, loaded=True)
        return recording

    @shows_progress
    def acquire_finish(
        self,
        timeout: float | None = 60.0,
        note: str = "",
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> Recording:
        """Wait until the recorder has all of its rows, then load them; a continuous ring is
        stopped.

        Parameters
        ----------
        timeout : float, s, optional
            Of real time; None waits for ever.
        note, progress, patience
            As for `acquire`.

        Returns
        -------
        Recording

        Raises
        ------
        Incomplete
            Not within ``timeout``, or the program no longer runs.
        Refused
            Another host took the recorder over since this one set it up.
        RunnerDied
            The program crashed; `acquire_load` brings home what there is.
        """
        return self._finish(self._begun, timeout, note, progress, patience)

    def _finish(
        self,
        begun: int | None,
        timeout: float | None,
        note: str,
        progress: Callable[[float], None] | None,
        patience: float,
    ) -> Recording:
        status: m.AcquireStatus = self._ask("acquire_status", patience, begun)
        if status.wanted == 0 and status.state == RecorderState.RUNNING:
            self._end_ring(status.begun, patience)
        else:
            wait_done(
                partial(self._ask, "acquire_status", patience, status.begun),
                partial(self.insist, "status", patience),
                partial(self._end_ring, status.begun, patience), timeout, progress,
            )
        return self._load(status.begun, note, None, patience)

    def _end_ring(self, begun: int, patience: float) -> None:
        """Stop a ring and wait until the loop has stopped writing: what is loaded then no longer
        changes.
        """
        self._ask("acquire_stop", None, begun)
        deadline = time.monotonic() + END_S
        while (
            self._ask("acquire_status", patience, begun).state == RecorderState.RUNNING
            and time.monotonic() < deadline
        ):
            time.sleep(POLL_S)
