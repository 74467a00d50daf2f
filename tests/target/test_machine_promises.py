"""A machine whose own description cannot be meant is refused before anything moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hardware import driver

from zendsp_protocol.errors import ZendspError
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]

PROGRAM = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
JOINT = "machine_joint *j = &info->joint[0]; "


@pytest.mark.parametrize(
    ("opened", "says"),
    [
        (JOINT + "j->counts_per_unit = 0.0;", "counts_per_unit is 0 or no number"),
        (JOINT + "j->position_min = 0.0 / 0.0;", "position_min is not below position_max"),
        (JOINT + "j->position_min = 101.0;", "position_min is not below position_max"),
        (JOINT + "j->speed_max = 0.0;", "speed_max is not above 0"),
        (JOINT + "j->torque_max = -1.0;", "torque_max is below 0"),
        (JOINT + 'snprintf(j->command, 8, "torque"); j->mv_per_torque = 0.0;', "mv_per_torque is"),
        (JOINT + "j->mv_per_torque = 0.0 / 0.0;", "mv_per_torque is no number"),
        (JOINT + "j->mv_per_speed = 1.0 / 0.0;", "mv_per_speed is no number"),
        ("info->dins = 2; info->stop_input = 2;", "stop_input 2 is none of its 2 digital inputs"),
        ("info->stop_input = 0;", "stop_input 0 is none of its 0 digital inputs"),
        ("info->stop_level = 2;", "stop_level is 0 or 1, not 2"),
        ("info->dins = 33;", "33 dins and 0 douts: 0 to 32 are possible"),
        ("info->joints = 9;", "1 to 8 joints"),
        ("info->joints = 0;", "1 to 8 joints"),
        ("info->adcs = -1;", "0 to 8 adcs are possible, not 1 and -1"),
    ],
)
def test_a_machine_that_cannot_be_as_it_says_is_refused_with_the_field(
    make_runtime: Make, tmp_path: Path, opened: str, says: str
) -> None:
    machine = tmp_path / "axis.c"
    machine.write_text(driver(safe="", opened=opened))
    with pytest.raises(ZendspError) as refused:
        make_runtime(PROGRAM, str(machine), clock="real")
    assert says in str(refused.value)


def test_a_machine_without_limits_of_position_is_not_refused(
    make_runtime: Make, tmp_path: Path
) -> None:
    """A shaft that turns for ever: enabling asks for limits, loading does not."""
    machine = tmp_path / "axis.c"
    endless = JOINT + "j->position_min = -1.0 / 0.0; j->position_max = 1.0 / 0.0;"
    machine.write_text(driver(safe="", opened=endless))
    make_runtime(PROGRAM, str(machine), clock="real")


@pytest.mark.parametrize("wrong", [JOINT + "j->counts_per_unit = 0.0;", "info->joints = 0;"])
def test_a_refused_description_leaves_the_machine_safe(
    make_runtime: Make, tmp_path: Path, wrong: str
) -> None:
    """Its driver works: only what it says of itself is wrong, so that safe() is still called."""
    machine, said = tmp_path / "axis.c", tmp_path / "safe"
    machine.write_text(
        driver(
            safe=f'fclose(fopen("{said}", "w"));', opened=wrong
        )
    )
    with pytest.raises(ZendspError) as refused:
        make_runtime(PROGRAM, str(machine), clock="real")
    assert "NOT SAFE" not in str(refused.value)
    assert said.exists()
