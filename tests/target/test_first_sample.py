"""FIRST_SAMPLE: when a program has to begin afresh, and that its outputs of that sample are not
used.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hardware import driver
from samples import run
from waiting import freeze

from zendsp_isr.build import source_root
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]
Wait = Callable[..., None]

PROGRAM = """
#include "isr.h"
static double fresh, fresh_tick = -1.0, fresh_enabled = -1.0, speed, last;
void UserInit(void) {
    SIGNAL(fresh, "", ""); SIGNAL(fresh_tick, "", ""); SIGNAL(fresh_enabled, "", ""); SIGNAL(speed, "rad/s", "the largest");
}
void UserISR_INT2(void) {
    const double q = READ_POSITION(0);
    if (FIRST_SAMPLE) {
        fresh += 1.0; fresh_tick = (double)SAMPLE_TICK; fresh_enabled = DRIVE_ENABLED ? 1.0 : 0.0;
        last = q;
    }
    const double qd = (q - last) / SAMPLE_PERIOD;
    speed = qd * qd > speed * speed ? qd : speed;
    last = q;
    WRITE_TORQUE(0, FIRST_SAMPLE ? 77.0 : 1.0);
}
void UserBackground(void) {}
"""  # noqa: E501

# An arm that somebody moves by a quarter of a radian whenever it is made safe, as at the begin of
# each pause.
PUSHED = driver(
    "place += 250;",
    before="static int place; static double most;",
    opened="info->adcs = 1; info->joint[0].speed_max = 10.0;",
    read="s->enc[0] = place; s->adc[0] = most;",
    write="if (a->aout[0] > most) most = a->aout[0];",
)
NAMES = ["fresh", "fresh_tick", "fresh_enabled", "speed"]


def _run(runtime: Runtime, ticks: int = 50) -> dict[str, float]:
    run(runtime, ticks)
    return {name: float(value) for name, value in runtime.read(NAMES)[1].items()}  # type: ignore[arg-type]


def test_a_program_begins_once_and_a_pause_of_a_simulated_machine_is_none(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(PROGRAM)
    assert _run(runtime)["fresh"] == 1.0
    assert _run(runtime)["fresh"] == 1.0, "time stood still"


def test_after_an_acknowledged_stop_it_begins_afresh_and_its_first_output_is_not_taken(
    make_runtime: Make, wait_for: Wait
) -> None:
    runtime = make_runtime(PROGRAM)
    _run(runtime)
    runtime.stop()
    wait_for(lambda: runtime.status().trip is not None)
    runtime.acknowledge()
    found = _run(runtime, 1)
    assert (found["fresh"], found["fresh_tick"], found["fresh_enabled"]) == (2.0, 50.0, 0.0)
    assert runtime.read(["cmd"])[1]["cmd"][0] != 0.0, "it said something"  # type: ignore[index]
    run(runtime, 1)
    assert not runtime.read(["aout"])[1]["aout"].any(), "which does not act"  # type: ignore[union-attr]


@pytest.mark.parametrize("pauses", [1, 3])
def test_after_a_pause_of_hardware_it_begins_afresh_wherever_the_arm_was_pushed_to(
    make_runtime: Make, wait_for: Wait, tmp_path: Path, pauses: int
) -> None:
    source = tmp_path / "pushed.c"
    source.write_text(PUSHED)
    runtime = make_runtime(PROGRAM, machine=str(source), clock="real", realtime=False)
    found = _run(runtime)
    for _ in range(pauses):
        tick = runtime.status().tick
        before, found = found["fresh"], _run(runtime, 1)  # a stall would be one more
        assert found["fresh"] == before + 1.0 and found["fresh_tick"] == tick
        assert found["fresh_enabled"] == 0.0
        found = _run(runtime)
    assert found["speed"] == 0.0, "0.25 rad in a pause are no speed of 250 rad/s"
    assert runtime.status().trip is None, "nor for the limit of 10 rad/s"
    assert runtime.read(["adc"])[1]["adc"] == pytest.approx(
        1.0
    ), "the machine was never given the 77 N m of a first sample"


CIRCLE = (source_root() / "programs" / "pd.c").read_text()


@pytest.mark.parametrize("policy", ["count", "skip"])
def test_after_a_stall_hardware_goes_on_in_true_time_and_begins_afresh(
    make_runtime: Make, wait_for: Wait, tmp_path: Path, policy: str
) -> None:
    """A runner that is stopped for half a second makes no burst of samples from one reading."""
    source = tmp_path / "still.c"
    source.write_text(driver(""))
    runtime = make_runtime(PROGRAM, machine=str(source), clock="real", realtime=False)
    runtime.set_overrun(policy)
    runtime.set_drive("torque")
    runtime.start()
    wait_for(lambda: runtime.status().tick > 100)
    freeze(runtime.runner_pid())
    before, began = runtime.status(), time.monotonic()
    time.sleep(0.5)
    stalled = 1e3 * (time.monotonic() - began)  # samples
    os.kill(runtime.runner_pid(), signal.SIGCONT)
    wait_for(lambda: runtime.status().tick > before.tick + stalled + 20.0)
    runtime.pause()
    status = runtime.status()
    assert status.trip is None
    # it may sleep towards the next sample when it is stopped, runs that one late, and the rest of
    # a period is none
    assert status.timing.missed - before.timing.missed >= stalled - 3.0
    assert status.timing.ticks + status.timing.missed == status.tick
    found = runtime.read(NAMES)[1]
    assert found["fresh"] >= 2.0 and found["fresh_enabled"] == 0.0
    assert found["fresh_tick"] >= before.tick + stalled - 3.0


def test_after_a_pause_of_the_whole_computer_a_simulated_arm_begins_afresh_where_it_stood(
    make_runtime: Make, wait_for: Wait
) -> None:
    """As in a virtual machine that was frozen. Otherwise the path would be far ahead of the arm."""
    runtime = make_runtime(CIRCLE, clock="real", realtime=False, hang_s=60.0)
    runtime.set_drive("torque")
    runtime.start()
    wait_for(lambda: runtime.status().tick > 1500)  # on its circle
    freeze(runtime.runner_pid())
    before = runtime.status()
    time.sleep(1.5)  # more than it makes good
    os.kill(runtime.runner_pid(), signal.SIGCONT)
    wait_for(lambda: runtime.status().tick > before.tick + 2500 or bool(runtime.status().trip))
    assert runtime.status().trip is None
    assert runtime.status().timing.missed >= 1400
