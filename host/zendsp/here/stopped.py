"""Words for how a STOP ended."""

from __future__ import annotations

from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveState, ProgramState, TripReason

TAKEN_S = 0.05  # for the loop to take a STOP from shared memory: 50 samples at 1 kHz


def at_rest(status: m.Status) -> bool:
    """Whether a STOP is complete: a STOP or trip has been carried out, or no program runs and the
    machine is safe.
    """
    ended = status.state in (ProgramState.EMPTY, ProgramState.CRASHED)
    return not status.unsafe and (status.trip is not None or ended)


def stopped(status: m.Status) -> str:
    """A sentence on how a STOP ended, from what `Programs.stop` returned."""
    if status.trip is None or status.state in (ProgramState.EMPTY, ProgramState.CRASHED):
        what = (
            "no program is loaded" if status.state == ProgramState.EMPTY else "the program crashed"
        )
        until = "" if status.trip is None else " until acknowledged"
        return f"stopped: {what}, nothing moves{until}"
    why = "" if status.trip.reason == TripReason.STOP else f" ({status.trip.text})"
    return f"stopped, at sample {status.trip.tick}{why}"


def ended(trip: m.Trip) -> str:
    """A phrase on what ended a run: who asked for it, or which limit."""
    own = DriveState.latched(trip.reason) == DriveState.TRIPPED
    return f"the machine stopped itself: {trip.text}" if own else trip.text


def state_at(status: m.Status) -> str:
    """The state of a program, and the sample of the STOP or trip that ended it, in words."""
    if status.trip is None or status.state != ProgramState.STOPPED:
        return f"{status.state} at sample {status.tick}"
    return f"{status.drive} at sample {status.trip.tick}"


def stopped_at(sample: int) -> m.Status:
    """The status after the loop has taken a STOP, where the target itself does not answer."""
    trip = m.Trip(
        reason=TripReason.STOP,
        joint=0,
        tick=sample,
        value=0.0,
        limit=0.0,
        text=f"STOP was requested (sample {sample})",
    )
    return m.Status(state=ProgramState.STOPPED, drive=DriveState.STOPPED, tick=sample, trip=trip)
