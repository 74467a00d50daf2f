"""What an experiment needs of a machine, and what a machine lacks of it, in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from zendsp_protocol.messages import JointInfo, MachineInfo
from zendsp_protocol.texts import counted

Command = Literal["torque", "voltage"]
HAS_BOTH = "pendulum"  # a setting of it chooses
FORCES = ("torque", "force")  # of a slide


@dataclass(frozen=True)
class Needs:
    """What a machine must have, or declare, for an experiment.

    Attributes
    ----------
    command : {"torque", "voltage"}
        What every joint with a drive takes; the force of a slide counts as a torque.
    least : int
        How many joints with a drive.
    most : int
        How many joints at all; 0: any number.
    sensed : bool
        An analog input in A and one in V for each joint with a drive.
    model : str
        What a model file is needed for; "": for nothing. The shipped machine has its own.
    """

    command: Command = "torque"
    least: int = 1
    most: int = 0
    sensed: bool = False
    model: str = ""

    def words(self) -> str:
        """The needs in a line, for a list."""
        joints = {(1, 0): "", (1, 1): ", one joint"}.get(
            (self.least, self.most), f", {self.least} joints" + (" or more" * (not self.most))
        )
        sensors = ", current and voltage sensed" if self.sensed else ""
        return f"{self.command}{joints}{sensors}" + (", --model" if self.model else "")

    def lacking(self, machine: MachineInfo, has_model: bool) -> str:
        """A sentence on what a machine lacks; "" where it has everything.

        Parameters
        ----------
        machine : MachineInfo
            What it declares while a program is loaded: before, it tells no joints.
        has_model : bool
            Whether there is a model file, or the machine needs none.
        """
        driven = driven_joints(machine)
        if not driven:
            return "needs a joint with a motor, and this machine has none"
        fit = FORCES if self.command == "torque" else (self.command,)
        other = next((j for j in driven if j.command not in fit), None)
        if other is not None:
            both = (
                f"; start its target with --machine-option drive={self.command}"
                if machine.name == HAS_BOTH and not machine.model else ""
            )
            return (
                f"needs a machine whose command is a {self.command}, at {other.name} it is a"
                f" {other.command}{both}"
            )
        if len(driven) < self.least:
            has = counted(len(driven), "joint")
            return f"needs {self.least} joints with a drive, and this machine has {has}"
        if 0 < self.most < len(machine.joints):
            has = counted(len(machine.joints), "joint")
            return f"needs a machine of {counted(self.most, 'joint')}, and this one has {has}"
        if self.sensed and (lacks := _unsensed(machine, len(driven))):
            return lacks
        if self.model and not has_model:
            return f"needs a model file of the machine, {self.model}: give it with --model FILE"
        return ""


def driven_joints(machine: MachineInfo) -> list[JointInfo]:
    """The joints that have a drive."""
    return [j for j in machine.joints if j.command != "none"]


def inputs_of(machine: MachineInfo, unit: str) -> list[int]:
    """Which analog inputs have a unit, from 0; the k-th is that of the k-th joint with a drive."""
    return [k for k, own in enumerate(machine.adc_units) if own == unit]


def _unsensed(machine: MachineInfo, joints: int) -> str:
    for unit, what in (("A", "current"), ("V", "voltage")):
        found = len(inputs_of(machine, unit))
        if found < joints:
            return (
                f"needs the {what} of each motor among the analog inputs (unit {unit}); of"
                f" {counted(joints, 'joint')} with a drive this machine tells {found or 'none'}"
            )
    return ""
