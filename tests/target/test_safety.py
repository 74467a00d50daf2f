"""Below the user's code, every sample: STOP, limits, drive modes, soft start. Outputs are judged by
what acts on the machine.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hardware import driver
from samples import rows_of, run
from waiting import freeze

from zendsp.link.metadata import ticks_of
from zendsp_protocol.errors import Refused
from zendsp_protocol.messages import Status
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]

# A constant command in mV on both outputs; changed by the host.
CONSTANT = """
#include "isr.h"
static double u[2], bad;
static bool enabled;
void UserInit(void) { PARAMETER(u, 0.0, "mV", NO_MIN, NO_MAX, ""); PARAMETER(bad, 0.0, "", NO_MIN, NO_MAX, ""); SIGNAL(enabled, "", ""); }
void UserISR_INT2(void) {
    enabled = DRIVE_ENABLED;
    IOGP_FU1_WRITE_AOUT_ENGU(0) = u[0];
    IOGP_FU1_WRITE_AOUT_ENGU(1, bad > 0.0 ? u[1] / 0.0 : u[1]);
}
"""  # noqa: E501
MV_PER_NM = (10000.0 / 245.0, 10000.0 / 39.2)
CHANNELS = ("tick", "aout", "drive", "enc", "cmd", "enabled")


def record(
    runtime: Runtime, ticks: int, at: dict[int, dict[str, object]]
) -> npt.NDArray[np.float64]:
    """Run so many samples with updates at given ticks; columns: tick, aout 0, 1, drive, enc 0, 1,
    cmd 0, 1, enabled.
    """
    for tick, values in at.items():
        runtime.write(values, "test", at_tick=tick)  # type: ignore[arg-type]
    return rows_of(runtime, CHANNELS, ticks)


def tripped(runtime: Runtime) -> Status:
    status = runtime.status()
    assert status.state == "stopped"
    assert status.trip is not None
    return status


def test_a_command_acts_one_sample_after_it_was_computed(make_runtime: Make) -> None:
    rows = record(make_runtime(CONSTANT), 20, {10: {"u[0]": 500.0}})
    assert np.array_equal(rows[:, 6], np.where(rows[:, 0] >= 10, 500.0, 0.0))
    assert np.array_equal(rows[:, 1], np.where(rows[:, 0] >= 11, 500.0, 0.0))


def test_stop_zeroes_output_within_two_samples_and_forces_velocity_mode(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT, clock="real")
    runtime.acquire_configure(0, AcquireConfig(CHANNELS, seconds=5.0, continuous=True))
    runtime.acquire_start(0)
    runtime.write({"u": [2000.0, 0.0]}, "test")
    runtime.start()
    while runtime.status().tick < 100:
        pass
    before = runtime.status().tick
    runtime.stop()
    while runtime.status().trip is None:
        pass
    trip = tripped(runtime).trip
    assert trip is not None and trip.reason == "stop" and trip.tick >= before
    while runtime.status().tick < trip.tick + 20:
        pass
    rows = runtime.acquire_read(0, 0, trip.tick + 10)
    after = rows[rows[:, 0] >= trip.tick]
    assert np.all(after[:, 1:3] == 0.0)
    assert np.all(after[:, 3] == 2.0)
    assert np.all(rows[(rows[:, 0] > 5) & (rows[:, 0] < trip.tick), 1] == 2000.0)


def test_the_stop_input_of_the_machine_stops(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    run(runtime, 10)
    runtime.set_inputs(1)
    run(runtime, 10)
    trip = tripped(runtime).trip
    assert trip is not None and (trip.reason, trip.tick) == ("stop input", 10)
    runtime.set_inputs(0)
    runtime.acknowledge()
    run(runtime, 10)
    assert runtime.status().trip is None


def test_a_stopped_arm_comes_to_rest_and_the_fast_clock_pauses_by_itself(
    make_runtime: Make, wait_for: Callable[..., None]
) -> None:
    runtime = make_runtime(CONSTANT)
    rows = record(runtime, 300, {0: {"u": [3000.0, 0.0]}})
    assert rows[-1, 4] - rows[-2, 4] > 100.0  # counts a sample: it moves
    runtime.start()
    runtime.stop()
    tick = -1

    def paused() -> bool:
        nonlocal tick
        before, tick = tick, runtime.status().tick
        return before == tick

    wait_for(paused)
    runtime.acquire_configure(1, AcquireConfig(("enc",), seconds=0.01))
    first = runtime.read(["enc"])[1]["enc"]
    assert tripped(runtime).drive_mode == "velocity"
    assert runtime.status().io["aout"].tolist() == [0.0, 0.0]
    assert np.all(np.isfinite(np.asarray(first)))


@pytest.mark.parametrize("joint", [0, 1])
def test_a_torque_beyond_its_limit_trips_before_it_acts(make_runtime: Make, joint: int) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.wait_applied(runtime.set_limits("test", torque_max=[30.0, 20.0]), 10.0)
    limit = (30.0, 20.0)[joint]
    inside, outside = limit * MV_PER_NM[joint], (limit + 0.1) * MV_PER_NM[joint]
    rows = record(runtime, 20, {5: {f"u[{joint}]": inside}, 10: {f"u[{joint}]": -outside}})
    trip = tripped(runtime).trip
    assert trip is not None
    assert (trip.reason, trip.joint, trip.tick) == ("torque", joint + 1, 10)
    assert trip.value == pytest.approx(-limit - 0.1)
    assert trip.limit == limit
    assert f"joint {joint + 1}" in trip.text
    assert np.array_equal(
        rows[:, 1 + joint], np.where((rows[:, 0] >= 6) & (rows[:, 0] <= 10), inside, 0.0)
    )
    assert np.array_equal(rows[:, 8], rows[:, 0] <= 10)


def test_torque_may_be_clamped_instead(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.wait_applied(runtime.set_limits("test", torque_max=10.0, torque_clamp=True), 10.0)
    rows = record(runtime, 10, {5: {"u[0]": -9000.0}})
    assert rows[-1, 1] == pytest.approx(-10.0 * MV_PER_NM[0])
    assert runtime.status().trip is None


def test_not_a_number_trips_and_never_reaches_the_machine(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    rows = record(runtime, 20, {10: {"bad": 1.0}})
    trip = tripped(runtime).trip
    assert trip is not None and (trip.reason, trip.joint, trip.tick) == ("nan", 2, 10)
    assert np.all(np.isfinite(rows[:, 1:3]))


def test_a_joint_beyond_its_limit_trips_and_can_be_brought_back(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT, machine_config={"q1": 0.4})
    runtime.wait_applied(runtime.set_limits("test", position_max=[0.5, 2.0]), 10.0)
    record(runtime, 400, {0: {"u": [2000.0, 0.0]}})
    trip = tripped(runtime).trip
    assert trip is not None and (trip.reason, trip.joint) == ("position", 1)
    assert 0.5 < trip.value < 0.51
    assert trip.limit == 0.5
    with pytest.raises(Refused, match="beyond the limit"):
        runtime.start()
    runtime.acknowledge()
    rows = record(runtime, 500, {0: {"u": [-1500.0, 0.0]}})
    assert runtime.status().trip is None
    assert rows[-1, 4] < rows[0, 4] - 100
    run(runtime, 1)
    record(runtime, 3000, {0: {"u": [2500.0, 0.0]}})
    assert tripped(runtime).trip is not None  # and the limit holds again


def test_a_program_that_goes_on_outward_gets_no_further_by_acknowledging(
    make_runtime: Make,
) -> None:
    """A joint that drifted outward stood 25 mrad farther out after each acknowledgement."""
    runtime = make_runtime(CONSTANT, machine_config={"q1": 0.4})
    runtime.wait_applied(runtime.set_limits("test", position_max=[0.5, 2.0]), 10.0)
    limits = []
    for _ in range(4):
        record(runtime, 400, {0: {"u": [1000.0, 0.0]}})
        trip = tripped(runtime).trip
        assert trip is not None and (trip.reason, trip.joint) == ("position", 1)
        limits.append(trip.limit)
        runtime.acknowledge()
    assert limits[0] == 0.5 and 0.52 < limits[1] < 0.53
    assert limits[3] < limits[1] + 0.01, limits  # by what it takes to stop
    rows = record(runtime, 500, {0: {"u": [-1500.0, 0.0]}})
    assert runtime.status().trip is None and rows[-1, 4] < rows[0, 4] - 100, "but back"


@pytest.mark.parametrize("runs", [False, True])
def test_a_limit_moved_to_this_side_of_a_joint_lets_it_no_further_out(
    make_runtime: Make, runs: bool
) -> None:
    """Though it may come back: it is where it may not be by no fault of its own."""
    for u, trips in ((2000.0, True), (-1500.0, False)):
        runtime = make_runtime(CONSTANT, machine_config={"q1": 0.4})
        if runs:
            record(runtime, 100, {0: {"u": [0.0, 0.0]}})
        runtime.wait_applied(runtime.set_limits("test", position_max=[0.3, 2.0]), 10.0)
        begin = 100 if runs else 0
        record(runtime, 100, {begin: {"u": [0.0, 0.0]}})
        assert runtime.status().trip is None, "it may stay where it is"
        rows = record(runtime, 400, {begin + 100: {"u": [u, 0.0]}})
        assert (runtime.status().trip is not None) is trips
        if trips:
            trip = tripped(runtime).trip
            assert trip is not None and (trip.reason, trip.joint) == ("position", 1)
            assert 0.42 < trip.value < 0.44
        else:
            assert rows[-1, 4] < rows[0, 4] - 100


def test_a_joint_too_fast_trips(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.wait_applied(runtime.set_limits("test", speed_max=[9.0, 1.0]), 10.0)
    record(runtime, 300, {0: {"u": [0.0, 3000.0]}})
    trip = tripped(runtime).trip
    assert trip is not None and (trip.reason, trip.joint) == ("speed", 2)
    assert 1.0 < trip.value < 1.6  # seen within the 10 ms over which speed is measured


def test_limits_are_only_tightened(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    for changes, names in (
        ({"torque_max": 300.0}, "joint 1"),
        ({"position_min": [-1.0, -3.0]}, "joint 2"),
        ({"power": 1.0}, "power"),
    ):
        with pytest.raises(Refused, match=names):
            runtime.set_limits("test", **changes)
    runtime.wait_applied(runtime.set_limits("test", torque_max=[10.0, 5.0]), 10.0)
    assert runtime.limits().torque_max == (10.0, 5.0)


def test_drives_that_are_off_give_nothing(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.set_drive("off")
    rows = record(runtime, 20, {0: {"u": [1000.0, 1000.0]}})
    assert np.all(rows[:, 1:4] == 0.0)
    assert np.all(rows[:, 6] == 1000.0)
    assert np.all(rows[:, 8] == 0.0)


def test_velocity_mode_follows_a_speed_reference(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.set_drive("velocity")
    rows = record(runtime, 600, {0: {"u": [1000.0, 0.0]}})  # 10 000 mV are 9 rad/s
    speed = (rows[-1, 4] - rows[-101, 4]) / 0.1 / (153600.0 / (2.0 * np.pi))
    assert speed == pytest.approx(0.9, abs=0.02)  # the drive's own loop is not infinitely stiff
    assert np.all(rows[1:, 3] == 2.0)


def test_soft_start_and_soft_stop_ramp_the_output(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.set_ramp(0.1)
    rows = record(runtime, 150, {0: {"u": [300.0, 0.0]}})
    # 1 % a sample; two where the first command arrives
    assert np.max(np.abs(np.diff(rows[:, 1]))) <= 3.0 + 1e-9 + 3.0
    assert rows[50, 1] == pytest.approx(0.51 * 300.0)
    assert rows[-1, 1] == 300.0
    runtime.set_drive("off")
    rows = record(runtime, 150, {})
    assert np.max(np.abs(np.diff(rows[:, 1]))) <= 3.0 + 1e-9
    assert rows[-1, 1] == 0.0
    assert rows[-1, 3] == 0.0


def test_homing_moves_to_the_home_position(
    make_runtime: Make, wait_for: Callable[..., None]
) -> None:
    runtime = make_runtime(CONSTANT, machine_config={"q1": 0.3, "q2": -0.2})
    runtime.home()
    wait_for(
        lambda: runtime.status().tick > 100 and runtime.status().state == "loaded", runtime.status
    )
    position = runtime.status().io["enc"] / (153600.0 / (2.0 * np.pi))
    # the machine's own homing tolerance is 1e-3 rad, and it coasts a little
    assert np.all(np.abs(position) < 2e-3)
    assert runtime.status().homed


def test_overruns_trip_after_so_many_in_a_row(
    make_runtime: Make, wait_for: Callable[..., None]
) -> None:
    slow = """
    #include "isr.h"
    static volatile double work;
    static bool heavy;
    void UserInit(void) { PARAMETER(heavy, 0, "", 0, 1, ""); }
    void UserISR_INT2(void) { if (heavy) for (int i = 0; i < 3000000; i++) work = work + 1e-3; }
    """
    runtime = make_runtime(slow, clock="real")
    runtime.set_overrun("trip", 5)
    runtime.start()
    runtime.write({"heavy": True}, "test")
    wait_for(lambda: runtime.status().trip is not None, runtime.status)
    trip = tripped(runtime).trip
    assert trip is not None and trip.reason == "overrun" and trip.value == 5.0
    assert runtime.status().timing.overruns >= 5
    runtime.write({"heavy": False}, "test")


def test_a_stall_of_the_computer_is_no_slow_program(
    make_runtime: Make, wait_for: Callable[..., None], tmp_path: Path
) -> None:
    """A simulated machine is waited for. Hardware was without control for so many samples."""
    hardware = tmp_path / "still.c"
    hardware.write_text(driver(""))
    for machine, trips in (("imi_planar", False), (str(hardware), True)):
        runtime = make_runtime(CONSTANT, machine=machine, clock="real", realtime=False)
        runtime.set_overrun("trip", 60)
        runtime.start()
        wait_for(lambda runtime=runtime: runtime.status().tick > 50)
        overruns = runtime.status().timing.overruns
        freeze(runtime.runner_pid())
        time.sleep(0.2)
        os.kill(runtime.runner_pid(), signal.SIGCONT)
        wait_for(lambda runtime=runtime: runtime.status().tick > 300)
        status = runtime.status()
        assert (status.trip is not None) == trips, status
        if trips:
            assert status.trip is not None and status.trip.reason == "overrun"
        else:
            assert status.timing.overruns - overruns > 100, "they are counted as late all the same"


def test_skipped_samples_are_counted_and_time_stays_true(make_runtime: Make) -> None:
    stall = """
    #include "isr.h"
    static volatile double work;
    void UserInit(void) {}
    void UserISR_INT2(void) { if (SAMPLE_TICK == 20) for (int i = 0; i < 30000000; i++) work = work + 1e-3; }
    """  # noqa: E501
    runtime = make_runtime(stall, clock="real")
    runtime.set_overrun("skip")
    runtime.acquire_configure(0, AcquireConfig(("tick",), seconds=5.0))
    runtime.acquire_start(0)
    run(runtime, 400)
    status, kept = runtime.status(), runtime.acquire_status(0)
    assert status.timing.missed > 0
    assert status.timing.ticks + status.timing.missed == status.tick
    rows = runtime.acquire_read(0, 0, 1000)[:, 0]
    assert rows[0] == 0.0
    assert len(rows) + kept.lost == status.tick
    ticks = ticks_of(0, len(rows), kept.start_tick, kept.decimation, kept.gaps)
    assert kept.gaps and np.array_equal(ticks, rows), "a gap in time where samples were left out"
