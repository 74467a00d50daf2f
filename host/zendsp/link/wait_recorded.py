"""Waits until a recording is complete, or will not be."""

from __future__ import annotations

import time
from collections.abc import Callable

from zendsp.errors import Incomplete, RunnerDied, ZendspError
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState, RecorderState, TripReason

ENDED = (RecorderState.DONE, RecorderState.IDLE)
POLL_S = 0.02
AFTER_TRIP_S = 1.0  # of the target's time: how the machine comes to rest is recorded
AFTER_TRIP_REAL_S = 3.0  # of real time: samples may have ended


def wait_done(
    look: Callable[[], m.AcquireStatus],
    status_of: Callable[[], m.Status],
    end_ring: Callable[[], None],
    timeout: float | None,
    progress: Callable[[float], None] | None,
) -> m.AcquireStatus:
    """The status of a recorder once it has all of its rows, or was ended by a host.

    Parameters
    ----------
    look, status_of : callable
        Ask for the status of the recorder and of the target, also past a broken link.
    end_ring : callable
        Stops the recorder.
    timeout, progress
        As for `Recorder.acquire_finish`.

    Raises
    ------
    Incomplete, Refused, RunnerDied
        As of `Recorder.acquire_finish`.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    stood = 0.0
    while True:
        status = look()
        if progress is not None and status.wanted:
            progress(min(1.0, (status.count - status.first) / status.wanted))
        if status.state in ENDED and status.count - status.first >= status.wanted:
            return status
        if status.replaced:
            raise _loadable(Incomplete(
                f"the program was replaced before the recording was complete "
                f"({status.count - status.first} of {status.wanted} rows)"
            ))  # fmt: skip
        overall = status_of()
        if overall.state == ProgramState.CRASHED:
            raise _loadable(RunnerDied(overall.crash))
        lost = overall.trip is not None and overall.trip.reason == TripReason.HOST_LOST
        if status.state in ENDED and not lost:
            return status  # ended before it was full, by a host
        if status.state in ENDED:
            raise _cut_short(overall, status)
        running = overall.state == ProgramState.RUNNING
        stood = 0.0 if running else stood or time.monotonic()
        if (
            not running
            and not _comes_to_rest(overall, stood)
            and look().state not in ENDED
        ):
            end_ring()
            status = look()
            if status.count - status.first >= status.wanted:
                return status
            raise _cut_short(overall, status)
        if deadline is not None and time.monotonic() > deadline:
            raise _loadable(
                Incomplete(
                    f"the recording is not complete after {timeout:g} s ({status.count} of"
                    f" {status.wanted} rows, {status.state})"
                )
            )
        time.sleep(POLL_S)


def _cut_short(overall: m.Status, status: m.AcquireStatus) -> ZendspError:
    """The error for a recording whose program ended before it was complete."""
    rows = f"{status.count - status.first} of {status.wanted} rows"
    why = overall.trip.text or overall.trip.reason if overall.trip is not None else ""
    return _loadable(Incomplete(
        f"the program was {overall.state} before the recording was complete ({rows})"
        f"{why and f': {why}'}"
    ))  # fmt: skip


def _comes_to_rest(status: m.Status, stood: float) -> bool:
    """Whether samples go on after a STOP or trip, so that the machine's coming to rest is being
    recorded.

    Parameters
    ----------
    status : Status
    stood : float, s
        When this host first saw that the program no longer runs, by its monotonic clock.
    """
    return (
        status.trip is not None
        and status.tick < status.trip.tick + AFTER_TRIP_S * status.rate_hz
        and time.monotonic() < stood + AFTER_TRIP_REAL_S
    )


def _loadable(error: ZendspError) -> ZendspError:
    """Add to an error how to load what was recorded."""
    error.add_note("acquire_load() brings home what was recorded")
    return error
