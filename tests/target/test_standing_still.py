"""A loop that stood still: frozen beside its monitor, or asleep with the whole computer."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from clocks import Clocks
from hardware import driver
from waiting import freeze

from zendsp_target.runtime import Runtime
from zendsp_target.runtime.process.supervise import Supervisor

Make = Callable[..., Runtime]
Wait = Callable[..., None]
PROGRAM = """
#include "isr.h"
static double fresh;
void UserInit(void) { SIGNAL(fresh, "", ""); }
void UserISR_INT2(void) { fresh += FIRST_SAMPLE; IOGP_FU1_WRITE_AOUT_ENGU(0) = 5.0; }
"""


@pytest.fixture
def hardware(tmp_path: Path) -> str:
    """A driver that keeps what it was given last, in mV, and the mode."""
    source = tmp_path / "still.c"
    source.write_text(driver("", before="static double mv;", read="s->adc[0] = mv;",
        write="mv = a->mode == MACHINE_TORQUE ? a->aout[0] : -1.0;", opened="info->adcs = 1;"))
    return str(source)


def _moves(make_runtime: Make, wait_for: Wait, machine: str, **options: float) -> Runtime:
    runtime = make_runtime(PROGRAM, machine=machine, clock="real", realtime=False, **options)
    runtime.set_drive("torque")
    runtime.start()
    wait_for(lambda: runtime.status().tick > 100)
    return runtime


@pytest.mark.parametrize("policy", ["count", "skip"])
def test_hardware_does_not_move_on_after_all_stood_still(
    make_runtime: Make, wait_for: Wait, hardware: str, monkeypatch: pytest.MonkeyPatch, policy: str
) -> None:
    """A frozen container, a virtual machine that was paused: the watchdog stood still as well."""
    monkeypatch.setattr(Supervisor, "_lost", lambda *_: 0.0)
    runtime = _moves(make_runtime, wait_for, hardware)
    runtime.set_overrun(policy)
    began, fresh = time.monotonic(), runtime.read(["fresh"])[1]["fresh"]
    freeze(runtime.runner_pid())
    time.sleep(1.2)  # more than is borne
    os.kill(runtime.runner_pid(), signal.SIGCONT)
    wait_for(lambda: runtime.status().trip is not None, runtime.status)
    trip = runtime.status().trip
    assert trip is not None and trip.reason == "stall" and trip.limit == 1.0
    assert 1.2 - 0.002 < trip.value < time.monotonic() - began + 0.002, "but for two samples"
    assert "the loop stood still for 1." in trip.text
    seen = runtime.read(["adc", "fresh"])[1]
    assert seen["adc"] == -1.0, "the machine has its safe outputs"
    assert seen["fresh"] == fresh, "and the program has not begun again"


@pytest.mark.parametrize("machine", ["hardware", "imi_planar"])
def test_a_computer_that_was_asleep_moves_no_hardware(
    make_runtime: Make, wait_for: Wait, hardware: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, machine: str,
) -> None:
    """All else that a loop waits by stands still meanwhile. A simulated machine sleeps, too."""
    clocks = Clocks(tmp_path)
    for name, value in clocks.env.items():
        monkeypatch.setenv(name, value)
    real = machine == "hardware"
    runtime = _moves(make_runtime, wait_for, hardware if real else machine, hang_s=60.0)
    missed = runtime.status().timing.missed
    clocks.set(since_start_s=3600)
    tick = runtime.status().tick
    wait_for(lambda: runtime.status().trip is not None or runtime.status().tick > tick + 1000)
    status = runtime.status()
    if real:
        assert status.trip is not None and status.trip.reason == "stall"
        assert 3599.0 < status.trip.value < 3700.0
        assert status.timing.missed - missed >= 3.5e6, "they are counted, and told in recordings"
    else:
        assert status.trip is None, status.trip


def test_the_time_of_day_may_be_set_while_hardware_moves(
    make_runtime: Make, wait_for: Wait, hardware: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clocks = Clocks(tmp_path)
    for name, value in clocks.env.items():
        monkeypatch.setenv(name, value)
    runtime = _moves(make_runtime, wait_for, hardware, hang_s=60.0)
    for day_s in (86400 * 365, -86400 * 365):
        clocks.set(day_s=day_s)
        tick = runtime.status().tick
        wait_for(lambda tick=tick: runtime.status().tick > tick + 200)
        status = runtime.status()
        assert status.trip is None and status.tick < tick + 60_000, status
