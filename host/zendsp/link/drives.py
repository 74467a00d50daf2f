"""The machine behind a target: what it is, its limits, the safe sequence of its drives, and the
exclusive right to command.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence

from zendsp.errors import Refused, ZendspError
from zendsp.here.uninterrupted import uninterrupted
from zendsp.link import left_moving
from zendsp.link.joints import Joints, joints_of
from zendsp.link.requests import Part
from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveAction, ProgramState

POLL_S = 0.02


class Drives(Part):
    """Methods of a target that concern the machine, its power, and who commands.

    Off → ready → homed → enabled → running → stopped or tripped. A script need not use this
    sequence: as long as nobody has, ``start`` switches the drives on and ``pause`` off.
    """

    def machine(self) -> m.MachineInfo:
        """Joints with their units and scales, analog and digital inputs, whether it must be homed.
        """
        result: m.MachineInfo = self.request("machine")
        return result

    def limits(self) -> m.Limits:
        """Limits that the runtime checks every sample, below the user's code."""
        result: m.Limits = self.request("limits")
        return result

    def joints(self) -> Joints:
        """Every joint with its position, its command and its limits, as one table.

        Raises
        ------
        Refused
            No program is loaded: joints and limits are known with one.

        Examples
        --------
        >>> import zendsp
        >>> with zendsp.local("imi_planar", clock="fast") as target:
        ...     _ = target.download("pd.c")
        ...     [joint.position_max for joint in target.joints()]
        [2.15, 2.15]
        """
        return joints_of(self.request("status"), self.machine().joints, self.limits())

    def set_limits(
        self,
        position_min: Sequence[float] | None = None,
        position_max: Sequence[float] | None = None,
        speed_max: Sequence[float] | None = None,
        torque_max: Sequence[float] | None = None,
        command_max: Sequence[float] | None = None,
        torque_clamp: bool | None = None,
    ) -> int:
        """Change limits, one entry per joint; what is None stays. Returns the sample from which
        they hold.

        Parameters
        ----------
        position_min, position_max : sequence of float, rad or m
        speed_max : sequence of float, rad/s or m/s
        torque_max : sequence of float, N m or N
        command_max : sequence of float, mV
        torque_clamp : bool
            True: clamp a command at its limit; False: trip.
        """
        lists = {
            "position_min": position_min, "position_max": position_max, "speed_max": speed_max,
            "torque_max": torque_max, "command_max": command_max,
        }
        given = {
            name: [float(x) for x in values] for name, values in lists.items() if values is not None
        }
        applied: m.Applied = self.request("set_limits", torque_clamp=torque_clamp, **given)  # type: ignore[arg-type]
        return applied.tick

    def set_drive(self, mode: str) -> None:
        """Set the mode of the drives: ``"off"``, ``"torque"``, ``"velocity"``, or ``"auto"``: on at
        start, off at pause.
        """
        self.request("set_drive", mode=mode)

    def home(self) -> None:
        """Begin the machine's homing; ``status().homed`` is true when it is done."""
        self.request("home")

    def set_ramp(self, seconds: float) -> None:
        """Set the time of soft start and soft stop, in s."""
        self.request("set_ramp", seconds=float(seconds))

    def set_overrun(self, policy: str, limit: int = 10) -> None:
        """Choose what late samples do: ``"count"``, ``"skip"``, or ``"trip"`` after ``limit`` of
        them in a row.
        """
        self.request("set_overrun", policy=policy, limit=limit)

    def set_inputs(self, bits: int) -> None:
        """Set the digital inputs of a simulated machine, one bit each."""
        self.request("set_inputs", bits=bits)

    def drive_status(self) -> m.DriveStatus:
        """State of the sequence, conditions of enabling, commander, host-lost policy."""
        result: m.DriveStatus = self.request("drive_status")
        return result

    def _drive(self, action: DriveAction, **values: object) -> str:
        said: m.Said = self.request("drive", action=action, **values)  # type: ignore[arg-type]
        if self._requests.outlives:
            left_moving.commanded(self.link)
        return said.text

    def power_on(self) -> str:
        """Switch the drives' power on, and use the explicit sequence from now on."""
        return self._drive(DriveAction.POWER_ON)

    def power_off(self) -> str:
        """Soft stop, then no torque."""
        return self._drive(DriveAction.POWER_OFF)

    def home_and_wait(self, timeout: float = 60.0) -> str:
        """Home the machine and wait until it is done; Ctrl-C ends the homing too.

        Parameters
        ----------
        timeout : float, s

        Raises
        ------
        Refused
            A condition of homing fails, homing itself failed or was ended, or it takes longer than
            ``timeout``, which ends it.
        """
        return self._home(lambda: self._drive(DriveAction.HOME), timeout)

    def home_if_needed(self, timeout: float = 60.0) -> bool:
        """Home a machine whose position is unknown, as `home_and_wait` does, but without beginning
        the explicit sequence. Returns whether it had to be homed.
        """
        needed = not self.request("status").homed
        if needed:
            self._home(self.home, timeout)
        return needed

    def _home(self, begin: Callable[[], object], timeout: float) -> str:
        before: m.Status = self.request("status")
        try:
            begin()
            return self._homed(before.homings, time.monotonic() + timeout, timeout)
        except (KeyboardInterrupt, SystemExit):  # who asked for the motion no longer watches it
            with uninterrupted(), contextlib.suppress(ZendspError):
                self.request("pause")
            raise

    def _homed(self, before: int, deadline: float, timeout: float) -> str:
        while True:
            status: m.Status = self.request("status")
            if status.trip is not None:
                raise Refused(f"homing ended: {status.trip.text or status.trip.reason}")
            if status.state != ProgramState.RUNNING:
                if status.homings > before:
                    return "homed"
                trip = self.request("status").trip  # it may have come in between
                why = trip.text if trip else "by a pause, or another load, before it was done"
                raise Refused(f"homing ended: {why}")
            if time.monotonic() > deadline:
                self.request("pause")  # nobody watches it any longer
                raise Refused(
                    f"homing was not done after {timeout:g} s and is ended: look at the machine, or"
                    " give it more time (timeout)"
                )
            time.sleep(POLL_S)

    def enable(self, mode: str = "torque") -> str:
        """Enable the drives in ``"torque"`` or ``"velocity"`` mode.

        Raises
        ------
        Refused
            Names each condition that fails.
        """
        return self._drive(DriveAction.ENABLE, mode=mode)

    def disable(self) -> str:
        """Soft stop, then no torque; the power stays on."""
        return self._drive(DriveAction.DISABLE)

    def drive_auto(self) -> str:
        """Leave the explicit sequence: drives on at start, off at pause."""
        return self._drive(DriveAction.AUTO)

    def take_command(self, force: bool = False) -> str:
        """Take the exclusive right to command; ``force`` takes it from another host.

        Raises
        ------
        Refused
            Somebody else has it, and ``force`` is False.
        """
        return self._drive(DriveAction.TAKE, force=force)

    def release_command(self) -> str:
        """Give the right to command back."""
        return self._drive(DriveAction.RELEASE)

    def set_host_lost(self, policy: str) -> str:
        """Choose what happens when the commanding host disappears: ``"stop"``, ``"hold"`` or
        ``"finish"``.
        """
        return self._drive(DriveAction.HOST_LOST, policy=policy)
