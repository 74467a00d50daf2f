"""Compile, download, start, pause, stop: the life of a program on the target."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec

from zendsp.errors import CompileFailed, LinkError, NotStopped, RunnerDied, Tripped, ZendspError
from zendsp.here.stop_page import StopPage, find
from zendsp.here.stopped import TAKEN_S, at_rest, stopped_at
from zendsp.link import left_moving
from zendsp.link.requests import Part
from zendsp.link.way_back import after
from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveState, ProgramState, TripReason

if TYPE_CHECKING:
    from zendsp_isr.sources import Source

POLL_FIRST_S, POLL_LAST_S = 0.001, 0.05
STOPPED_S = 1.0  # for the loop to say that it stopped
LEAST_SAMPLES = 10  # to speak of most of them
# of the target's time, to see a trip at once: speeds are looked at over 10 ms
FIRST_S = 0.02
FIRST = 3  # samples, where they are slow
WATCHED_S = 0.25  # of the target's time: a program that runs for so long has begun well


class Programs(Part):
    """The program of a target: compile, load, start, pause, stop."""

    _page: StopPage | None = None
    _page_of = b""  # run of the target

    def compile(self, source: Source, flags: Sequence[str] = ()) -> m.CompileResult:
        """Compile C code on the target. The running program is not touched.

        Parameters
        ----------
        source : path, or mapping of file name to text
            A path brings the headers beside it that it includes. The bare name of an example of
            this package will do too.
        flags : sequence of str
            Further flags for the compiler.

        Returns
        -------
        CompileResult
            With the warnings.

        Raises
        ------
        CompileFailed
            With file, line and column of each message; the attribute ``result`` holds them.
        """
        # with all that compiles: most commands have nothing to compile
        from zendsp_isr.sources import gather

        result: m.CompileResult = self.request("compile", sources=gather(source), flags=list(flags))
        if not result.ok:
            error = CompileFailed(
                "\n".join(map(str, result.diagnostics)) or "no reason given"
            )
            error.result = result
            raise error
        return result

    def load(self, key: str) -> None:
        """Load a compiled program by its key: a new runner starts and runs ``UserInit``."""
        self.request("load", key=key)

    def download(self, source: Source, flags: Sequence[str] = ()) -> m.CompileResult:
        """Compile and load; afterwards the state is ``loaded`` and `start` runs it.

        Parameters
        ----------
        source, flags
            As for `compile`.

        Returns
        -------
        CompileResult
            With the warnings.

        Raises
        ------
        CompileFailed
            With file, line and column of each message; what was loaded before stays.
        """
        result = self.compile(source, flags)
        self.load(result.key)
        return result

    def start(self, ticks: int | None = None, attended: bool = False) -> None:
        """Start or continue the program, and look at its first samples (20 ms).

        Parameters
        ----------
        ticks : int, optional
            Samples after which it pauses by itself.
        attended : bool
            Whoever starts it watches it: if this host is lost before somebody pauses, the host-lost
            policy acts, though nobody took the right to command. Otherwise it goes on.

        Raises
        ------
        Refused
            It cannot start; the message names each condition.
        Tripped
            A STOP, a limit or a fault ended it in its first samples.
        RunnerDied
            It crashed in them.
        """
        self.begin(ticks, attended)
        status = self.watch_start(FIRST_S)
        if status.state == ProgramState.CRASHED:
            raise RunnerDied(f"started, and {trouble(status)}")
        if status.trip is not None:
            drive: m.DriveStatus = self.request("drive_status")
            raise Tripped(f"started, and {trouble(status, drive)}")

    def begin(self, ticks: int | None = None, attended: bool = False) -> None:
        """As `start`, but without looking at the first samples: the caller does."""
        self.request("start", ticks=ticks, attended=attended)
        if self._requests.outlives:
            left_moving.started(self.link)

    def pause(self) -> None:
        """Pause the program: outputs are safe, variables keep their values.

        A simulated machine stands still in time. Hardware is in its safe state, with a commanded
        speed of zero; a joint that neither drive nor brake holds sinks.
        """
        self.request("pause")

    def stop(self) -> m.Status:
        """STOP: outputs are safe from the next sample on, and stay so until acknowledged on the
        target.

        Returns
        -------
        Status
            Once the loop itself says that it has stopped, with the sample in ``trip.tick``; at once
            where no program is loaded or it has crashed: then nothing moves, and the next load is
            refused until somebody acknowledges. Where the loop has
            stopped and the target's own process does not answer, only ``state``, ``tick`` and
            ``trip`` are known.

        Raises
        ------
        NotStopped
            Nothing says so within a second. Use the machine's emergency stop.
        """
        begin = time.monotonic()
        page = self.stop_page()
        asked = None if page is None else page.ask(self.link.author)
        known = self._taken(page, asked, TAKEN_S)
        if known is not None and not known.unsafe:
            return known
        try:
            self.request("stop")
            while True:
                # on the lane of STOP: others may flood that of `status`
                status: m.Status = self.request("stopped")
                if at_rest(status):
                    return status
                if time.monotonic() > begin + STOPPED_S:
                    raise LinkError(
                        status.unsafe
                        or f"asked, but the loop of {self.link.target!r} goes on or hangs: it is"
                        f" {status.state}"
                    )
                time.sleep(0.002)
        except ZendspError as error:
            # the loop may have taken it meanwhile, while the target's process has no time to answer
            known = self._taken(page, asked, 0.0)
            if known is not None and not known.unsafe:
                return known
            raise NotStopped(f"NOT STOPPED: use the machine's emergency stop ({error})") from error

    def _taken(self, page: StopPage | None, asked: int | None, timeout: float) -> m.Status | None:
        """The status once the loop says on its page that it has stopped; None where it does not."""
        if page is None or asked is None:
            return None
        sample = page.taken(asked, timeout)
        return None if sample is None else self._stopped_at(sample)

    def stop_page(self) -> StopPage | None:
        """The file by which `stop` acts first, for a target of this user on this computer; None
        elsewhere.
        """
        instance = self.link.instance
        if instance != self._page_of:
            self._page, self._page_of = find(self.link.target, instance), instance
        return self._page

    def _stopped_at(self, sample: int) -> m.Status:
        """The status, with the STOP that the loop has taken. It may be acknowledged already, or the
        target's process may hang.
        """
        known = stopped_at(sample)
        try:
            status: m.Status = self.request("stopped")
        except LinkError:
            return known
        return (
            status if status.trip is not None else msgspec.structs.replace(status, trip=known.trip)
        )

    def acknowledge(self, trip: m.Trip | None = None) -> str:
        """Acknowledge a STOP or a trip; nothing moves before the next `start`. Where nothing is
        latched, nothing changes.

        Parameters
        ----------
        trip : Trip, optional
            The one that is meant, as ``status().trip`` told it: where another STOP or trip came
            since, it is refused. Default: what is latched, whatever it is.

        Returns
        -------
        str
            What was done, or that there was nothing to acknowledge.
        """
        meant = {"trip": trip.number} if trip and trip.number else {}  # an older target has none
        said: m.Said = self.request("acknowledge", **meant)
        return said.text

    def unload(self) -> None:
        """Remove the program."""
        self.request("unload")

    def status(self) -> m.Status:
        """State, time, timing, drive and raw inputs and outputs, now."""
        result: m.Status = self.request("status")
        return result

    def program(self) -> m.Program:
        """Sources, flags and compiler of the loaded program."""
        result: m.Program = self.request("program")
        return result

    def run_for(self, seconds: float, timeout: float | None = None) -> m.Status:
        """Run for exactly ``seconds`` of the target's time, then pause; on the fast clock this is
        deterministic.

        Parameters
        ----------
        seconds : float, s
            Rounded to whole samples.
        timeout : float, s, optional
            Of real time. Default: twice the time plus 10 s.

        Returns
        -------
        Status
            After the last sample.

        Raises
        ------
        RunnerDied
            The program crashed or hung meanwhile.
        """
        ticks = max(1, round(seconds * self.status().rate_hz))
        self.begin(ticks)
        return self.wait(timeout if timeout is not None else 2.0 * seconds + 10.0)

    def watch_start(self, seconds: float = WATCHED_S, timeout: float = 5.0) -> m.Status:
        """Look at the first samples of a program that was started, in which most trips and crashes
        happen.

        Parameters
        ----------
        seconds : float, s
            Of the target's time.
        timeout : float, s
            Of real time.

        Returns
        -------
        Status
            As soon as the program has run for so long, or no longer runs.
        """
        deadline = time.monotonic() + timeout
        first = None
        while True:
            status = self.status()
            # of samples that ran: a loop that got no processor leaves some out
            ran = status.timing.ticks / status.rate_hz
            first = ran if first is None else first
            if (
                status.state != ProgramState.RUNNING
                or ran - first >= max(seconds, FIRST / status.rate_hz)
                or time.monotonic() > deadline
            ):
                return status
            time.sleep(min(0.01, seconds / 4.0))

    def wait(
        self, timeout: float = 60.0, on_status: Callable[[m.Status], None] | None = None
    ) -> m.Status:
        """Wait until the program no longer runs (paused by itself, stopped, tripped or crashed);
        return its status.

        Parameters
        ----------
        timeout : float, s
            Of real time.
        on_status : callable, optional
            Called with each `Status` met while waiting.

        Raises
        ------
        RunnerDied
            It crashed; the message says how.
        LinkError
            ``timeout`` s of real time have passed, or the target is gone.
        """
        deadline = time.monotonic() + timeout
        pause = POLL_FIRST_S
        while True:
            status = self.status()
            if status.state == ProgramState.CRASHED:
                raise RunnerDied(status.crash)
            if on_status is not None:
                on_status(status)
            if status.state != ProgramState.RUNNING:
                return status
            if time.monotonic() > deadline:
                raise LinkError(
                    f"the program still runs after {timeout:g} s (tick {status.tick}); pause or"
                    " stop it"
                )
            time.sleep(pause)
            pause = min(POLL_LAST_S, pause * 1.5)


def trouble(status: m.Status, drive: m.DriveStatus | None = None) -> str:
    """A line on a program that has crashed, or on a STOP or trip that is latched, and what to do
    next, which ``drive`` of the same moment tells more exactly; else ``""``.
    """
    if status.state == ProgramState.CRASHED:
        why = f"the program crashed: {status.crash}"
        again = "load it again with 'zendsp run FILE' or download()"
        if status.trip is None:
            return f"{why}; {again}"
        return (
            f"{why}; latched: {status.trip.text}; 'zendsp drive acknowledge' or acknowledge(), then"
            f" {again}"
        )
    if status.unsafe:
        return status.unsafe
    if status.trip is not None:
        what = "stopped" if status.drive == DriveState.STOPPED else "tripped"
        trip = status.trip
        # with the sample at which it happened; a STOP may come where no loop runs
        looped = trip.tick or trip.reason not in (TripReason.STOP, TripReason.HOST_LOST)
        when = f" (sample {trip.tick})" if looped else ""
        cause = f"{trip.cause or trip.reason}{when}"
        return (
            f"{what}: {cause}; outputs are safe; 'zendsp drive acknowledge' or acknowledge(), then"
            f" {after(status, drive)}"
        )
    return ""


def left(status: m.Status, drive: m.DriveStatus | None = None) -> str:
    """A line on the state in which the machine was left by a motion that ended early."""
    if said := trouble(status, drive):
        return said
    if status.state == ProgramState.RUNNING:
        return (
            f"running at sample {status.tick}; it goes on until 'zendsp pause' or 'zendsp stop'"
        )
    at = f"{status.state} at sample {status.tick}"
    on = status.drive in (DriveState.ENABLED, DriveState.RUNNING)
    return (
        f"{'no program is loaded' if status.state == ProgramState.EMPTY else at}, outputs are safe,"
        f" drives {'enabled' if on else 'off'}"
    )


def late(status: m.Status) -> str:
    """A line on a program that is late in most samples; else ``""``."""
    t = status.timing
    if t.ticks < LEAST_SAMPLES or 2 * t.overruns < t.ticks:
        return ""
    return (
        f"{t.overruns} of {t.ticks} samples took longer than the period of"
        f" {1e3 / status.rate_hz:g} ms: shorten UserISR_INT2, or give the target a lower --rate;"
        " 'zendsp stats' shows the times"
    )
