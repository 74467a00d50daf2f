"""kill -9 of the host that commands, of the runner, and of the monitor."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator

import zendsp
from hardships.place import Place, Tally, alive, children, runner_of, until
from zendsp.errors import ZendspError
from zendsp.link import Target

PROMISE = (
    "whoever is killed: the machine stops, what was recorded is kept, nothing is left, and work"
    " goes on"
)
KEPT = 3  # killed targets of which recorded rows may be left in shared memory, to be saved
GONE_S = 5.0  # in which a runner without its monitor is gone, on a busy computer
HOST = """
import sys, time, zendsp
t = zendsp.connect("killed")
t.take_command(); t.start()
view = t.live(["q"], callback=lambda block: None)
while not view.received: time.sleep(0.01)
print("moves", flush=True)
time.sleep(600)
"""


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    target = place.local("killed")
    dead: list[int] = []
    try:
        while True:
            if target.status().state == "empty":
                target.download("pd.c")
            _kill_host(place, target, tally)
            _kill_runner(target, tally)
            dead.append(target.info.pid)
            target = _kill_monitor(place, target, tally)
            dead = [pid for pid in dead if place.shared(pid)]
            tally.expect(
                len(dead) <= KEPT,
                f"shared memory of {len(dead)} killed targets is left after the next start",
            )
            yield
    finally:
        target.close()
        for folder in [folder for pid in dead for folder in place.shared(pid)]:
            shutil.rmtree(folder, ignore_errors=True)


def _kill_host(place: Place, target: Target, tally: Tally) -> None:
    host = place.script(HOST)
    try:
        assert host.stdout is not None
        if not tally.expect(
            host.stdout.readline() == "moves\n", "a host did not get its target to move"
        ):
            return
    finally:
        host.kill()
        host.wait()
    tally.count("hosts killed")

    def lost() -> bool:
        trip = target.status().trip
        return trip is not None and trip.reason == "host lost"

    tally.expect(until(lost), "the commanding host was killed, and its policy did not act")
    tally.expect(until(lambda: len(target.status().hosts) == 1), "the killed host is still listed")
    target.drive_auto()
    target.acknowledge()


def _kill_runner(target: Target, tally: Tally) -> None:
    target.acquire_configure(["q", "tau"], seconds=60.0)
    target.acquire_start()
    target.start()
    tally.expect(until(lambda: target.acquire_status().count > 100), "no rows are recorded")
    os.kill(runner_of(target.info.pid), signal.SIGKILL)
    tally.count("runners killed")
    if not tally.expect(
        until(lambda: target.status().state == "crashed"),
        "the runner was killed, and nobody was told",
    ):
        return
    tally.expect(
        "SIGKILL" in target.status().crash or "9" in target.status().crash,
        f"told as {target.status().crash!r}",
    )
    kept = target.acquire_load()
    tally.expect(len(kept) > 100 and kept.lost == 0, f"{len(kept)} rows are kept, {kept.lost} lost")
    tally.count("rows kept", len(kept))
    target.download("pd.c")
    target.start()
    tally.expect(until(lambda: target.status().tick > 10), "it does not run again")
    target.pause()


def _kill_monitor(place: Place, target: Target, tally: Tally) -> Target:
    target.start()
    pid = target.info.pid
    runners = children(pid)
    os.kill(pid, signal.SIGKILL)
    tally.count("monitors killed")
    tally.expect(
        runners and until(lambda: not any(map(alive, runners)), GONE_S),
        "the runner of a killed monitor goes on",
    )
    try:
        target.status()
        tally.expect(False, "a killed target answers")
    except ZendspError:
        pass
    target.close()
    again = place.local("killed")
    with zendsp.connect("killed") as other:
        tally.expect(other.info.pid == again.info.pid, "a host finds the killed target")
    return again
