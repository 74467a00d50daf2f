"""A long-lived target: many loads and crashes leave nothing behind."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples import run
from waiting import PATIENCE_S

from zendsp_protocol.errors import AcquisitionError, Refused
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime
from zendsp_target.runtime.memory.shm import SharedFile

Make = Callable[..., Runtime]
COUNT = (
    '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'
    "void UserISR_INT2(void) { x += 1.0; }\n"
)
CRASH = COUNT.replace("x += 1.0;", "x += 1.0; if (SAMPLE_TICK == 5) *(volatile int *)8 = 1;")


def test_many_loads_and_crashes_leak_neither_files_nor_threads_nor_memory(
    make_runtime: Make, load: Callable[[Runtime, str], None], wait_for: Callable[..., None]
) -> None:
    runtime = make_runtime(COUNT)

    def life(number: int) -> None:
        load(runtime, CRASH if number % 3 == 0 else COUNT)
        runtime.acquire_configure(0, AcquireConfig(("x",), seconds=0.1))
        runtime.acquire_start(0)
        if number % 3 == 0:
            runtime.start(ticks=None)
            wait_for(lambda: runtime.status().state == "crashed")
        else:
            run(runtime, 20)

    def counted() -> tuple[int, int, int]:
        gc.collect()
        folder = Path(runtime.programs.folder.path)
        return (
            len(os.listdir("/proc/self/fd")),
            threading.active_count(),
            len(list(folder.iterdir())),
        )

    for number in range(5):
        life(number)
    before = counted()
    for number in range(30):
        life(number)
    after = counted()
    assert after[0] <= before[0] + 2
    assert after[1:] == before[1:]


def test_close_removes_every_file_thread_and_process(make_runtime: Make) -> None:
    runtime = make_runtime(COUNT)
    session = runtime.programs.session
    assert session is not None
    folder, pid = runtime.programs.folder.path, session.process.pid
    runtime.start()
    runtime.close()
    runtime.close()  # twice is once
    assert not folder.exists()
    assert not os.path.exists(f"/proc/{pid}")
    with pytest.raises(Refused):
        runtime.load("0" * 32)


def test_a_target_that_is_ended_while_it_begins_leaves_no_socket(
    tmp_path: Path, wait_for: Callable[..., None]
) -> None:
    """For example by Ctrl-C while a command starts its target."""
    tmp_path.chmod(0o700)
    words = [sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--name", "begins"]
    process = subprocess.Popen(
        words, env={**os.environ, "ZENDSP_RUNTIME_DIR": str(tmp_path)}, stdout=subprocess.DEVNULL
    )
    try:
        wait_for((tmp_path / "begins.sock").exists)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
    assert list(tmp_path.iterdir()) == []


def test_a_target_that_is_ended_before_it_is_ready_says_so_in_a_line() -> None:
    def held() -> None:  # until it can be ended by it, as `zendsp target` begins it
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})

    command = [sys.executable, "-m", "zendsp_target", "--machine", "imi_planar"]
    process = subprocess.Popen(command, stdout=-1, stderr=-1, text=True, preexec_fn=held)
    process.send_signal(signal.SIGINT)
    out, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130 and out == ""
    assert said == "zendsp target: interrupted before it was ready\n"


def test_a_target_that_nobody_reads_any_more_ends_and_leaves_nothing(tmp_path: Path) -> None:
    """Killed while its target began, a host left one that served on, and that no signal ended: what
    it had to say first found no reader, and so did its last words.
    """
    tmp_path.chmod(0o700)
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--name", "unread"]
    process = subprocess.Popen(
        words, env={**os.environ, "ZENDSP_RUNTIME_DIR": str(tmp_path)}, stdout=writer, stderr=writer
    )
    os.close(writer)
    try:
        assert process.wait(PATIENCE_S) in (1, 2)
    finally:
        process.kill()
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_is_replaced_lets_go_of_its_files_at_once(
    make_runtime: Make, load: Callable[[Runtime, str], None], wait_for: Callable[..., None]
) -> None:
    """Not when the garbage collector happens to come: until then its memory would be held too."""

    def files() -> int:
        return len(os.listdir("/proc/self/fd"))

    runtime = make_runtime(COUNT)
    gc.collect()
    gc.disable()
    try:
        before = files()
        for _ in range(3):
            load(runtime, COUNT)
            runtime.start()
            os.kill(runtime.runner_pid(), signal.SIGKILL)
            wait_for(lambda: runtime.status().state == "crashed" and runtime.status().crash)
        load(runtime, COUNT)
        wait_for(lambda: files() <= before, files)
    finally:
        gc.enable()


def test_the_speed_of_the_fast_clock_can_be_limited(make_runtime: Make) -> None:
    runtime = make_runtime(COUNT, speed=4.0)
    began = time.monotonic()
    run(runtime, 2000)
    assert time.monotonic() - began > 0.45  # 2 s of machine time at four times real time


def test_what_cannot_be_recorded_is_refused_with_the_reason(make_runtime: Make) -> None:
    runtime = make_runtime(COUNT)
    with pytest.raises(Refused, match=r"1e\+09 MB of shared memory are not free .*make room"):
        SharedFile(Path("/dev/shm/zendsp-of-this-test"), 10**15)
    for config, says in (
        (AcquireConfig(("nothing", "enc", "x[3]")), "nothing"),
        (AcquireConfig(()), "no channels"),
        (AcquireConfig(("x",), seconds=0.0), "acquire longer"),
        (AcquireConfig(("x",), seconds=1e9), "shared memory"),
        # 2.4 GB: the computer could, and would stand still for it
        (AcquireConfig(("x",), seconds=3e5), "shared memory"),
        (AcquireConfig(("x",), seconds=float("nan")), "finite"),
        (AcquireConfig(("x",), decimation=0), "decimation"),
    ):
        with pytest.raises(AcquisitionError, match=says):
            runtime.acquire_configure(0, config)
    with pytest.raises(AcquisitionError, match="not configured"):
        runtime.acquire_start(2)
    with pytest.raises(AcquisitionError, match="0 … 7"):
        runtime.acquire_configure(8, AcquireConfig(("x",)))
    assert runtime.acquire_status(5).state == "idle"


def test_recordings_survive_the_next_load(
    make_runtime: Make, load: Callable[[Runtime, str], None]
) -> None:
    runtime = make_runtime(COUNT)
    runtime.acquire_configure(0, AcquireConfig(("x",), seconds=0.05))
    runtime.acquire_start(0)
    run(runtime, 50)
    load(runtime, COUNT)
    assert np.array_equal(runtime.acquire_read(0, 0, 50)[:, 0], np.arange(1.0, 51.0))
    with pytest.raises(AcquisitionError, match="no longer loaded"):
        runtime.acquire_start(0)


def test_timing_is_counted_for_every_sample(make_runtime: Make) -> None:
    runtime = make_runtime(COUNT, clock="real")
    run(runtime, 300)
    timing = runtime.status().timing
    assert timing.ticks == 300
    assert timing.exec_histogram.sum() == timing.late_histogram.sum() == 300
    assert 0 < timing.exec_mean_ns <= timing.exec_max_ns
    highest = np.flatnonzero(timing.exec_histogram)[-1]
    assert (
        timing.histogram_edges_ns[highest]
        <= timing.exec_max_ns
        < timing.histogram_edges_ns[highest + 1]
    )
    assert (
        "SCHED_RR" in runtime.status().scheduling
        or "normal scheduling" in runtime.status().scheduling
    )


def test_acquire_stores_the_row_where_it_is_called(make_runtime: Make) -> None:
    code = """
    #include "isr.h"
    static double x;
    void UserInit(void) { SIGNAL(x, "", ""); }
    void UserISR_INT2(void) { x = 1.0; Acquire(); x = 2.0; Acquire(); x = 3.0; }
    """
    runtime = make_runtime(code)
    runtime.acquire_configure(0, AcquireConfig(("x",), seconds=0.01))
    runtime.acquire_start(0)
    run(runtime, 10)
    assert np.all(runtime.acquire_read(0, 0, 10) == 1.0)


def test_the_background_stores_no_row_in_the_middle_of_a_sample(make_runtime: Make) -> None:
    code = """
    #include "isr.h"
    #include <unistd.h>
    static double x;
    static volatile bool asked;
    void UserInit(void) { SIGNAL(x, "", ""); }
    void UserISR_INT2(void) { x = 1.0; for (asked = true; asked;) usleep(100); x = 2.0; }
    void UserBackground(void) { if (asked) Acquire(); asked = false; }
    """
    runtime = make_runtime(code, hang_s=PATIENCE_S)
    runtime.acquire_configure(0, AcquireConfig(("x",), seconds=0.01))
    runtime.acquire_start(0)
    run(runtime, 10)
    assert np.all(runtime.acquire_read(0, 0, 10) == 2.0)


def test_the_background_runs_beneath_the_loop(
    make_runtime: Make, wait_for: Callable[..., None]
) -> None:
    code = COUNT.replace("static double x;", "static double x;\nstatic int32_t rounds;").replace(
        'SIGNAL(x, "", "");', 'SIGNAL(x, "", ""); SIGNAL(rounds, "", "");'
    )
    runtime = make_runtime(code + "void UserBackground(void) { rounds++; }\n", clock="real")
    runtime.start()
    wait_for(lambda: runtime.read(["rounds"])[1]["rounds"] > 20)
    assert runtime.status().state == "running"
