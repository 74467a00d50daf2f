"""User code that crashes or never returns takes down the runner only."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from crashing import CRASHING, GOOD
from helpers import children
from samples import run

from zendsp_protocol.errors import Refused, RunnerDied
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime
from zendsp_target.runtime.process.runner import RunnerProcess

# writes doubles from an array on
BEYOND = "volatile double *p = &x; for (volatile int i = 0; i < {}; i++) p[i] = 1.0;"

# more than any stack has, and never called: its first element lies in no page
LARGE = "volatile double a[1 << 24]; a[0] = 1.0;"
# past the top of the stack: an array that is written beyond, on a stack that is not used up
UPWARDS = "volatile double a[4]; static volatile double *p; for (p = a;; p++) *p = 1.0;"

TRIPPING = """
#include "isr.h"
#include <math.h>
void UserInit(void) {}
void UserISR_INT2(void) {
    if (SAMPLE_TICK == 10) WRITE_TORQUE(1, NAN);
    if (SAMPLE_TICK == 50) *(volatile int *)8 = 1;
}
"""

Make = Callable[..., Runtime]
Wait = Callable[..., None]


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ("*nowhere = 1;", "SIGSEGV in UserISR_INT2"),
        ("when = when / zero;", "SIGFPE in UserISR_INT2"),
        ("abort();", "SIGABRT in UserISR_INT2"),
        ("deeper(NULL);", "SIGSEGV in UserISR_INT2 at user.c:"),
        (LARGE, "SIGSEGV in UserISR_INT2 at user.c:"),
        ("exit(3);", "status 3 in UserISR_INT2"),
        ("__builtin_trap();", "SIGILL in UserISR_INT2"),
        (BEYOND.format(100000000), "SIGSEGV in UserISR_INT2"),
        (BEYOND.format(600), "SIGSEGV in UserISR_INT2"),  # into the page behind
        (UPWARDS, "SIGSEGV in UserISR_INT2"),
    ],
)
def test_a_crash_is_told_with_signal_and_last_sample_and_loses_nothing(
    make_runtime: Make, wait_for: Wait, load: Callable[[Runtime, str], None], how: str, says: str
) -> None:
    runtime = make_runtime(CRASHING.format(how=how))
    runtime.acquire_configure(0, AcquireConfig(("tick", "x"), seconds=1.0))
    runtime.acquire_start(0)
    runtime.wait_applied(runtime.write({"gain": 2.0}, "me"), 10.0)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    status = runtime.status()
    assert status.state == "crashed"
    assert says in status.crash
    assert ("stack is used up" in status.crash) == (how in ("deeper(NULL);", LARGE))
    assert ("by zero" in status.crash) == ("SIGFPE" in says or "SIGILL" in says)
    assert "last sample 49" in status.crash
    kept = runtime.acquire_status(0)
    assert (kept.state, kept.count) == ("done", 50)
    assert np.array_equal(runtime.acquire_read(0, 0, 100)[:, 1], np.arange(50.0))
    assert [c.name for c in runtime.log()] == ["gain"]
    with pytest.raises(RunnerDied, match="load the program again"):
        runtime.write({"gain": 3.0}, "me")
    load(runtime, GOOD)
    run(runtime, 10)
    assert runtime.read(["x"])[1]["x"] == 10.0
    assert runtime.acquire_read(0, 0, 100).shape == (50, 2)


def test_outputs_that_a_program_wrote_before_it_crashed_are_not_told_as_acting(
    make_runtime: Make, wait_for: Wait
) -> None:
    """`status` and the drive panel went on saying 4.08 mV, of a machine that was safe."""
    text = CRASHING.format(how="*nowhere = 1;")
    assert text.count("void UserISR_INT2(void) {") == 1
    runtime = make_runtime(
        text.replace("UserISR_INT2(void) {", "UserISR_INT2(void) { WRITE_TORQUE(0, 0.1);")
    )
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    said = runtime.status().io
    assert "enc" in said, "what was measured last is told"
    assert "aout" not in said and "dout" not in said


def acknowledged(runtime: Runtime, load: Callable[[Runtime, str], None]) -> None:
    """Nothing is loaded before somebody acknowledges; then all works."""
    with pytest.raises(Refused, match="acknowledge it first"):
        load(runtime, GOOD)
    runtime.acknowledge()
    assert runtime.status().trip is None
    load(runtime, GOOD)
    run(runtime, 3)
    assert (runtime.status().tick, runtime.status().trip) == (3, None)


def test_a_stop_after_a_crash_is_latched(
    make_runtime: Make, wait_for: Wait, load: Callable[[Runtime, str], None]
) -> None:
    runtime = make_runtime(CRASHING.format(how="*nowhere = 1;"))
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert runtime.status().trip is None
    runtime.stop()
    trip = runtime.status().trip
    assert trip is not None and (trip.reason, trip.tick) == ("stop", 50)
    acknowledged(runtime, load)


@pytest.mark.parametrize("end", ["crash", "unload"])
def test_a_trip_outlives_its_loop(
    make_runtime: Make, wait_for: Wait, load: Callable[[Runtime, str], None], end: str
) -> None:
    runtime = make_runtime(TRIPPING)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    if end == "unload":
        runtime.unload()
    trip = runtime.status().trip
    assert trip is not None and (trip.reason, trip.tick) == ("nan", 10)
    acknowledged(runtime, load)


@pytest.mark.parametrize("reason", ["stop", "host lost"])
def test_what_a_loop_was_asked_and_never_took_stands_after_its_end(
    make_runtime: Make, wait_for: Wait, load: Callable[[Runtime, str], None], reason: str
) -> None:
    runtime = make_runtime(CRASHING.format(how="for (;;) { zero = 0; }"), hang_s=0.4)
    runtime.start()
    wait_for(lambda: runtime.status().tick == 50, runtime.status)
    runtime.trip(reason)
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    trip = runtime.status().trip
    assert trip is not None and (trip.reason, trip.tick) == (reason, 50)
    acknowledged(runtime, load)


def test_a_crash_names_the_line_of_the_source(make_runtime: Make, wait_for: Wait) -> None:
    runtime = make_runtime(CRASHING.format(how="*nowhere = 1;"))
    runtime.start()
    wait_for(lambda: runtime.status().crash != "")
    assert "at user.c:12" in runtime.status().crash


@pytest.mark.parametrize("clock", ["fast", "real"])
def test_a_sample_that_never_returns_is_ended_by_the_watchdog(
    make_runtime: Make, wait_for: Wait, load: Callable[[Runtime, str], None], clock: str
) -> None:
    """The line was told of crashes only."""
    runtime = make_runtime(CRASHING.format(how="for (;;) { zero = 0; }"), clock=clock, hang_s=0.4)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert "no return within 0.4 s in UserISR_INT2 at user.c:12: ended" in runtime.status().crash
    assert "last sample 49" in runtime.status().crash
    load(runtime, GOOD)
    run(runtime, 3)
    assert runtime.status().tick == 3


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ("*nowhere = 1;", "SIGSEGV in UserBackground"),
        (LARGE, "UserBackground at user.c:7 (the stack is used up: "),
        ("pthread_exit(NULL);", "SIGABRT in UserBackground (abort(), a failed assertion, or a"),
        ("pthread_cancel(pthread_self()); pthread_testcancel();", "SIGABRT in UserBackground"),
    ],
)
def test_a_crash_in_the_background_is_told_as_such(
    make_runtime: Make, wait_for: Wait, how: str, says: str
) -> None:
    code = "#include <pthread.h>\n" + GOOD
    runtime = make_runtime(f"{code}static int *nowhere; void UserBackground(void) {{ {how} }}")
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert says in runtime.status().crash


@pytest.mark.parametrize(
    ("init", "error", "says"),
    [
        ("*(volatile int *)8 = 1;", RunnerDied, "SIGSEGV in UserInit"),
        (
            "for (volatile int i = 0;;) i = 0;", RunnerDied,
            "did not return within 0.5 s in UserInit",
        ),
        ('SIGNAL(x, "", ""); SIGNAL(x, "", "");', Refused, "'x': declared twice"),
        ('static double t; SIGNAL(t, "", "");', Refused, "taken by a built-in"),
        ('static double k[3][0]; SIGNAL(k, "", "");', Refused, "'k': it has no element"),
        (
            'PARAMETER(x, 5.0, "", 0.0, 1.0, "");', Refused,
            "'x': initial value 5 is outside its limits 0 and 1: change one of them in UserInit",
        ),
        (
            'PARAMETER(x, 0.0, "", 2.5, -1.0, "");', Refused,
            "'x': its limits are 2.5 and -1: the first must not be above the second",
        ),
        *(
            (f'static {given}', Refused, f"'k': {why}")
            for given, why in {
                'const double k = 4; PARAMETER(k, 4.0, "", 0, 9, "");': "it is const, so nobody",
                'const int32_t k[2] = {1, 2}; PARAMETER_ARRAY(k, "", 0, 9, "");': "it is const",
                'const table k; TABLE(k, 10, 2, "", "");': "it is const, so nobody could write",
                'double k; PARAMETER(k, INFINITY, "", 0, NO_MAX, "");':
                    "initial value inf is no finite number",
                'double k[2] = {0, NAN}; PARAMETER_ARRAY(k, "", NO_MIN, NO_MAX, "");':
                    "initial value -?nan of element 1 is no finite number",
                'double k[2] = {1, 12}; PARAMETER_ARRAY(k, "", 0, 9, "");':
                    "initial value 12 of element 1 is outside its limits 0 and 9",
                'int32_t k; PARAMETER(k, 1.5, "", 0, 9, "");':
                    "initial value 1.5 is not a 32-bit integer: declare it double",
                'int32_t k; PARAMETER(k, 1e300, "", 0, NO_MAX, "");':
                    r"initial value 1e\+300 is not a 32-bit integer",
                'bool k; PARAMETER(k, 2, "", 0, 9, "");': "initial value 2 is neither true nor",
                'float k; PARAMETER(k, 1e39, "", 0, NO_MAX, "");':
                    r"initial value 1e\+39 exceeds the range of float",
            }.items()
        ),
        (
            "".join(f'static double v{k}; SIGNAL(v{k}, "", "");' for k in range(1100)),
            Refused,
            "'v1003': one too many: a program has at most 1003 variables; declare arrays",
        ),
    ],
)
def test_an_error_in_UserInit_is_reported_at_load(
    init: str, error: type[Exception], says: str
) -> None:
    code = (
        '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { x = 0; '
        + init
        + " }\nvoid UserISR_INT2(void) {}\n"
    )
    with Runtime("imi_planar", clock="fast", load_s=0.5) as runtime:
        result = runtime.compile({"user.c": code})
        assert result.ok, result.diagnostics
        with pytest.raises(error, match=says):
            runtime.load(result.key)
        assert runtime.status().state == "empty"


ORPHAN = """
import sys, time
from zendsp_target.runtime import Runtime
runtime = Runtime("imi_planar", clock="real", hang_s=60.0)
runtime.load(runtime.compile({"user.c": sys.argv[1]}).key)
runtime.start()
print(runtime.programs.session.process.pid, runtime.programs.folder.path, flush=True)
time.sleep(600)
"""


def test_a_program_that_hangs_is_ended_before_anything_is_asked_about_its_end(
    make_runtime: Make, wait_for: Wait, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked_of_the_living = []

    def status(process: RunnerProcess) -> None:  # which waits two seconds for an end
        asked_of_the_living.append(process.alive())

    monkeypatch.setattr(RunnerProcess, "_status", status)
    runtime = make_runtime(CRASHING.format(how="for (;;) { zero = 0; }"), hang_s=0.2)
    runtime.start()
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert True not in asked_of_the_living


def test_a_loop_without_processor_time_is_not_taken_for_a_hanging_program(
    make_runtime: Make, wait_for: Wait, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = []

    def waits(pid: int) -> tuple[bool, float]:  # as on a busy computer
        rounds.append(pid)
        return True, 1.0

    runtime = make_runtime(CRASHING.format(how="for (;;) { zero = 0; }"), hang_s=0.2)
    with monkeypatch.context() as busy:
        busy.setattr("zendsp_target.runtime.process.supervise.processor", waits)
        runtime.start()
        wait_for(lambda: len(rounds) > 20 or runtime.status().crash != "", runtime.status)
        assert runtime.status().crash == ""
    wait_for(lambda: "ended by the watchdog" in runtime.status().crash, runtime.status)


def test_a_runner_that_survives_SIGKILL_is_reported(
    make_runtime: Make, wait_for: Wait, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = make_runtime(CRASHING.format(how="for (;;) { zero = 0; }"), hang_s=0.2)
    pid = runtime.runner_pid()
    with monkeypatch.context() as driver:  # as in a call that the kernel does not interrupt
        driver.setattr("zendsp_target.runtime.process.runner.KILLED_S", 0.1)
        driver.setattr(subprocess.Popen, "send_signal", lambda *_: None)
        driver.setattr(os, "killpg", lambda *_: None)
        runtime.start()
        wait_for(lambda: runtime.status().crash != "", runtime.status)
        assert runtime.status().state == "crashed" and runtime.runner_pid() == 0
    os.kill(pid, signal.SIGKILL)


def test_a_runner_stopped_by_SIGSTOP_is_reported_as_such(
    make_runtime: Make, wait_for: Wait
) -> None:
    runtime = make_runtime(GOOD, clock="real", realtime=False, hang_s=0.3)
    runtime.start()
    os.kill(runtime.runner_pid(), signal.SIGSTOP)
    wait_for(lambda: runtime.status().crash != "", runtime.status)
    assert "the runner was stopped from outside (SIGSTOP" in runtime.status().crash


def _words(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


@pytest.mark.parametrize(
    "code", [GOOD, GOOD.replace("x += 1.0;", "for (;;) x += 1.0;")], ids=["well", "hung"]
)
def test_a_killed_monitor_leaves_no_runner_and_no_shared_memory(wait_for: Wait, code: str) -> None:
    monitor = subprocess.Popen(
        [sys.executable, "-c", ORPHAN, code], stdout=subprocess.PIPE, text=True
    )
    try:
        assert monitor.stdout is not None
        runner, folder = monitor.stdout.readline().split()
        # not later: any target that starts on this computer clears up after dead ones
        assert os.path.isdir(folder)
        safe = next(pid for pid in children(monitor.pid) if b"--safe" in _words(pid))
    finally:
        monitor.send_signal(signal.SIGKILL)
        monitor.wait()
        if monitor.stdout is not None:
            monitor.stdout.close()
    os.kill(safe, signal.SIGKILL)  # which would end the runner too, after a while

    def gone() -> bool:
        try:
            with open(f"/proc/{runner}/stat") as file:
                return file.read().rsplit(")", 1)[1].split()[0] == "Z"
        except OSError:
            return True

    wait_for(gone)
    Runtime("imi_planar").close()  # the next target clears up after the dead one
    wait_for(lambda: not os.path.exists(folder))  # or another one, which has just begun to


RUDE = r"""
#include <stdio.h>
#include "isr.h"
void UserInit(void) {
    puts("\x1b[2Jnowhere");
    fputs("\x1b]0;owned\a\r\xff gain\nsecond", stderr);
    for (int i = 0; i < 4000; i++) fputs("a program that nobody listens to goes on\n", stderr);
}
void UserISR_INT2(void) {}
"""


def test_what_user_code_prints_is_no_command_to_a_terminal(
    make_runtime: Make,
    wait_for: Wait,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # not read from `capfd` while the program prints: what comes as it is read would be lost
    told = io.StringIO()
    monkeypatch.setattr(sys, "stderr", told)
    make_runtime(RUDE)
    wait_for(lambda: "program: seconda program that" in told.getvalue(), told.getvalue)
    assert r"program: \x1b]0;owned\x07\r\xff gain" in told.getvalue()
    said = "".join([told.getvalue(), *capfd.readouterr()])
    assert "\x1b" not in said and "\a" not in said and "nowhere" not in said
