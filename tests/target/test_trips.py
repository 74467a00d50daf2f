"""What trips below the user's code, what stays latched, and what a program sees when it begins
afresh.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from samples import run
from waiting import PATIENCE_S

from zendsp_protocol.errors import Refused
from zendsp_protocol.messages import Trip
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]
Wait = Callable[..., None]

CONSTANT = """
#include "isr.h"
static double u[2];
void UserInit(void) { PARAMETER(u, 0.0, "mV", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) { for (int j = 0; j < 2; j++) IOGP_FU1_WRITE_AOUT_ENGU(j) = u[j]; }
"""
FIRST = """
#include "isr.h"
static double samples, firsts, with_drives;
static double u;
void UserInit(void) {
    SIGNAL(samples, "", ""); SIGNAL(firsts, "", ""); SIGNAL(with_drives, "", ""); PARAMETER(u, 0.0, "mV", NO_MIN, NO_MAX, "");
}
void UserISR_INT2(void) {
    samples += 1.0;
    if (FIRST_SAMPLE) { firsts += 1.0; with_drives += DRIVE_ENABLED; }
    IOGP_FU1_WRITE_AOUT_ENGU(0) = u;
}
"""  # noqa: E501
# the shipped pendulum with another sensor and another way home
OTHER = """
#include <math.h>
#define zendsp_machine pendulum_machine
#include "pendulum.c"
#undef zendsp_machine
static int reads;
static int other_open(void **h, const char *c, double p, machine_info *i, char *e, size_t n) {
    return pendulum_machine.open(h, c, p, i, e, n);
}
static void other_read(void *h, machine_sensors *s) { pendulum_machine.read(h, s); s->fault = %(fault)s; reads++; }
static void other_write(void *h, const machine_actuators *u) { pendulum_machine.write(h, u); }
static void other_step(void *h, double dt) { pendulum_machine.step(h, dt); }
static void other_safe(void *h) { pendulum_machine.safe(h); }
static int other_home(void *h, const machine_sensors *s, machine_actuators *u) {
    (void)h; (void)s;
    u->mode = MACHINE_VELOCITY;
    u->aout[0] = NAN;
    return MACHINE_HOME_BUSY;
}
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = other_open, .read = other_read, .write = other_write,
    .step = other_step, .safe = other_safe, .home = other_home};
"""  # noqa: E501


def trip_of(runtime: Runtime) -> Trip:
    """The trip that stands."""
    trip = runtime.status().trip
    assert trip is not None
    return trip


def other(folder: Path, fault: str) -> str:
    """A machine like the pendulum, whose sensor reports a fault where the C expression holds."""
    path = folder / "other.c"
    path.write_text(OTHER % {"fault": fault})
    return str(path)


def test_a_speed_command_beyond_its_limit_trips_before_it_acts(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.set_drive("velocity")
    runtime.wait_applied(runtime.set_limits("test", speed_max=[1.0, 1.0]), 10.0)
    mv_per_speed = runtime.machine().joints[0].mv_per_speed
    runtime.write({"u[0]": 1.1 * mv_per_speed}, "test", at_tick=10)
    run(runtime, 20)
    trip = trip_of(runtime)
    assert (trip.reason, trip.joint, trip.tick, trip.limit) == ("speed", 1, 10, 1.0)
    assert trip.value == pytest.approx(1.1)  # the command, not what was measured


def test_a_command_beyond_what_the_drive_takes_trips_before_it_acts(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT)
    runtime.wait_applied(runtime.set_limits("test", command_max=[500.0, 500.0]), 10.0)
    runtime.write({"u[1]": -501.0}, "test", at_tick=10)
    run(runtime, 20)
    trip = trip_of(runtime)
    assert (trip.reason, trip.joint, trip.tick, trip.value, trip.limit) == (
        "command",
        2,
        10,
        -501.0,
        500.0,
    )


def test_a_sensor_that_reports_a_fault_trips_in_that_sample(
    make_runtime: Make, tmp_path: Path
) -> None:
    runtime = make_runtime(CONSTANT, machine=other(tmp_path, "reads >= 20"))
    runtime.write({"u[0]": 300.0}, "test")
    runtime.acquire_configure(0, AcquireConfig(("tick", "aout"), seconds=0.05))
    runtime.acquire_start(0)
    run(runtime, 50)
    trip = trip_of(runtime)
    assert (trip.reason, trip.joint) == ("sensor", 1)
    rows = runtime.acquire_read(0, 0, 50)
    assert np.all(rows[rows[:, 0] >= trip.tick, 1] == 0.0) and rows[trip.tick - 1, 1] == 300.0


def test_homing_is_held_to_the_limits_too(
    make_runtime: Make, wait_for: Wait, tmp_path: Path
) -> None:
    runtime = make_runtime(CONSTANT, machine=other(tmp_path, "0"))
    runtime.home()
    wait_for(lambda: runtime.status().trip is not None, runtime.status)
    assert trip_of(runtime).reason == "nan"
    assert np.all(np.isfinite(np.asarray(runtime.status().io["aout"])))


def test_the_first_trip_is_the_one_that_is_told(make_runtime: Make, wait_for: Wait) -> None:
    runtime = make_runtime(CONSTANT, clock="real")
    runtime.wait_applied(runtime.set_limits("test", torque_max=[1.0, 1.0]), 10.0)
    runtime.write({"u[0]": 9000.0}, "test")
    runtime.start()
    wait_for(lambda: runtime.status().trip is not None, runtime.status)
    first = trip_of(runtime)
    runtime.stop()
    runtime.write({"u[0]": float(first.tick)}, "test")
    after = runtime.status().tick + 10
    wait_for(lambda: runtime.status().tick > after, runtime.status)
    assert trip_of(runtime) == replace(first, number=first.number + 1), "a STOP beside it counts"
    assert first.reason == "torque"


def test_a_joint_stopped_beyond_its_limit_goes_no_further_out(make_runtime: Make) -> None:
    runtime = make_runtime(CONSTANT, machine_config={"q1": 0.4})
    runtime.wait_applied(runtime.set_limits("test", position_max=[0.5, 2.0]), 10.0)
    runtime.write({"u[0]": 2000.0}, "test")
    run(runtime, 1500)
    stopped = trip_of(runtime)
    assert stopped.reason == "position" and stopped.value > 0.5
    runtime.acknowledge()
    run(runtime, 1500)
    again = trip_of(runtime)
    assert again.reason == "position"
    # 0.02 rad of room for the soft start, where it came to rest after the first trip, and a
    # sample's motion
    assert again.value < stopped.value + 0.1
    assert not stopped.idle and "commands it 0" not in stopped.text


@pytest.mark.parametrize("fall", [{"position_min": [0.5]}, {"speed_max": [2.0]}])
def test_a_joint_that_its_program_leaves_to_its_weight_is_told_so(
    make_runtime: Make, fall: dict[str, list[float]]
) -> None:
    runtime = make_runtime(CONSTANT, machine="pendulum", machine_config={"q1": 1.5})
    runtime.wait_applied(runtime.set_limits("test", **fall), 10.0)
    run(runtime, 1500)
    trip = trip_of(runtime)
    assert trip.reason in ("position", "speed") and trip.idle, trip
    assert "; the program commands it 0, so nothing holds it (sample" in trip.text


SLOW = (
    '#include "isr.h"\n#include <fcntl.h>\n#include <unistd.h>\n'
    'void UserInit(void) {'
    ' close(open("%(begun)s", O_CREAT | O_WRONLY, 0600));'
    ' while (access("%(go)s", F_OK) != 0) usleep(1000); }\n'
    "void UserISR_INT2(void) {}\n"
)


def test_stop_does_not_wait_behind_a_load(
    make_runtime: Make, wait_for: Wait, tmp_path: Path
) -> None:
    runtime = make_runtime(CONSTANT)
    begun, go = tmp_path / "begun", tmp_path / "go"
    slow = runtime.compile({"slow.c": SLOW % {"begun": begun, "go": go}})
    assert slow.ok, slow.diagnostics
    with ThreadPoolExecutor(1) as beside:
        load = beside.submit(runtime.load, slow.key)
        wait_for(begun.exists)
        runtime.stop()
        go.touch()
        # a STOP that waits for the load waits until it is given up, since nobody lets it go on
        load.result(PATIENCE_S)


def test_what_begins_afresh_sees_a_first_sample_with_the_drives_off(
    make_runtime: Make, wait_for: Wait
) -> None:
    runtime = make_runtime(FIRST)
    runtime.write({"u": 10.0}, "test")

    def seen() -> tuple[float, float]:
        values = runtime.read(["firsts", "with_drives"])[1]
        return values["firsts"], values["with_drives"]  # type: ignore[return-value]

    def home() -> None:
        before = runtime.status().tick
        runtime.home()
        wait_for(
            lambda: runtime.status().tick > before and runtime.status().state != "running",
            runtime.status,
        )

    def stopped() -> None:
        runtime.start()
        runtime.stop()
        wait_for(lambda: runtime.status().trip is not None, runtime.status)
        runtime.acknowledge()

    run(runtime, 20)
    firsts, with_drives = seen()
    assert firsts == 1.0  # after load
    for what, count in ((home, 1.0), (lambda: None, 0.0), (stopped, 1.0), (home, 1.0)):
        what()
        before = runtime.status().tick
        runtime.acquire_configure(0, AcquireConfig(("firsts", "aout", "cmd"), seconds=0.02))
        runtime.acquire_start(0)
        run(runtime, 20)
        assert runtime.status().tick == before + 20
        assert seen() == (firsts + count, with_drives), what
        rows = runtime.acquire_read(0, 0, 20)
        assert rows[-1, 1] == 10.0, "the drives are on again"
        if count:
            assert rows[0, 0] == firsts + count and np.all(
                rows[:2, 1] == 0.0
            ), "its first command does not act"
        firsts += count


def test_a_setting_that_the_machine_does_not_know_is_refused(
    make_runtime: Callable[..., Runtime],
) -> None:
    code = "void UserInit(void) {} void UserISR_INT2(void) {}"
    with pytest.raises(Refused, match="no setting 'command'; it asks for drive") as caught:
        make_runtime(f'#include "isr.h"\n{code}', "pendulum", machine_config={"command": "voltage"})
    assert "SAFE" not in str(caught.value)


TWO_JOINTS = """
#include "isr.h"
static double u;
void UserInit(void) { PARAMETER(u, 0.0, "N m", -5.0, 5.0, ""); }
void UserISR_INT2(void) { WRITE_TORQUE(0, 0.0); WRITE_TORQUE(1, u); }
"""


def test_a_command_to_a_joint_that_the_machine_has_not_trips_and_names_it(
    make_runtime: Callable[..., Runtime],
) -> None:
    runtime = make_runtime(TWO_JOINTS, machine="pendulum")
    runtime.set_drive("torque")
    run(runtime, 50)
    assert runtime.status().trip is None, "zero asks for nothing"
    runtime.write({"u": 1.0}, "test", 60)
    run(runtime, 50)
    trip = runtime.status().trip
    assert trip is not None and (trip.reason, trip.joint, trip.tick) == ("command", 2, 60)
    assert "writes to joint 2, which this machine has not: it has 1;" in trip.text
    assert "WRITE_TORQUE(1, …)" in trip.text, "and where that stands in the code"


def test_a_torque_to_a_joint_that_takes_a_voltage_trips_and_names_what_it_takes(
    make_runtime: Callable[..., Runtime],
) -> None:
    runtime = make_runtime(
        TWO_JOINTS.replace("(1, u)", "(0, u)"), machine="pendulum",
        machine_config={"drive": "voltage"},
    )
    runtime.set_drive("torque")
    run(runtime, 50)
    assert runtime.status().trip is None, "zero asks for nothing"
    runtime.write({"u": 1e-6}, "test", 60)
    run(runtime, 50)
    trip = runtime.status().trip
    assert trip is not None and (trip.reason, trip.joint, trip.tick) == ("torque", 1, 60)
    assert "1e-06 N m to joint 1, which takes a voltage: IOGP_FU1_WRITE_AOUT_ENGU(0)" in trip.text


READS = """
#include "isr.h"
static int32_t j;
static double got;
void UserInit(void) { PARAMETER(j, 0, "", -100, 100, ""); SIGNAL(got, "rad", ""); }
void UserISR_INT2(void) { got = %s; }
"""


@pytest.mark.parametrize(
    ("code", "index", "named"),
    [
        ("READ_POSITION(1)", 0, 1),
        ("READ_POSITION(j)", 1, 1),
        ("READ_POSITION(j)", 8, 8),  # not joint 0 once more
        ("READ_POSITION(j)", -1, -1),
        ("IOGP_FU1_READ_ADC(j)", 9, 9),
        ("(WRITE_TORQUE(j, 0.0), 0.0)", 16, 16),
    ],
)
def test_a_joint_that_is_read_and_is_not_there_trips_and_is_named(
    make_runtime: Callable[..., Runtime], code: str, index: int, named: int
) -> None:
    """It was a joint that stands at 0, or another one."""
    runtime = make_runtime(READS % code, machine="pendulum")
    if "j" in code:
        run(runtime, 20)
        assert runtime.status().trip is None
        runtime.write({"j": index}, "test")
    run(runtime, 20)
    trip = runtime.status().trip
    assert trip is not None and trip.reason == "outside"
    said = f"the code names joint or channel [{named}], counted from 0, which is not there"
    assert said in trip.text and "this machine has 1 joint" in trip.text


@pytest.mark.parametrize(
    "call", ["WRITE_TORQUE(8, 1.0)", "IOGP_FU1_WRITE_AOUT_ENGU(-1) = 1.0", "READ_POSITION(64)"]
)
def test_a_channel_that_no_machine_has_does_not_compile(
    make_runtime: Callable[..., Runtime], call: str
) -> None:
    runtime = make_runtime(TWO_JOINTS)
    code = f'#include "isr.h"\nvoid UserInit(void) {{}}\nvoid UserISR_INT2(void) {{\n {call};\n}}\n'
    result = runtime.compile({"user.c": code.replace("READ", "volatile double q = READ")})
    assert not result.ok
    (error,) = [d for d in result.diagnostics if d.severity == "error"]
    assert error.line == 4 and "channels and joints are 0 to 7" in error.message


def test_a_variable_of_a_function_is_not_declared(make_runtime: Callable[..., Runtime]) -> None:
    """Else the host would read, and write, the stack of the loop."""
    local = '''
    #include "isr.h"
    void UserInit(void) { double gain = 3.0; PARAMETER(gain, 1.0, "", 0.0, 5.0, ""); }
    void UserISR_INT2(void) {}
    '''
    with pytest.raises(Refused, match="'gain': it ends with its function: declare it static"):
        make_runtime(local)
