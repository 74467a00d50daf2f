"""What moves the machine: start, pause, STOP, drives, homing, limits. Each sets words in shared
memory that the loop obeys at its next sample.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from zendsp_isr.parts import is_model
from zendsp_protocol.errors import Refused, RunnerDied
from zendsp_protocol.messages import Limits, MachineInfo
from zendsp_protocol.states import DriveMode, OverrunPolicy, TripReason
from zendsp_target.api import PRESSED
from zendsp_target.runtime import safety
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.process.runner import ffi_address
from zendsp_target.runtime.programs import Programs
from zendsp_target.runtime.session import Session

MOST_TICKS = 1 << 53  # more than a thousand years, and still exact in a float
LONGEST_RAMP_S = 60.0  # of soft start and stop


class Motion:
    """Everything that makes the machine move or stand still.

    Parameters
    ----------
    programs : Programs
        Whose loaded program runs.
    """

    def __init__(self, programs: Programs) -> None:
        self._programs = programs

    def start(self, ticks: int | None = None) -> None:
        """Let the samples run.

        Parameters
        ----------
        ticks : int, optional
            Pause after exactly so many.

        Raises
        ------
        Refused
            No program, a STOP or trip that is not acknowledged, or running already.
        """
        _, lib = layout()
        with self._programs.lock:
            self._programs.require_no_trip()  # which no load would clear
            session = self._programs.living()
            if session.running != lib.RUN_PAUSED:
                raise Refused("the program runs already: pause it first")
            if ticks is not None and not 1 <= ticks <= MOST_TICKS:
                raise Refused(
                    f"ticks = {ticks}: give 1 to {MOST_TICKS}, or none to run until a pause"
                )
            if self._programs.drive_wish == DriveMode.AUTO:
                session.control.drive = lib.MACHINE_TORQUE
            before = session.tick
            lib.monitor_store64(
                ffi_address(session.control, "run_until"),
                before + ticks if ticks is not None else 0,
            )
            session.started = True
            self._run(session, lib.RUN_ISR, "start")

    def _run(self, session: Session, run: int, what: str) -> None:
        """Ask the loop to run samples, and wait until it does or has ended."""
        _, lib = layout()
        before, requested = session.tick, ffi_address(session.control, "run")
        session.request_run(run)
        session.until(
            lambda: session.running == run
            or session.tick > before
            or lib.monitor_load32(requested) == lib.RUN_PAUSED,
            what,
        )

    def pause(self) -> None:
        """Stop sampling after the present sample. A simulated machine then stands still in time;
        hardware is brought into its safe state.
        """
        _, lib = layout()
        with self._programs.lock:
            session = self._programs.living()
            session.request_run(lib.RUN_PAUSED)
            session.until(lambda: session.running == lib.RUN_PAUSED, "pause")

    def wait_paused(self, timeout: float = 60.0) -> None:
        """Sleep until the loop pauses (the end of ``start(ticks=n)``).

        Raises
        ------
        Refused
            It still runs after `timeout` s.
        RunnerDied
            The runner ended before.
        """
        _, lib = layout()
        session = self._programs.living()
        requested = ffi_address(session.control, "run")
        session.until(
            lambda: lib.monitor_load32(requested) == lib.RUN_PAUSED
            and session.running == lib.RUN_PAUSED,
            "the end of the run",
            timeout,
        )

    def stop(self, author: str = "") -> None:
        """STOP: from the next sample on the drives stand still in velocity mode. It is latched
        until acknowledged; the call never waits.

        Parameters
        ----------
        author : str
            Who asks.
        """
        self._programs.ask_stop(author)

    def trip(self, reason: TripReason) -> None:
        """As `stop`, with another reason.

        Parameters
        ----------
        reason : str
            ``"stop"`` or ``"host lost"``.
        """
        _, lib = layout()
        if reason not in safety.REQUESTS:
            raise Refused(f"trip reason {reason!r}: give one of {', '.join(safety.REQUESTS)}")
        session = self._programs.session  # no lock: STOP never waits behind a load
        if reason == TripReason.STOP or session is None:
            self._programs.ask_stop()
        else:
            lib.monitor_store32(ffi_address(session.control, "stop"), safety.REQUESTS[reason])

    def cancel(self, whose: Callable[[str], bool]) -> None:
        """Cancel the updates of these authors that wait for a later sample."""
        session = self._programs.session
        if session is not None:
            session.flights.cancel(whose)

    def attend(self, attended: bool) -> None:
        """Say whether the loop shall stop the machine if this process hangs, in which case nobody
        would notice that the host is lost.
        """
        _, lib = layout()
        session = self._programs.session
        if session is not None:
            lib.monitor_store32(ffi_address(session.control, "attended"), int(attended))

    def acknowledge(self, trip: int | None = None) -> None:
        """End a STOP or a trip. The program is paused; nothing moves before the next start.

        Where another cause is still present, the next sample trips again. A joint beyond its
        position limit may be moved back inside, but no further out.

        Parameters
        ----------
        trip : int, optional
            `Trip.number` of the one that is meant: where another came since, nothing ends.

        Raises
        ------
        Refused
            The machine's STOP input is active.
        """
        _, lib = layout()
        with self._programs.lock:
            ended = self._programs.runner_pid() == 0
            if ended and self._programs.latched() is not None:
                self._programs.forget_trip(trip)
                return
            session = self._programs.living()
            session.request_run(lib.RUN_PAUSED)
            session.until(lambda: session.running == lib.RUN_PAUSED, "acknowledge")
            session.settle("acknowledge")  # inputs are read while paused, too
            if session.pressed:
                raise Refused(f"acknowledging is refused: {PRESSED}")
            session.flights.cancel(lambda author: True)  # as what was computed before the trip
            control = session.control
            control.acknowledge_trip = self._programs.trips() if trip is None else trip
            wanted = (int(control.acknowledge) + 1) & 0xFFFFFFFF
            lib.monitor_store32(ffi_address(control, "acknowledge"), wanted)
            answered = ffi_address(control, "acknowledged")
            session.until(lambda: lib.monitor_load32(answered) == wanted, "acknowledge")

    def set_drive(self, mode: DriveMode) -> None:
        """Set what the drives do, and return once the loop acts by it. ``auto``, the default:
        torque mode at each start.
        """
        with self._programs.lock:
            if mode in (DriveMode.TORQUE, DriveMode.VELOCITY):
                self._programs.living()  # switching on needs somebody who obeys
            self._programs.drive_wish = mode
            session = self._programs.session
            if session is not None:
                control = session.control
                if mode == DriveMode.OFF:
                    control.off = (int(control.off) + 1) & 0xFFFFFFFF
                control.drive = safety.DRIVE_MODES.get(mode, int(control.drive))
                with contextlib.suppress(RunnerDied):  # then nothing is driven
                    session.settle("set_drive")

    def home(self) -> None:
        """Start the machine's homing, and return once it moves. ``status().homed`` is true when it
        is done; a failure trips.

        Raises
        ------
        Refused
            A trip stands, or the program runs.
        """
        _, lib = layout()
        with self._programs.lock:
            session = self._programs.living()
            self._programs.require_no_trip()
            if session.running != lib.RUN_PAUSED:
                raise Refused("the program runs: pause it before homing")
            lib.monitor_store64(ffi_address(session.control, "run_until"), 0)
            self._run(session, lib.RUN_HOME, "home")

    def machine(self) -> MachineInfo:
        """What the loaded machine says of itself, and the model that it simulates."""
        said, machine = self._programs.loaded().machine, self._programs.settings.machine
        if not is_model(machine):
            return said
        options = tuple(f"{key}={value}" for key, value in self._programs.options.items())
        return msgspec.structs.replace(said, model=os.path.abspath(machine), options=options)

    def limits(self) -> Limits:
        """Limits in force."""
        _, values = self._programs.loaded().read(safety.limit_names())
        return safety.limits_of(values)

    def set_limits(self, author: str, **changes: Any) -> int:
        """Tighten or restore limits, as one synchronous update.

        Parameters
        ----------
        **changes
            Fields of Limits; one number per joint, or one for all.

        Returns
        -------
        int
            Sequence number for `wait_applied`.

        Raises
        ------
        Refused
            Beyond what the machine bears, or not a limit.
        """
        session = self._programs.living()
        return session.set_settings(safety.check_limits(session.machine, changes), author)

    def set_ramp(self, seconds: float) -> None:
        """Duration of soft start and soft stop, s; 0: at once."""
        if not 0.0 <= seconds <= LONGEST_RAMP_S:
            raise Refused(f"ramp of {seconds!r} s: give 0 … {LONGEST_RAMP_S:g} s")
        self._apply({"drive.ramp": seconds})

    def set_overrun(self, policy: OverrunPolicy, limit: int = 10) -> None:
        """Set what happens when samples take longer than the period. Policy ``trip``: trip after
        `limit` of them in a row.
        """
        if limit < 1:
            raise Refused(f"overrun limit {limit}: give 1 or more")
        number = safety.OVERRUN_POLICIES[policy]
        self._apply({"overrun.policy": number, "overrun.limit": limit})

    def _apply(self, values: Mapping[str, object]) -> None:
        session = self._programs.living()
        session.flights.wait_applied(session.set_settings(values, "runtime"), 5.0)

    def set_inputs(self, bits: int) -> None:
        """Set the digital inputs of a simulated machine, one bit each, as a person at its panel
        would. Returns once the loop has read them.
        """
        session = self._programs.living()
        if not session.machine.simulated:
            raise Refused("digital inputs of real hardware cannot be set")
        session.control.simulated_din = bits & 0xFFFFFFFF
        session.settle("set_inputs")
