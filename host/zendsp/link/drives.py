"""The machine behind a target: what it is, its limits, its drives."""

from __future__ import annotations

from collections.abc import Sequence

from zendsp.link.requests import Requests
from zendsp_protocol import messages as m


class Drives(Requests):
    """Methods of a target that concern the machine."""

    def machine(self) -> m.MachineInfo:
        """Joints with their units and scales, analog and digital inputs, whether it must be homed.
        """
        result: m.MachineInfo = self.request("machine")
        return result

    def limits(self) -> m.Limits:
        """Limits that the runtime checks every sample, below the user's code."""
        result: m.Limits = self.request("limits")
        return result

    def set_limits(
        self,
        position_min: Sequence[float] | None = None,
        position_max: Sequence[float] | None = None,
        speed_max: Sequence[float] | None = None,
        torque_max: Sequence[float] | None = None,
        command_max: Sequence[float] | None = None,
        torque_clamp: bool | None = None,
    ) -> int:
        """Change limits, one entry per joint; what is None stays. Returns the sequence number of
        the change.

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
            "position_min": position_min,
            "position_max": position_max,
            "speed_max": speed_max,
            "torque_max": torque_max,
            "command_max": command_max,
        }
        given = {
            name: [float(x) for x in values] for name, values in lists.items() if values is not None
        }
        written: m.Written = self.request("set_limits", torque_clamp=torque_clamp, **given)  # type: ignore[arg-type]
        return written.sequence

    def set_drive(self, mode: str) -> None:
        """Tell the drives ``"off"``, ``"torque"``, ``"velocity"``, or ``"auto"``: on at start, off
        at pause.
        """
        self.request("set_drive", mode=mode)

    def home(self) -> None:
        """Begin the machine's homing; ``status().homed`` tells when it is done."""
        self.request("home")

    def set_ramp(self, seconds: float) -> None:
        """Set the time of soft start and soft stop, in s."""
        self.request("set_ramp", seconds=float(seconds))

    def set_overrun(self, policy: str, limit: int = 10) -> None:
        """Choose what an overrun does: ``"count"``, ``"skip"``, or ``"trip"`` after ``limit`` in a
        row.
        """
        self.request("set_overrun", policy=policy, limit=limit)

    def set_inputs(self, bits: int) -> None:
        """Set the digital inputs of a simulated machine, one bit each."""
        self.request("set_inputs", bits=bits)
