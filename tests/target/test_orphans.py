"""Whatever the machine hangs in: no process of a target outlives it by more than a machine needs to
be made safe.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hardware import driver
from waiting import until

# hangs in open() and safe() where a file says so, and says that it does
HARDWARE = driver(
    """hang("safe"); say("is-safe");""",
    opened="""machine_config_text(config, "folder", folder, sizeof folder); hang("open");""",
    before="""
static char folder[256], path[300];
static const char *in_folder(const char *name) {
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}
static void say(const char *word) {
    FILE *f = fopen(in_folder(word), "w");
    if (f) fclose(f);
}
static void hang(const char *where) {
    if (access(in_folder(where), F_OK) != 0) return;
    say("hangs");
    for (;;) pause();
}
""",
)
PROGRAM = """
#include <unistd.h>
#include "isr.h"
static double x;
void UserInit(void) { SIGNAL(x, "", ""); }
void UserISR_INT2(void) { x += 1.0; %s }
"""
CRASH = """if (access("{}/safe", F_OK) == 0) *(volatile int *)0 = 1;"""
MONITOR = """
import pathlib, sys, time
from zendsp_target.runtime import Runtime
folder, code, hangs = pathlib.Path(sys.argv[1]), sys.argv[2], sys.argv[3:]
if "look" in hangs:
    (folder / "open").touch()
runtime = Runtime(
    str(folder / "fake.c"), clock="real", realtime=False, load_s=3600.0,
    machine_config={"folder": str(folder)},
)
if "open" in hangs:
    (folder / "open").touch()
runtime.load(runtime.compile({"user.c": code}).key)
(folder / "is-safe").unlink(missing_ok=True)
runtime.start()
if "safe" in hangs:
    (folder / "safe").touch()
print(runtime.runner_pid(), flush=True)
time.sleep(3600)
"""


Monitor = subprocess.Popen[str]


def _of(monitor: int) -> set[str]:
    """What a target started, by the folder in shared memory that its name stands in."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes()
            state = path.with_name("stat").read_text(errors="replace").rpartition(")")[2].split()[0]
        except OSError:
            continue
        if f"/zendsp-{monitor}-".encode() in words and state != "Z":
            found.add(f"{path.parent.name}: {state} {words.decode()}")
    return found


@contextmanager
def killed(folder: Path, program: str, *hangs: str, code: str = MONITOR) -> Iterator[Monitor]:
    """A target in a process of its own, killed at the end of the block; then all of it ends."""
    (folder / "fake.c").write_text(HARDWARE)
    words = [sys.executable, "-c", code, str(folder), program, *hangs]
    monitor = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        yield monitor
    finally:
        monitor.send_signal(signal.SIGKILL)
        monitor.communicate()
    try:
        until(lambda: not _of(monitor.pid), "all of it ends", lambda: _of(monitor.pid))
    finally:
        for left in _of(monitor.pid):
            os.kill(int(left.split(":")[0]), signal.SIGKILL)


def _started(monitor: Monitor) -> int:
    """Wait until the program of a target runs; returns the runner."""
    assert monitor.stdout is not None
    return int(monitor.stdout.readline())


def _stop(monitor: Monitor) -> None:
    """Returns when none of its threads runs any more: one would see the runner's death."""
    monitor.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, monitor.pid, os.WSTOPPED)


@pytest.mark.parametrize(
    ("hangs", "does"),
    [
        ([], ""),
        (["look"], ""),
        (["open"], ""),
        (["safe"], ""),
        (["safe"], CRASH),  # the process that makes it safe, beside the runner
    ],
    ids=["nowhere", "being looked at", "opening", "being made safe", "being made safe by another"],
)
def test_nothing_outlives_a_killed_target(tmp_path: Path, hangs: list[str], does: str) -> None:
    hung = tmp_path / "hangs"
    with killed(tmp_path, PROGRAM % does.format(tmp_path), *hangs) as monitor:
        if {"look", "open"} & set(hangs) or does:
            until(hung.exists, "the machine hangs", alive=monitor)
        else:
            _started(monitor)
        assert _of(monitor.pid)
    assert hung.exists() is bool(hangs), "it hung where it was to hang"


def test_a_stopped_runner_goes_on_to_make_the_machine_safe(tmp_path: Path) -> None:
    with killed(tmp_path, PROGRAM % "") as monitor:
        runner = _started(monitor)
        _stop(monitor)  # before the runner: its watchdog would end it
        os.kill(runner, signal.SIGSTOP)
    assert (tmp_path / "is-safe").exists()


STAYS = """
#include <signal.h>
#include <unistd.h>
#include "isr.h"
static pid_t target;
void UserInit(void) { target = getppid(); }
void UserISR_INT2(void) { if (getppid() != target) kill(getpid(), SIGSTOP); }
"""


@pytest.mark.parametrize("machine", ["hardware", "imi_planar"])
def test_a_program_that_stops_its_own_runner_does_not_outlive_its_target(
    tmp_path: Path, machine: str
) -> None:
    """It stops as soon as it is an orphan, whatever the runner heard then."""
    code = MONITOR
    if machine != "hardware":
        code = MONITOR.replace('str(folder / "fake.c")', repr(machine))
        code = code.replace('machine_config={"folder": str(folder)},', "")
    with killed(tmp_path, STAYS, code=code) as monitor:
        _started(monitor)
    assert (tmp_path / "is-safe").exists() is (machine == "hardware")


def test_a_target_and_a_runner_that_are_killed_at_once_leave_a_machine_that_is_safe(
    tmp_path: Path,
) -> None:
    with killed(tmp_path, PROGRAM % "") as monitor:
        runner = _started(monitor)
        _stop(monitor)
        os.kill(runner, signal.SIGKILL)
    until((tmp_path / "is-safe").exists, "the machine is safe")
