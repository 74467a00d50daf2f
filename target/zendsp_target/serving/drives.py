"""The safe sequence of the drives, and who may command them.

    off → ready → homed → enabled → running → stopped | tripped

It stands above the runtime's drive mode, limits and latched trips, and below every host. So the
same rules hold for the API, the command line and the terminal. Two ways to use it:

* **automatic** (the default): nobody has touched the sequence. ``start`` switches the drives on,
  ``pause`` off, as a script wants it; limits, trips and STOP act all the same.
* **explicit**: from the first power, home or enable on, or always with ``--managed``. Then nothing
  moves unless the drives have been enabled, and enabling needs every condition; a refusal names
  those that fail.

The exclusive right to command is free until somebody takes it (or powers, homes, enables). While it
is held, requests of others that could move or change something are refused; reading, recording and
STOP never are. If its holder disappears, the host-lost policy decides.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from zendsp_protocol import messages as m
from zendsp_protocol import verbs
from zendsp_protocol.errors import Refused, ZendspError
from zendsp_protocol.messages import Status
from zendsp_protocol.states import (
    DriveAction,
    DriveMode,
    DriveState,
    HostLost,
    ProgramState,
    RecorderState,
    TripReason,
    VariableKind,
)
from zendsp_target.api import RECORDER, RuntimeApi
from zendsp_target.serving.enabling import conditions, loaded, refusal

log = logging.getLogger(__name__)

# soft start and soft stop of the explicit sequence, unless somebody has chosen otherwise
SOFT_S = 0.1
OFF_S = 0.5  # for a soft stop to end
AFTER_TRIP_S = 1.0  # a recording shows how the machine comes to rest
# actions by which the right to command is taken
TAKING = (DriveAction.TAKE, DriveAction.POWER_ON, DriveAction.HOME, DriveAction.ENABLE)
POLICY = HostLost.STOP  # unless somebody chooses another
HOLD_VARIABLE = "hold"  # a bool parameter of programs that can hold their reference


class Drives:
    """The state machine of one target.

    Parameters
    ----------
    managed : bool
        True: always explicit; ``auto`` is refused.
    """

    def __init__(self, runtime: RuntimeApi, managed: bool = False) -> None:
        self._runtime = runtime
        self._managed = managed
        self._policy = POLICY
        self._policy_by = ""  # who chose another one
        self._explicit = managed
        self._powered = False
        self._enabled = False
        self.commander = ""  # who holds the right to command
        self.moved_by = ""  # whose run moves the machine now
        self._attended_by = ""  # who started the program and watches it, or homes
        self._ramp_s = SOFT_S
        self._lock = threading.RLock()
        if managed:
            self._off()

    # -- what is

    def state(self, status: Status) -> DriveState:
        """The state of the sequence for this status. It takes no lock: whoever waits for the loop
        holds the lock, and STOP needs this.
        """
        if status.trip is not None:
            self._enabled = False
            return DriveState.latched(status.trip.reason)
        if status.state == ProgramState.CRASHED:  # the machine was made safe
            self._enabled = False
        running = status.state == ProgramState.RUNNING
        resting = DriveState.HOMED if status.homed and loaded(status) else DriveState.READY
        if not self._explicit:
            return DriveState.RUNNING if running else resting
        if not self._powered:
            return DriveState.OFF
        if self._enabled:
            return DriveState.RUNNING if running else DriveState.ENABLED
        return resting

    def conditions(self, status: Status) -> tuple[m.Condition, ...]:
        """The conditions of enabling."""
        return conditions(status, self._powered or not self._explicit, self._runtime)

    def status(self) -> m.DriveStatus:
        """State, conditions, commander and policy."""
        status = self._runtime.status()
        state = self.state(status)
        with self._lock:
            return m.DriveStatus(
                state=state,
                mode=status.drive_mode,
                managed=self._managed,
                explicit=self._explicit,
                homed=status.homed,
                commander=self.commander,
                moved_by=self._mover(status),
                host_lost=self._policy,
                conditions=self.conditions(status),
            )

    def _mover(self, status: Status) -> str:
        running = status.state == ProgramState.RUNNING and status.trip is None
        return self.moved_by or (self._attended_by if running else "")

    # -- who may

    def check_right(self, by: str) -> None:
        """Refuse unless ``by`` may command."""
        commander = self.commander
        if commander and commander != by:
            raise Refused(
                f"{commander} has the exclusive right to command this target; take it over"
                " deliberately (Ctrl+R in the terminal, else 'zendsp drive take --force'), or use"
                " STOP, which always works"
            )

    def take(self, by: str, force: bool) -> str:
        """Give the right to command to ``by``."""
        with self._lock:
            before = self.commander
            if not force:
                self.check_right(by)
            word = f"taken over from {before}" if before and before != by else "you command"
            return word + self._pass_to(by)

    def release(self, by: str) -> str:
        """Give the right back."""
        with self._lock:
            self.check_right(by)
            self._pass_to("")
            return "the right to command is free"

    def _pass_to(self, host: str) -> str:
        """Give the right to command to a host, "" for nobody. A policy ends with the commander who
        chose it. Returns a sentence for the new commander where somebody else's policy stays.
        """
        before, self.commander = self.commander, host
        if host not in ("", before):  # what others have set for later is theirs
            self._runtime.cancel(lambda author: author != host)
        if before not in ("", host) and self._policy_by == before:
            self._policy, self._policy_by = POLICY, ""
        if host in ("", before) or self._policy_by in ("", host):
            return ""
        return f"; if this host is lost: {self._policy}, as {self._policy_by} chose"

    def host_gone(self, host: str, moves: bool = False) -> HostLost | None:
        """Apply the host-lost policy to a host that disappeared; return the policy that acted, None
        where none did.

        It acts if the host commanded; and, where nobody commands, if a run of the host `moves` the
        machine or the host watched a start.
        """
        with self._lock:
            if host == self._attended_by:
                self._attended_by, moves = "", True
            if host != self.commander and (self.commander or not moves):
                return None
            policy = self._policy
            self._pass_to("")
            if policy != HostLost.FINISH:
                self._runtime.cancel(lambda author: author == host)
            try:
                status = self._runtime.status()
                if status.trip is not None:  # the loop has stopped the machine by itself
                    self._end_recording()
                if status.state != ProgramState.RUNNING or policy == HostLost.FINISH:
                    return policy
                if policy == HostLost.HOLD and self._hold():
                    return policy
                self._runtime.trip(TripReason.HOST_LOST)
                self._enabled = False
                self._end_recording()
            except ZendspError as error:
                # the runner died meanwhile: it is in the safe state already
                log.warning("host %s lost: %s", host, error)
            return HostLost.STOP

    def watch(self) -> None:
        """Tell the loop whether it must stop the machine if this process hangs: while a host
        commands or moves it, nobody else would notice that this host is lost.
        """
        commands = self.commander or self.moved_by or self._attended_by
        self._runtime.attend(bool(commands) and self._policy != HostLost.FINISH)

    def _end_recording(self) -> None:
        """End the present recording once the machine has come to rest, as after STOP: the host that
        would have ended it is gone.
        """
        recorder = self._runtime.acquire_status(RECORDER)
        if recorder.state not in (RecorderState.ARMED, RecorderState.RUNNING):
            return
        began = recorder.begun

        def end() -> None:
            try:
                if self._runtime.acquire_status(RECORDER).begun == began:
                    self._runtime.acquire_stop(RECORDER)
            except ZendspError as error:
                log.warning("the recorder was not ended: %s", error)

        timer = threading.Timer(AFTER_TRIP_S, end)
        timer.daemon = True
        timer.start()

    def _hold(self) -> bool:
        infos = {info.name: info for info in self._runtime.variables()}
        info = infos.get(HOLD_VARIABLE)
        if info is None or info.type != "bool" or info.kind != VariableKind.PARAMETER:
            return False
        try:
            self._runtime.write({HOLD_VARIABLE: True}, "host lost")
        except ZendspError as error:  # so many updates wait that there is no room for this one
            log.warning("hold cannot be set, the machine stops: %s", error)
            return False
        return True

    # -- the sequence

    def act(self, args: verbs.Drive, by: str) -> str:
        """Do what a ``drive`` request asks; returns a sentence."""
        actions: dict[DriveAction, Callable[[], str]] = {
            DriveAction.TAKE: lambda: self.take(by, args.force),
            DriveAction.RELEASE: lambda: self.release(by),
            DriveAction.POWER_ON: self.power_on,
            DriveAction.POWER_OFF: self.power_off,
            DriveAction.HOME: self.home,
            DriveAction.ENABLE: lambda: self.enable(args.mode),
            DriveAction.DISABLE: self.disable,
            DriveAction.ACKNOWLEDGE: self.acknowledge,
            DriveAction.AUTO: self.auto,
            DriveAction.HOST_LOST: lambda: self.set_policy(args.policy, by),
        }
        with self._lock:
            if args.action not in (DriveAction.TAKE, DriveAction.RELEASE):
                self.check_right(by)
            said = actions[args.action]()
            if args.action in TAKING and args.action != DriveAction.TAKE:
                said += self._pass_to(by)
            return said

    def power_on(self) -> str:
        """off → ready (and on to homed where positions are absolute). Refused where a program moves
        the machine already, which would lose its torque.
        """
        if not self._explicit:
            if self._runtime.status().state == ProgramState.RUNNING:
                raise Refused(
                    "power on is refused: the program runs with the drives on, and the machine"
                    " would lose its torque; pause it first"
                )
            self._explicit = True
            self._off()
        self._powered = True
        return f"power on: {self.state(self._runtime.status())}"

    def power_off(self) -> str:
        """Anything → off: soft stop, then no torque."""
        self._explicit = True
        said = self._off_and_look()
        self._powered = False
        return f"power off{said}"

    def home(self) -> str:
        """ready → homed."""
        status = self._runtime.status()
        failing = [
            c
            for c in self.conditions(status)
            if not c.met and c.name in ("power", "program", "stop input", "no trip")
        ]
        if failing:
            raise Refused(refusal("homing", failing))
        if status.state == ProgramState.RUNNING:
            raise Refused("homing is refused: the program runs; pause it first")
        self._explicit = self._powered = True
        self._off()  # what acts while homing is the machine's own routine
        self._runtime.home()
        return "homing"

    def enable(self, mode: DriveMode) -> str:
        """homed → enabled, in torque or velocity mode. In the automatic mode this also switches the
        power on. A refusal changes nothing.
        """
        if mode not in (DriveMode.TORQUE, DriveMode.VELOCITY):
            raise Refused(f"drive mode {mode}: expected torque or velocity")
        failing = [c for c in self.conditions(self._runtime.status()) if not c.met]
        if failing:
            raise Refused(refusal("enabling", failing))
        self._refuse_to_move("enabling")
        if not self._explicit:
            self._explicit = self._powered = True
            self._off()
        self._runtime.set_ramp(self._ramp_s)
        self._runtime.set_drive(mode)
        trip = self._runtime.status().trip
        if trip is not None:
            raise Refused(f"not enabled: {trip.text or trip.reason}")
        self._enabled = True
        return f"enabled, {mode} mode"

    def _refuse_to_move(self, what: str) -> None:
        """Refuse where a program went on running while the drives were off: it would move the
        machine at once.
        """
        running = self._runtime.status().state == ProgramState.RUNNING
        if self._explicit and not self._enabled and running:
            raise Refused(f"{what} is refused: the program runs and would move at once; pause it")

    def disable(self) -> str:
        """enabled → homed: soft stop, then no torque."""
        self._explicit = True
        return f"disabled{self._off_and_look()}"

    def acknowledge(self, trip: int | None = None) -> str:
        """stopped | tripped → homed; nothing moves before somebody enables again, or in the
        automatic mode starts. Where nothing is latched, or another trip than the one meant, nothing
        changes.
        """
        status = self._runtime.status()
        if status.trip is None and status.state != ProgramState.CRASHED:
            return "nothing is latched, so there is nothing to acknowledge"
        seen = status.trip.number if status.trip else None
        if trip is not None and status.trip and trip != seen:
            raise Refused(
                "not acknowledged: another STOP or trip came after the one that is meant."
                f" {status.trip.text or status.trip.reason}"
            )
        if self._explicit:
            self._off()
        self._enabled = False
        self._runtime.acknowledge(seen)
        again = self._runtime.status().trip
        if again is not None:
            raise Refused(f"acknowledged, and latched again since: {again.text or again.reason}")
        first = "enable the drives" if self._explicit else "start the program"
        if not loaded(self._runtime.status()):
            first = "load a program"
        was = f" (it was: {status.trip.cause}, sample {status.trip.tick})" if status.trip else ""
        return f"acknowledged; {first} before anything moves{was}"

    def auto(self) -> str:
        """Leave the explicit sequence: drives are on from start to pause."""
        if self._managed:
            raise Refused(
                "this target was started with --managed: the sequence must be followed (power,"
                " home, enable)"
            )
        self._refuse_to_move("automatic drives")
        self._explicit = self._enabled = self._powered = False
        self._runtime.set_drive(DriveMode.AUTO)
        return "automatic: on at start, off at pause"

    def set_policy(self, policy: HostLost, by: str) -> str:
        """Choose what happens when the commanding host is lost. The choice ends with the command of
        the host that made it; that of a host without the command stays.
        """
        self._policy, self._policy_by = policy, by
        return f"if the commanding host is lost: {policy}"

    def _off(self) -> None:
        self._enabled = False
        self._runtime.set_drive(DriveMode.OFF)

    def _off_and_look(self) -> str:
        """Switch the drives off and wait for a short soft stop; return a sentence where they are
        not off after it, or where a program runs on without them.
        """
        self._off()
        deadline = time.monotonic() + OFF_S
        while (status := self._runtime.status()).drive_mode != DriveMode.OFF:
            if status.state in (ProgramState.EMPTY, ProgramState.CRASHED):
                break
            if status.trip is not None:
                return "; until the trip is acknowledged, the drives hold at zero speed"
            if time.monotonic() > deadline:
                return f"; the soft stop of {self._ramp_s:g} s goes on"
            time.sleep(0.005)
        if status.unsafe:
            return f"; {status.unsafe}"
        if status.state == ProgramState.RUNNING:
            return "; the program runs on and moves nothing: pause it before you enable again"
        return ""

    # -- before and after the other verbs

    def before(self, name: str, args: Any) -> str | None:
        """Refuse a verb that the sequence does not allow now. Returns a sentence where the verb was
        carried out here instead of by its handler.
        """
        if name == "start":
            self._check_start()
        elif name == "set_drive" and self._explicit:
            raise Refused(
                "the safe sequence is in use: enable or disable the drives in place of setting"
                " their mode"
            )
        elif name == "home" and self._explicit:
            return self.home()
        elif name == "acknowledge":
            with self._lock:
                return self.acknowledge(args.trip)
        return None

    def after(self, name: str, args: Any, by: str) -> None:
        """Change the state of the sequence after a verb was carried out."""
        if name in ("start", "home", "pause"):
            attended = name == "home" or (name == "start" and args.attended)
            self._attended_by = by if attended else ""
        elif name == "set_ramp":
            self._ramp_s = args.seconds
        elif name == "load" and self._explicit:
            with self._lock:
                self._off()  # a fresh runner knows nothing of what was enabled before

    def _check_start(self) -> None:
        with self._lock:
            if self._enabled:
                return
            status = self._runtime.status()
            known = status.homed or not loaded(status)
            # automatic drives: only where the position is unknown, since its limits would not hold
            if not self._explicit and known and not status.pressed:
                return
            failing = [c for c in self.conditions(status) if not c.met]
            failing = failing or [
                m.Condition(
                    name="enabled",
                    met=False,
                    advice="the drives are not enabled: enable them (zendsp drive enable), then"
                    " start (zendsp run without a file); loading a program disables them",
                )
            ]
            raise Refused(refusal("starting", failing))
