"""Where every joint stands between its limits: one table of the states and limits of a machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from zendsp.link.listings import Listing
from zendsp.link.outside import positions
from zendsp.link.variables import plain
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState


@dataclass(frozen=True)
class Joint:
    """One joint now, beside the limits that are checked every sample."""

    name: str
    unit: str  # of position: rad or m
    position: float  # by its encoder; NaN where the machine is not homed
    position_min: float
    position_max: float
    speed_max: float  # unit/s
    command: float  # that acts now, in command_unit; NaN where none does
    command_max: float
    command_unit: str  # N m or N; mV where the drive takes a voltage, or holds a speed
    held: float = 0.0  # while paused: that a simulated machine, whose time stands, goes on with

    def row(self) -> tuple[str, ...]:
        """Name, position with its limits and the share of its range, command with its limit, and
        the limit of speed.
        """
        inside = f"{self.position_min:g} … {self.position_max:g}"
        stands = f"{self.position:z.4f} {self.unit}" if math.isfinite(self.position) else "unknown"
        going_out = "none"  # after a crash, and while paused, no program's command acts
        if self.held:
            going_out = f"none; {self.held:z.4g} {self.command_unit} held"
        if math.isfinite(self.command):
            going_out = f"{self.command:z.4g} {self.command_unit}"
        return (
            self.name, stands, inside,
            percent(share_of_range(self.position, self.position_min, self.position_max)),
            going_out, f"{self.command_max:g}",
            percent(abs(self.command) / self.command_max if self.command_max > 0.0 else math.nan),
            f"{self.speed_max:g} {self.unit}/s",
        )  # fmt: skip


class Joints(Listing, tuple[Joint, ...]):
    """The joints of a machine, as a table."""

    header = ("JOINT", "POSITION", "LIMITS", "USED", "COMMAND", "LIMIT", "USED", "SPEED LIMIT")

    def rows(self) -> list[tuple[str, ...]]:
        """A row for each joint; used: how far from the middle of its range, or of its limit."""
        return [joint.row() for joint in self]


def joints_of(status: m.Status, joints: Sequence[m.JointInfo], limits: m.Limits) -> Joints:
    """The joints by a status, what the machine says of them, and the limits in force."""
    out = plain(status.io.get("aout", ()))
    out = out if isinstance(out, list | tuple) else [out]
    torque = status.drive_mode == "torque"
    acts = status.state != ProgramState.PAUSED
    known = positions(status, joints)
    found = []
    for j, joint in enumerate(joints):
        scale = joint.mv_per_torque if torque else 0.0
        command = float(out[j]) / (scale or 1.0) if j < len(out) else math.nan
        found.append(
            Joint(
                name=joint.name,
                unit=joint.unit,
                position=known[j] if status.homed and j < len(known) else math.nan,
                position_min=limits.position_min[j],
                position_max=limits.position_max[j],
                speed_max=limits.speed_max[j],
                command=command if acts else math.nan,
                command_max=limits.torque_max[j] if scale else limits.command_max[j],
                command_unit=("N" if joint.unit == "m" else "N m") if scale else "mV",
                held=0.0 if acts or math.isnan(command) else command,
            )
        )
    return Joints(cast("tuple[Joint, ...]", found))


def share_of_range(position: float, least: float, most: float) -> float:
    """How far from the middle of its range a joint stands: 0 in the middle, 1 at either limit; NaN
    where one of them is unknown or endless.

    Examples
    --------
    >>> share_of_range(2.0, -1.0, 3.0)
    0.5
    """
    half = (most - least) / 2.0
    known = math.isfinite(half) and half > 0.0
    return abs(position - least - half) / half if known else math.nan


def percent(share: float) -> str:
    """A share in %, a dash where there is none."""
    return f"{100.0 * share:.0f} %" if math.isfinite(share) else "–"
