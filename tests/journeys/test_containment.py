"""Programs that try to stay, or to take what is not theirs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from journey import Installed, until

ESCAPE = """
#include "isr.h"
#include <stdlib.h>
#include <unistd.h>
static double tries, got_away;
static void stay(void) {
    tries += 1.0;
    const pid_t child = fork();
    if (child == 0) {
        setsid();
        if (fork() != 0) _exit(0);
        execlp("sleep", "sleep", "%(mark)s", (char *)0);
        _exit(0);
    }
    if (child > 0) got_away += 1.0;
    if (system("setsid sleep %(mark)s &") == 0) got_away += 1.0;
}
__attribute__((constructor)) static void early(void) { stay(); }
void UserInit(void) { SIGNAL(tries, "", ""); SIGNAL(got_away, "", ""); stay(); }
void UserISR_INT2(void) { if (tries < 50.0) stay(); }
"""

BOMB = """
#include "isr.h"
#include "/proc/self/environ"
#define A(x) x x x x x x x x x x
double y[] = { A(A(A(A(A(A(A(A(A(1.0,))))))))) };
void UserInit(void) {}
void UserISR_INT2(void) {}
"""


def _with(word: str) -> list[int]:
    """Processes that have the word in their command line, whole."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if word.encode() in path.read_bytes().split(b"\0"):
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def _children(pid: int) -> list[int]:
    try:
        tasks = Path(f"/proc/{pid}/task").glob("*/children")
        return [int(word) for path in tasks for word in path.read_text().split()]
    except OSError:
        return []


def test_nothing_that_a_program_tries_to_start_is_there_after_a_reload_or_a_killed_target(
    installed: Installed,
) -> None:
    mark = f"{400 + time.time_ns() % 1_000_000_000 / 1e9:.9f}"
    target = installed.target("imi")
    path = installed.write("escape.c", ESCAPE % {"mark": mark})
    done = installed.run("run", "-t", "imi", str(path))
    assert done.returncode == 0, done.stdout + done.stderr
    until(lambda: "50" in installed.run("get", "-t", "imi", "tries").stdout, "fifty tries")
    assert " 0" in installed.run("get", "-t", "imi", "got_away").stdout
    assert _with(mark) == []
    runners = _children(target.pid)
    assert runners
    os.kill(target.pid, signal.SIGKILL)
    until(
        lambda: not any(Path(f"/proc/{pid}").exists() for pid in runners),
        "the runner has ended with its target",
    )
    assert _with(mark) == []


def test_a_compile_bomb_is_an_answer_and_the_target_goes_on(installed: Installed) -> None:
    installed.target("imi")
    path = installed.write("bomb_7113.c", BOMB)
    done = installed.run("compile", "-t", "imi", str(path))
    assert done.returncode != 0
    assert "HOME=" not in done.stdout + done.stderr, "what the target was started with is not shown"
    assert _with("bomb_7113.c") == []
    assert installed.run("info", "-t", "imi").returncode == 0
