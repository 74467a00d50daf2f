"""Several loops on one computer share its CPUs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from zendsp_target.runtime import Runtime, programs
from zendsp_target.runtime.process.places import Place, placed
from zendsp_target.runtime.process.settings import SPIN_US, Settings

PROGRAM = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
AWAIT_END = """
import sys
from zendsp_target.runtime.process.places import Place
print(Place(sys.argv[1]).number, flush=True)
sys.stdin.read()
"""


def test_the_loop_number_of_a_killed_process_is_free_again(tmp_path: Path) -> None:
    folder = str(tmp_path / "loops")
    first, second = Place(folder), Place(folder)
    with subprocess.Popen(
        [sys.executable, "-c", AWAIT_END, folder],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as other:  # fmt: skip
        assert other.stdout is not None
        third = int(other.stdout.readline())
        other.kill()
    assert (first.number, second.number, third) == (0, 1, 2)
    first.close()
    again, last = Place(folder), Place(folder)
    assert (again.number, last.number) == (0, 2)


def test_loops_spread_over_the_cpus_and_one_on_each_waits_awake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 3})
    settings = Settings("imi_planar", {})
    found = []
    for _ in range(3):
        place = Place(str(tmp_path))
        found.append(placed(settings, place))
        place.close()
    assert {(s.cpu, s.spin_us) for s in found} == {(3, SPIN_US)}
    held = [Place(str(tmp_path)) for _ in range(5)]
    found = [placed(settings, place) for place in held]
    assert [s.cpu for s in found] == [3, 1, 0, 3, 1]
    assert [s.spin_us for s in found] == [SPIN_US, SPIN_US, SPIN_US, 0.0, 0.0]
    chosen = placed(Settings("imi_planar", {}, cpu=0, spin_us=5.0), held[4])
    assert (chosen.cpu, chosen.spin_us) == (0, 5.0)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor cannot be chosen")
def test_two_targets_run_on_two_cpus(
    make_runtime: Callable[..., Runtime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(programs, "Place", lambda: Place(str(tmp_path)))  # without any others here
    both = [make_runtime(PROGRAM, clock="real") for _ in range(2)]
    said = [runtime.status().scheduling for runtime in both]
    if not all("on CPU" in words for words in said):
        pytest.skip("no permission to choose a processor")
    cpus = [words.partition("on CPU ")[2].partition(",")[0] for words in said]
    assert len(set(cpus)) == 2, said


HANGS_S = 3.0  # before its watchdog ends it
HANGING = """
#include "isr.h"
static double n;
void UserInit(void) {{ SIGNAL(n, "", ""); }}
void UserISR_INT2(void) {{ n += 1.0; {what} }}
void UserBackground(void) {{}}
"""


def test_a_program_that_hangs_leaves_the_other_target_its_cpu(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None]
) -> None:
    other = make_runtime(HANGING.format(what=""), clock="real", cpu=0)
    if "normal scheduling" in other.status().scheduling:
        pytest.skip("needs the right to real-time scheduling")
    other.start()
    hanging = make_runtime(
        HANGING.format(what='if (n > 100.0) for (;;) __asm__ volatile("");'),
        clock="real",
        hang_s=HANGS_S,
        cpu=0,  # the same
    )
    hanging.start()
    wait_for(lambda: hanging.status().crash != "", hanging.status)
    assert "watchdog" in hanging.status().crash
    assert other.status().crash == "" and other.status().state == "running"
    longest = 1e-9 * other.status().timing.late_max_ns
    assert longest < 0.5 * HANGS_S, "its turn comes, by slices of 0.1 s, while the other hangs"
