"""The safe sequence of the drives, and the exclusive right to command."""

from __future__ import annotations

import time

from zendsp.errors import Refused
from zendsp.link.requests import Requests
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState

POLL_S = 0.02


class Sequence(Requests):
    """Methods of a target that concern power, homing, enabling, and who commands.

    Off → ready → homed → enabled → running → stopped or tripped. A script need not use it: as long
    as nobody has, ``start`` switches the drives on and ``pause`` off.
    """

    def drive_status(self) -> m.DriveStatus:
        """State of the sequence, conditions of enabling, commander, host-lost policy."""
        result: m.DriveStatus = self.request("drive_status")
        return result

    def _drive(self, action: str, **values: object) -> str:
        said: m.Said = self.request("drive", action=action, **values)  # type: ignore[arg-type]
        return said.text

    def power_on(self) -> str:
        """Switch the drives' power on, and use the explicit sequence from now on."""
        return self._drive("power_on")

    def power_off(self) -> str:
        """Soft stop, then no torque."""
        return self._drive("power_off")

    def home_and_wait(self, timeout: float = 60.0) -> str:
        """Home the machine and wait until it is done.

        Parameters
        ----------
        timeout : float, s

        Raises
        ------
        Refused
            A condition of homing fails, homing itself failed, or it takes longer than ``timeout``.
        """
        self._drive("home")
        deadline = time.monotonic() + timeout
        while True:
            status: m.Status = self.request("status")
            if status.trip is not None:
                raise Refused(f"homing ended: {status.trip.text or status.trip.reason}")
            if status.homed and status.state != ProgramState.RUNNING:
                return "homed"
            if time.monotonic() > deadline:
                raise Refused(
                    f"homing is not done after {timeout:g} s; STOP, and look at the machine"
                )
            time.sleep(POLL_S)

    def enable(self, mode: str = "torque") -> str:
        """Enable the drives in ``"torque"`` or ``"velocity"`` mode.

        Raises
        ------
        Refused
            Names each condition that fails.
        """
        return self._drive("enable", mode=mode)

    def disable(self) -> str:
        """Soft stop, then no torque; the power stays on."""
        return self._drive("disable")

    def drive_auto(self) -> str:
        """Leave the explicit sequence: drives on at start, off at pause."""
        return self._drive("auto")

    def take_command(self, force: bool = False) -> str:
        """Take the exclusive right to command; ``force`` takes it from another host.

        Raises
        ------
        Refused
            Somebody else has it, and ``force`` is False.
        """
        return self._drive("take", force=force)

    def release_command(self) -> str:
        """Give the right back."""
        return self._drive("release")

    def set_host_lost(self, policy: str) -> str:
        """Choose what happens when the commanding host disappears: ``"stop"``, ``"hold"`` or
        ``"finish"``.
        """
        return self._drive("host_lost", policy=policy)
