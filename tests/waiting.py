"""How long a test waits for what must come.

CI runs what waits beside what computes, on two slow processors. So a test waits for a condition,
with one patience for all: it only says when to give up on something that will never come. A promise
of a time is shown by what would come otherwise much later (a request that is given minutes, a load
that does not end), and is measured by `benchmarks/`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

PATIENCE_S = float(os.environ.get("ZENDSP_TEST_PATIENCE_S", "150"))


def until(
    done: Callable[[], object],
    what: str,
    shown: Callable[[], object] = str,
    alive: subprocess.Popen[str] | None = None,
) -> None:
    """Wait until `done`; fail by name, with what is `shown`, when it does not come.

    Also fails as soon as the process that is to bring it is no longer `alive`.
    """
    deadline, pause = time.monotonic() + PATIENCE_S, 0.005
    while not done():
        if alive is not None and alive.poll() is not None:
            said = alive.stdout.read() if alive.stdout else ""
            raise AssertionError(f"{what}: the process ended with {alive.returncode}: {said}")
        if time.monotonic() > deadline:
            raise AssertionError(f"never happened within {PATIENCE_S:g} s: {what} {shown()}")
        time.sleep(pause)
        pause = min(1.2 * pause, 0.025)  # what takes long is asked less often: asking computes


def freeze(pid: int) -> None:
    """Stop a process as SIGSTOP does, and wait until every thread of it has: on a busy computer
    some go on for a while.
    """
    os.kill(pid, signal.SIGSTOP)
    tasks = Path(f"/proc/{pid}/task")
    until(lambda: all(_state(task) in "Tt" for task in tasks.iterdir()), "it is frozen")


def _state(task: Path) -> str:
    return (task / "stat").read_text().rpartition(")")[2].split()[0]


def status_of(returncode: int | None) -> int:
    """The exit status as a shell has it: 128 and the signal that ended the process."""
    assert returncode is not None, "it runs"
    return returncode if returncode >= 0 else 128 - returncode
