"""Which threads of a runner are urgent: the loop alone."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable

import pytest
from attempts import attempting
from samples import run

from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]


@pytest.fixture
def mark() -> str:
    """The seconds that a process would sleep that got away; no other has this number."""
    return f"{300 + time.time_ns() % 1_000_000_000 / 1e9:.9f}"


MOST = "const struct sched_param p = {99};"
URGENT = {
    "scheduling": f"{MOST} return sched_setscheduler(0, SCHED_FIFO, &p);",
    "parameter": f"{MOST} return sched_setparam(0, &p);",
    "attributes": (
        "unsigned long a[6] = {48 | 5ul << 32}; return syscall(SYS_sched_setattr, 0, a, 0);"
    ),
    "processors": (
        "const unsigned long first = 1; return sched_setaffinity(0, 8, (cpu_set_t *)&first);"
    ),
    "priority": "return setpriority(PRIO_PROCESS, 0, -20);",
}


@pytest.mark.parametrize("where", ["constructor", "init", "isr"])
@pytest.mark.parametrize("way", list(URGENT))
def test_user_code_makes_itself_no_more_urgent(
    make_runtime: Make, way: str, where: str, mark: str
) -> None:
    """A hanging program of the highest priority had blocked the links of all targets."""
    runtime = make_runtime(attempting(URGENT[way], mark, where))
    run(runtime, 3)
    assert runtime.read(["answer", "refused"])[1] == {"answer": -1.0, "refused": 1.0}


@pytest.mark.parametrize("where", ["constructor", "init", "isr"])
def test_user_code_makes_no_thread_beside_it_more_urgent(
    make_runtime: Make, where: str, mark: str
) -> None:
    """By a signal, whose handler runs in that thread."""
    program = attempting(
        "signal(SIGUSR1, climb); long sent = 0; const long own = syscall(SYS_gettid);"
        " for (long t = own; t < own + 100; t++)"
        " if (t != own && syscall(SYS_tgkill, getpid(), t, SIGUSR1) == 0) sent++;"
        " usleep(100000); return sent;",
        mark, where,
    ).replace(
        "static inline long attempt", f"static void climb(int n) {{ {MOST} (void)n;"
        " sched_setscheduler(0, SCHED_FIFO, &p); }\nstatic inline long attempt",
    )
    runtime = make_runtime(program)
    run(runtime, 3)
    assert runtime.read(["answer"])[1]["answer"] >= 1.0, "the service at least"
    threads = [int(t) for t in os.listdir(f"/proc/{runtime.runner_pid()}/task")]
    assert {os.sched_getscheduler(t) for t in threads} == {os.SCHED_OTHER}


def test_the_loop_alone_is_urgent_and_background_steps_back(make_runtime: Make, mark: str) -> None:
    program = attempting("return 0;", mark, "init") + "void UserBackground(void) {}\n"
    runtime = make_runtime(program, clock="real", realtime=True)
    pid = runtime.runner_pid()
    threads = {int(t) for t in os.listdir(f"/proc/{pid}/task")} - {pid}
    assert {os.sched_getscheduler(t) for t in threads} == {os.SCHED_OTHER}
    nice = sorted(os.getpriority(os.PRIO_PROCESS, t) for t in threads)
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert nice == [own, min(own + 10, 19)], "service, background"
    said = runtime.status().scheduling
    if _may_be_urgent():
        assert os.sched_getscheduler(pid) == os.SCHED_RR | os.SCHED_RESET_ON_FORK
        assert said.startswith("SCHED_RR 80")
    else:
        assert said.startswith("normal scheduling (SCHED_RR refused: Operation not permitted)")


def _may_be_urgent() -> bool:
    """Whether this user may have a process run before others."""
    with subprocess.Popen(["sleep", "300"]) as other:
        try:
            os.sched_setscheduler(other.pid, os.SCHED_RR, os.sched_param(80))
        except PermissionError:
            return False
        finally:
            other.kill()
    return True
