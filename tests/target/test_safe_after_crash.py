"""Hardware is made safe when its program or its monitor is gone."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from crashing import CRASHING, GOOD
from hardware import driver

from zendsp_protocol.errors import Refused
from zendsp_target.runtime import Runtime
from zendsp_target.runtime.variables.flights import Flights

Make = Callable[..., Runtime]
Wait = Callable[..., None]

SAID = """FILE *f = fopen(path, "a"); if (f) { fputs("safe\\n", f); fclose(f); }"""
PATH = """machine_config_text(config, "path", path, sizeof path);"""
HARDWARE = driver(SAID, opened=PATH, before="static char path[256];")
# as a card that another program has taken meanwhile: it does not open while the file is there
ONCE = driver(
    SAID, opened=PATH + "if (access(path, F_OK) == 0) return 1;", before="static char path[256];"
)


def crashing_on(hardware: str, make_runtime: Make, folder: Path) -> tuple[Runtime, Path]:
    """A program that will crash on a driver for hardware, and the file that the driver writes."""
    source, said = folder / "fake.c", folder / "said"
    source.write_text(hardware)
    runtime = make_runtime(
        CRASHING.format(how="*nowhere = 1;"), machine=str(source), clock="real",
        machine_config={"path": str(said)},
    )
    return runtime, said


@pytest.mark.parametrize("files", [True, False], ids=["usual", "no file can be opened any more"])
def test_hardware_is_made_safe_by_a_fresh_process_after_a_crash(
    make_runtime: Make, wait_for: Wait, tmp_path: Path, files: bool
) -> None:
    """Strangers that connect again and again take a target's files; so does a full computer."""
    runtime, said = crashing_on(HARDWARE, make_runtime, tmp_path)
    assert not runtime.machine().simulated
    wait_for(said.exists)  # paused hardware is safe from the start
    said.unlink()
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        if not files:
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, most[1]))
            with pytest.raises(OSError, match="Too many open files"):
                os.dup(0)
        runtime.start()
        wait_for(lambda: runtime.status().crash != "", runtime.status)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, most)
    assert "SIGSEGV" in runtime.status().crash
    assert said.read_text() == "safe\n"


def test_where_the_process_that_waits_to_make_the_machine_safe_is_ended_another_waits(
    make_runtime: Make, wait_for: Wait, tmp_path: Path
) -> None:
    """As by a system without memory, which ends whom it likes."""
    runtime, said = crashing_on(HARDWARE, make_runtime, tmp_path)
    wait_for(said.exists)
    said.unlink()

    def waiting() -> list[int]:
        mine = subprocess.run(
            ["pgrep", "-P", str(os.getpid()), "-f", "--", "-safe$"], capture_output=True, text=True,
            check=False,
        )
        return [int(pid) for pid in mine.stdout.split()]

    (first,) = waiting()
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: waiting() not in ([], [first]), waiting)
    assert runtime.status().crash == "", "the program goes on"
    assert not said.exists()
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert said.read_text() == "safe\n"


def test_hardware_is_made_safe_although_its_monitor_ran_out_of_memory(
    make_runtime: Make, wait_for: Wait, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime, said = crashing_on(HARDWARE, make_runtime, tmp_path)
    wait_for(said.exists)
    said.unlink()
    failed: list[int] = []

    def harvest(flights: Flights) -> None:
        failed.append(1)
        raise MemoryError

    monkeypatch.setattr(Flights, "harvest", harvest)
    wait_for(lambda: len(failed) > 2)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert said.read_text() == "safe\n"


def test_a_machine_that_cannot_be_made_safe_is_told(
    make_runtime: Make, wait_for: Wait, tmp_path: Path
) -> None:
    runtime, said = crashing_on(ONCE, make_runtime, tmp_path)
    wait_for(said.exists)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert "SIGSEGV" in runtime.status().crash
    assert "NOT SAFE: use the machine's emergency stop" in runtime.status().crash
    runtime.close()
    assert runtime.unsafe and runtime.farewell.startswith(": the machine is NOT SAFE")


def test_the_fast_clock_refuses_hardware(tmp_path: Path) -> None:
    source = tmp_path / "fake.c"
    source.write_text(HARDWARE)
    with Runtime(
        str(source), clock="fast", machine_config={"path": str(tmp_path / "said")}
    ) as runtime:
        result = runtime.compile({"user.c": GOOD})
        with pytest.raises(Refused, match="fast clock needs a simulated machine") as said:
            runtime.load(result.key)
    assert "NOT SAFE" not in str(said.value), "it is made safe all the same"
