"""What docs/isr.md and docs/machines.md print is true: the code in them compiles, runs, and does what it says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from zendsp_isr.build import source_root
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

DOCS = Path(__file__).parents[2] / "docs"


def first_code(page: str) -> str:
    """First C block of a page."""
    match = re.search(r"```c\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    assert match is not None
    return match[1]


def test_the_program_of_the_page_controls_the_machine_of_the_page(make_runtime: Callable[..., Runtime], tmp_path: Path) -> None:
    machine = tmp_path / "my_axis.c"
    machine.write_text(first_code("machines.md"))
    runtime = make_runtime(first_code("isr.md"), machine=str(machine), machine_config={"q1": 0.5})
    runtime.wait_applied(runtime.write({"Kp": 1.0}, "me"), 10.0)
    runtime.acquire_configure(0, AcquireConfig(("q", "tau", "cmd", "aout"), seconds=2.0))
    runtime.acquire_start(0)
    runtime.start(ticks=2000)
    runtime.wait_paused()
    rows = runtime.acquire_read(0, 0, 2000)
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
    wait_for(lambda: runtime.status().tick > 0 and runtime.status().state == "loaded", runtime.status)
    assert runtime.status().homed


def test_every_name_of_the_header_is_on_the_page() -> None:
    header = (source_root() / "include" / "isr.h").read_text().split("/* ---- Beneath")[0]
    names = re.findall(r"^#define (\w+)", header, re.MULTILINE)
    names = [name for name in names if name != "ZENDSP_ISR_H"] + ["TableValue", "UserInit", "UserISR_INT2", "UserBackground"]
    page = (DOCS / "isr.md").read_text()
    assert [name for name in names if name not in page] == []


def test_every_builtin_signal_is_on_the_page(make_runtime: Callable[..., Runtime]) -> None:
    runtime = make_runtime(first_code("isr.md"), machine="pendulum")
    page = (DOCS / "isr.md").read_text()
    assert [info.name for info in runtime.builtins() if f"`{info.name}`" not in page] == []
