"""Processes that freeze for a while and go on, as in a paused container or a swapping computer."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from helpers import children, kill, python
from waiting import PATIENCE_S, freeze, until

from zendsp.here.stop_page import find
from zendsp.link import Target

HOST = """
import sys, time, zendsp
target = zendsp.connect(sys.argv[1])
{does}
target.start({how})
print("moves", flush=True)
time.sleep(999)
"""
WORD = 3  # of the stop page: trips
LATE_S = 1.6  # more than the lease of 1 s, less than the 3 s after which the loop stops by itself


def _trips(target: Target) -> Callable[[], int]:
    """How often the loop has tripped, read from shared memory past the monitor."""
    page = find(target.name)
    assert page is not None
    words = page._words.cast("B").cast("I")
    return lambda: int(words[WORD])


@pytest.fixture
def stands(start: Callable[..., Target]) -> Target:
    """A target with a program that stands still."""
    target = start(clock="real", options=["--no-realtime"])
    target.download("pd.c")
    return target


def test_a_host_that_is_alive_is_not_lost_where_a_busy_target_answers_late(
    stands: Target,
) -> None:
    """The host gives the link up after a second without a word, and connects anew. The machine had
    stopped: "the host that commanded the motion is gone".
    """
    stands.take_command()
    stands.start()
    freeze(stands.info.pid)
    time.sleep(LATE_S)
    os.kill(stands.info.pid, signal.SIGCONT)
    until(lambda: stands.alive, "the link is back")
    tick = stands.status().tick
    until(lambda: stands.status().tick > tick + 2500, "it is seen whether the host is lost")
    assert stands.status().trip is None
    assert stands.drive_status().commander == stands.link.author


@pytest.mark.parametrize(
    ("does", "how"),
    [("target.take_command()", ""), ("", "attended=True")],
    ids=["commands", "attends"],
)
@pytest.mark.parametrize("dies", [True, False], ids=["host dies", "host lives"])
def test_a_machine_stops_where_nobody_can_see_that_its_host_is_lost(
    stands: Target, does: str, how: str, dies: bool
) -> None:
    host = python(HOST.format(does=does, how=how), stands.name)
    assert host.stdout is not None and host.stdout.readline() == "moves\n"
    until(lambda: stands.drive_status().moved_by or stands.drive_status().commander, "it is known")
    time.sleep(0.3)  # until the loop is told, ten times a second
    trips = _trips(stands)
    before = trips()
    freeze(stands.info.pid)
    try:
        if dies:
            kill(host)
        until(lambda: trips() > before, "the loop stops the machine by itself")
    finally:
        os.kill(stands.info.pid, signal.SIGCONT)
    until(lambda: stands.alive and stands.status().trip is not None, "it is told")
    trip = stands.status().trip
    assert trip is not None and trip.reason == "host lost"
    assert "the target's monitor stood still" in trip.text
    kill(host)


@pytest.mark.parametrize(
    ("does", "how"),
    [("", ""), ("target.take_command(); target.set_host_lost('finish')", "")],
    ids=["nobody commands", "finish"],
)
def test_a_machine_that_may_move_on_without_its_host_does(
    stands: Target, does: str, how: str
) -> None:
    host = python(HOST.format(does=does, how=how), stands.name)
    assert host.stdout is not None and host.stdout.readline() == "moves\n"
    time.sleep(0.3)
    trips = _trips(stands)
    before = trips()
    freeze(stands.info.pid)
    kill(host)
    try:
        time.sleep(4.5)  # half as long again as the loop bears
        assert trips() == before
    finally:
        os.kill(stands.info.pid, signal.SIGCONT)
    until(lambda: stands.alive, "the link is back")
    assert stands.status().trip is None


def _loop(target: Target) -> int:
    """The runner of a target, which has one other child: the process that makes the machine safe.
    """
    (runner,) = (
        pid
        for pid in children(target.info.pid)
        if b"--safe" not in Path(f"/proc/{pid}/cmdline").read_bytes()
    )
    return runner


@pytest.fixture
def frozen(stands: Target) -> Iterator[Callable[[float], None]]:
    """Freeze the target, its loop and the loop's watchdog for some seconds, as a container is
    frozen.
    """
    pids = [stands.info.pid, _loop(stands)]

    def stand(seconds: float) -> None:
        for pid in pids:
            freeze(pid)
        time.sleep(seconds)
        for pid in reversed(pids):
            os.kill(pid, signal.SIGCONT)

    yield stand
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def test_a_recording_reports_the_samples_that_a_frozen_loop_skipped(
    stands: Target, frozen: Callable[[float], None]
) -> None:
    stands.start()
    stands.acquire_configure(["tick"], seconds=6.0)
    stands.acquire_start()
    until(lambda: stands.acquire_status().count > 200, "rows")
    frozen(2.5)
    found = stands.acquire_finish(PATIENCE_S)
    tick = found["tick"]
    assert stands.status().trip is None, "a simulated machine has waited"
    assert (tick[1:] - tick[:-1]).max() > 2400.0
    assert found.lost >= 2400
