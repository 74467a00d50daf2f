"""Every joint beside its limits, as one table."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from zendsp.link.joints import joints_of
from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveMode, ProgramState
from zendsp_protocol.values import to_wire

AXIS = m.JointInfo(
    name="axis", unit="rad", counts_per_unit=1000.0, mv_per_torque=500.0, mv_per_speed=100.0
)
SLIDE = m.JointInfo(name="slide", unit="m", command="voltage", counts_per_unit=1e6)
LIMITS = m.Limits(
    position_min=(-1.0, -math.inf),
    position_max=(3.0, math.inf),
    speed_max=(50.0, 2.0),
    torque_max=(10.0, 0.0),
    command_max=(8000.0, 10000.0),
)


def status(mode: DriveMode = DriveMode.TORQUE, homed: bool = True) -> m.Status:
    io = {
        "enc": to_wire(np.array([2000.0, -500.0])),
        "aout": to_wire(np.array([-2500.0, 1000.0])),
    }
    return m.Status(state=ProgramState.RUNNING, io=io, drive_mode=mode, homed=homed)


def test_the_table_has_positions_and_commands_beside_their_limits() -> None:
    lines = repr(joints_of(status(), (AXIS, SLIDE), LIMITS)).splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["axis", "2.0000", "rad", "-1", "…", "3", "50", "%", "-5", "N", "m", "10", "50", "%", "50",
         "rad/s"],
        ["slide", "-0.0005", "m", "-inf", "…", "inf", "–", "1000", "mV", "10000", "10", "%", "2",
         "m/s"],
    ]  # fmt: skip


def test_a_joint_at_zero_has_no_sign() -> None:
    joint = replace(joints_of(status(), (AXIS, SLIDE), LIMITS)[0], position=-2e-5, command=-0.0)
    assert joint.row()[1] == "0.0000 rad" and joint.row()[4] == "0 N m"


def test_a_position_that_nothing_knows_is_not_told() -> None:
    """Before the homing the counter stands anywhere."""
    joint = joints_of(status(homed=False), (AXIS, SLIDE), LIMITS)[0]
    assert math.isnan(joint.position)
    assert joint.row()[1:4] == ("unknown", "-1 … 3", "–")


def test_a_command_that_nothing_sends_is_not_told() -> None:
    """After a crash it was "nan mV"."""
    crashed = m.Status(state=ProgramState.CRASHED, io={"enc": status().io["enc"]}, homed=True)
    assert joints_of(crashed, (AXIS, SLIDE), LIMITS)[0].row()[4] == "none"


def test_a_command_of_speed_is_told_in_what_goes_out() -> None:
    joint = joints_of(status(DriveMode.VELOCITY), (AXIS, SLIDE), LIMITS)[0]
    assert (joint.command, joint.command_unit, joint.command_max) == (-2500.0, "mV", 8000.0)


def test_a_notebook_shows_it_as_a_table() -> None:
    html = joints_of(status(), (AXIS, SLIDE), LIMITS)._repr_html_()
    assert "<th>speed limit</th>" in html and "<td>axis</td>" in html


def test_a_command_that_a_paused_machine_holds_is_not_shown_as_one_that_acts() -> None:
    """A simulated machine's time stands: -5 N m of 10 stood there as if they acted."""
    paused = m.Status(
        state=ProgramState.PAUSED, io=status().io, drive_mode=DriveMode.TORQUE, homed=True
    )
    joint = joints_of(paused, (AXIS, SLIDE), LIMITS)[0]
    assert math.isnan(joint.command) and joint.held == -5.0
    assert joint.row()[4:7] == ("none; -5 N m held", "10", "–")
    io = {**status().io, "aout": to_wire(np.zeros(2))}  # hardware: nothing is held
    hardware = m.Status(state=ProgramState.PAUSED, io=io, drive_mode=DriveMode.TORQUE, homed=True)
    assert joints_of(hardware, (AXIS, SLIDE), LIMITS)[0].row()[4] == "none"
