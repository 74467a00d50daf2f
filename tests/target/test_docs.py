"""What docs/isr.md and docs/machines.md print is true: the code in them compiles, runs, and does
what it says.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples import rows_of

from zendsp_isr.build import source_root
from zendsp_protocol import stop_page
from zendsp_target.runtime import Runtime

DOCS = Path(__file__).parents[2] / "docs"


def first_code(page: str) -> str:
    """First C block of a page."""
    match = re.search(r"```c\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    assert match is not None
    return match[1]


def test_the_stop_page_is_as_the_protocol_tells_clients_of_others() -> None:
    text = " ".join((DOCS / "protocol.md").read_text().split())
    said = re.search(r"`stop`\. This is the path of a file of (\d+) bytes", text)
    words = re.findall(r"`(\w+)` \(uint32, (0x\w+|\d+)\)", text)
    assert said and int(said[1]) == stop_page.SIZE
    assert {name: int(word, 0) for name, word in words} == {
        "magic": stop_page.MAGIC, "version": stop_page.VERSION,
    }  # fmt: skip
    assert f"`by` ({stop_page.REASON - stop_page.BY} bytes of UTF-8, at {stop_page.BY}" in text
    assert f"`reason` (uint32, at {stop_page.REASON})" in text


def test_the_program_of_the_page_controls_the_machine_of_the_page(
    make_runtime: Callable[..., Runtime], tmp_path: Path
) -> None:
    machine = tmp_path / "my_axis.c"
    machine.write_text(first_code("machines.md"))
    runtime = make_runtime(first_code("isr.md"), machine=str(machine), machine_config={"q1": 0.5})
    runtime.wait_applied(runtime.write({"Kp": 1.0}, "me"), 10.0)
    rows = rows_of(runtime, ("q", "tau", "cmd", "aout"), 2000)
    assert rows[0, 0] == np.floor(0.5 * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    assert abs(rows[-1, 0]) < 0.1  # a damped swing to zero: time constant 2 J / b = 1 s
    assert np.array_equal(rows[:, 1], -rows[:, 0])
    assert np.array_equal(rows[1:, 3], rows[:-1, 2])
    info = runtime.machine()
    assert (info.name, info.simulated, info.joints[0].torque_max) == ("my_axis", True, 10.0)


def test_a_machine_without_homing_is_homed_at_once(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], tmp_path: Path
) -> None:
    machine = tmp_path / "my_axis.c"
    machine.write_text(first_code("machines.md"))
    runtime = make_runtime(first_code("isr.md"), machine=str(machine))
    runtime.home()
    wait_for(
        lambda: runtime.status().tick > 0 and runtime.status().state == "loaded", runtime.status
    )
    assert runtime.status().homed


HOMING = """
static int axis_home(void *h, const machine_sensors *s, machine_actuators *u) {
    const axis *a = h;
    const double q = s->enc[0] / (4096 / 6.283185307179586);
    u->mode = MACHINE_TORQUE;
    u->aout[0] = 1000.0 * (-0.5 * q - 0.3 * a->qd);
    return fabs(q) < 2e-3 && fabs(a->qd) < 1e-2 ? MACHINE_HOME_DONE : MACHINE_HOME_BUSY;
}
const machine_ops"""


def test_a_machine_may_home_in_torque_mode(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], tmp_path: Path
) -> None:
    machine = tmp_path / "homing_axis.c"
    code = (
        first_code("machines.md")
        .replace("const machine_ops", HOMING, 1)
        .replace(".safe = axis_safe", ".home = axis_home, .safe = axis_safe")
    )
    machine.write_text(code)
    runtime = make_runtime(first_code("isr.md"), machine=str(machine), machine_config={"q1": 0.5})
    runtime.home()
    wait_for(
        lambda: runtime.status().tick > 10 and runtime.status().state == "loaded", runtime.status
    )
    assert runtime.status().homed
    assert abs(runtime.status().io["enc"][0]) <= 3  # counts: it went there, by torque


def homing_axis(lost: bool = False) -> str:
    """The machine of the page with its recipe of homing in place of the namesakes."""
    code = first_code("machines.md")
    page = (DOCS / "machines.md").read_text()
    found = re.search(r"```c\n(enum \{ TO_SWITCH.*?)```", page, re.DOTALL)
    assert found is not None
    code = re.sub(r"typedef struct axis .*?\n", "", code)
    code = re.sub(r"static void axis_(read|step)\(.*?\n}\n", "", code, flags=re.DOTALL)
    code = code.replace("static int axis_open", f"{found[1]}\nstatic int axis_open")
    code = code.replace("info->joints = 1;", "info->joints = info->needs_homing = info->dins = 1;")
    code = code.replace("    snprintf(info->name", "    a->start = a->q;\n    snprintf(info->name")
    code = code.replace(".safe = axis_safe", ".home = axis_home, .safe = axis_safe")
    return code.replace("a->q < -2.5", "0 * (a->q < -2.5)") if lost else code


def counted_position(runtime: Runtime) -> float:
    """Where the counter says that the axis stands, rad."""
    return float(runtime.status().io["enc"][0]) / (4096 / 6.283185307179586)


@pytest.mark.parametrize("start", [0.7, -2.8, -2.4])
def test_the_homing_of_the_page_finds_zero_from_before_on_and_behind_the_switch(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], tmp_path: Path,
    start: float,
) -> None:
    """It ends in the sample after the index, which stands at -2.3 rad: 0.1 rad/s is 1e-4 rad a
    sample, and the counter has 1.5e-3 rad.
    """
    machine = tmp_path / "homing_axis.c"
    machine.write_text(homing_axis())
    runtime = make_runtime(first_code("isr.md"), str(machine), machine_config={"q1": start})
    for _ in range(2):
        homings = runtime.status().homings
        runtime.home()
        wait_for(lambda h=homings: runtime.status().homings > h, runtime.status)
        assert abs(counted_position(runtime) - -2.3) < 3e-3
        assert runtime.status().trip is None and not runtime.status().homing


def test_the_homing_of_the_page_begins_anew_after_a_stop(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], tmp_path: Path
) -> None:
    machine = tmp_path / "homing_axis.c"
    machine.write_text(homing_axis())
    runtime = make_runtime(first_code("isr.md"), str(machine), machine_config={"q1": -2.45})
    for samples in (300, 1500, 2500):
        runtime.home()
        tick = runtime.status().tick
        wait_for(
            lambda t=tick, n=samples: runtime.status().tick > t + n or runtime.status().homed,
            runtime.status,
        )
        if runtime.status().homing:
            runtime.stop()
            wait_for(lambda: runtime.status().trip is not None, runtime.status)
            runtime.acknowledge()
    runtime.home()
    wait_for(lambda: runtime.status().homed, runtime.status)
    assert abs(counted_position(runtime) - -2.3) < 3e-3


def test_the_homing_of_the_page_trips_where_the_switch_never_closes(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], tmp_path: Path
) -> None:
    machine = tmp_path / "homing_axis.c"
    machine.write_text(homing_axis(lost=True))
    runtime = make_runtime(first_code("isr.md"), str(machine))
    runtime.home()
    wait_for(lambda: runtime.status().trip is not None, runtime.status)
    trip = runtime.status().trip
    assert trip is not None and trip.reason == "homing" and 20000 < trip.tick < 20100
    assert not runtime.status().homed


def test_every_name_of_the_header_is_on_the_page() -> None:
    header = (source_root() / "include" / "isr.h").read_text().split("/* ---- Beneath")[0]
    names = re.findall(r"^#define (\w+)", header, re.MULTILINE)
    names = [name for name in names if name != "ZENDSP_ISR_H"] + [
        "TableValue", "UserInit", "UserISR_INT2", "UserBackground",
    ]
    page = (DOCS / "isr.md").read_text()
    assert [name for name in names if name not in page] == []


def test_every_builtin_signal_is_on_the_page(make_runtime: Callable[..., Runtime]) -> None:
    runtime = make_runtime(first_code("isr.md"), machine="pendulum")
    page = (DOCS / "isr.md").read_text()
    assert [info.name for info in runtime.builtins() if f"`{info.name}`" not in page] == []
