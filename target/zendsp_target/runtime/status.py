"""The status of a target."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zendsp_protocol.errors import Refused, RunnerDied
from zendsp_protocol.messages import Status, Trip
from zendsp_protocol.states import Clock, DriveMode, DriveState, ProgramState, TripReason
from zendsp_protocol.values import WireValue
from zendsp_target.runtime import safety
from zendsp_target.runtime.memory.layout import layout, text_of
from zendsp_target.runtime.process.settings import Settings
from zendsp_target.runtime.session import Session

_IO = ("enc", "aout", "adc", "din", "dout")
_OUTPUTS = ("aout", "dout")  # what a runner that is gone wrote last acts no more
_MODES = {number: name for name, number in safety.DRIVE_MODES.items()}


def empty_status(settings: Settings, unsafe: str, trip: Trip | None) -> Status:
    """The status while no program is loaded.

    Parameters
    ----------
    settings : Settings
        Of the next load.
    unsafe : str
        Why the machine may still move; empty: it is safe.
    trip : Trip or None
        What is not acknowledged.
    """
    return Status(
        state=ProgramState.EMPTY, tick=0, t=0.0, rate_hz=settings.rate_hz,
        clock=Clock(settings.clock),
        scheduling="", machine=settings.machine, joints=0, program="", timing=safety.no_timing(),
        drive=DriveState.OFF, trip=trip, crash="", unsafe=unsafe,
    )


def status_of(session: Session, latched: Callable[[], Trip | None]) -> Status:
    """The status of a loaded program, whether its runner lives or not.

    Parameters
    ----------
    latched : callable
        Tells what is not acknowledged, carried out or not.
    """
    control = session.control
    trip = safety.trip_of(control, session.machine)
    if not session.alive() and not session.unsafe:
        trip = latched()  # now: what tripped at its very end was latched until then
    state = _state(session, trip is not None)
    tick = session.tick
    told = _MODES.get(int(control.drive_mode)) if session.alive() else None
    mode = told or DriveMode.OFF
    homed = bool(control.homed)
    return Status(
        state=state,
        tick=tick,
        t=tick / session.settings.rate_hz,
        rate_hz=session.settings.rate_hz,
        clock=Clock(session.settings.clock),
        scheduling=text_of(control.scheduling),
        machine=session.machine.name,
        joints=len(session.machine.joints),
        program=session.key,
        timing=safety.timing_of(control),
        drive=_drive(state, trip.reason if trip else None, mode, homed),
        trip=trip,
        crash=session.crash,
        io=_io(session),
        homed=homed,
        drive_mode=mode,
        unsafe=session.unsafe,
        own=session.own_writes.told(),
        pressed=session.pressed,
        homings=int(control.homings),
        homing=state == ProgramState.RUNNING and session.running == layout()[1].RUN_HOME,
    )


def _state(session: Session, tripped: bool) -> ProgramState:
    _, lib = layout()
    if not session.alive():
        return ProgramState.CRASHED
    if tripped:
        return ProgramState.STOPPED
    if session.running != lib.RUN_PAUSED:
        return ProgramState.RUNNING
    return ProgramState.PAUSED if session.started else ProgramState.LOADED


def _drive(
    state: ProgramState, reason: TripReason | None, mode: DriveMode, homed: bool
) -> DriveState:
    if state == ProgramState.CRASHED:
        return DriveState.OFF
    if reason:
        return DriveState.latched(reason)
    if mode is DriveMode.OFF:
        return DriveState.HOMED if homed else DriveState.READY
    return DriveState.RUNNING if state == ProgramState.RUNNING else DriveState.ENABLED


def _io(session: Session) -> dict[str, WireValue]:
    told = _IO if session.alive() else [name for name in _IO if name not in _OUTPUTS]
    names = [name for name in told if name in session.dictionary.entries]
    try:
        _, values = session.read(names)
    except (RunnerDied, Refused):
        return {}
    faults, joints = int(session.control.faults), len(session.machine.joints)
    values["fault"] = np.array([faults >> j & 1 for j in range(joints)])
    return {
        name: np.atleast_1d(np.asarray(value, dtype=np.float64)) for name, value in values.items()
    }
