"""KILL, TERM, and STOP with CONT, of the host that commands, the monitor and the runner, drawn at
random while the machine moves.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator

from hardships.place import Place, Tally, alive, runner_of, until
from zendsp.errors import ZendspError
from zendsp.link import Target

PROMISE = (
    "whoever gets whichever signal: the machine stops or goes on as is promised, rows are kept,"
    " the host is told, and the next start is clean"
)
WHOM = ("host", "monitor", "runner")
HOW = ("KILL", "TERM", "STOP")
SEED = 13
FROZEN_S = 3.0  # longer than the lease of a host and the watchdog of the loop
HOST = """
import time, zendsp
t = zendsp.connect("shot", shown=True)
t.take_command(force=True); t.acknowledge(); t.drive_auto()
t.acquire_configure(["tick", "q"], seconds=600.0); t.acquire_start(); t.start()
while t.acquire_status().count < 50: time.sleep(0.01)
print("moves", flush=True)
time.sleep(9999)
"""


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    draw, target = random.Random(SEED), place.local("shot")
    try:
        while True:
            whom, how = draw.choice(WHOM), draw.choice(HOW)
            if target.status().state in ("empty", "crashed"):
                target.take_command(force=True)  # the last host may not have been missed yet
                target.download("pd.c")
            host = place.script(HOST)
            try:
                assert host.stdout is not None
                if not tally.expect(
                    host.stdout.readline() == "moves\n", "a host did not get its target to move"
                ):
                    return
                time.sleep(draw.uniform(0.0, 0.1))  # any moment of its motion
                target = _hit(place, target, host, whom, how, tally)
            finally:
                host.kill()
                host.wait()
            tally.expect(_alone(target), "the host has ended, and still commands")
            tally.count(f"{how} of the {whom}")
            yield
    finally:
        target.close()


def _hit(
    place: Place, target: Target, host: subprocess.Popen[str], whom: str, how: str, tally: Tally
) -> Target:
    pid = target.info.pid
    runner = runner_of(pid)
    hit = {"host": host.pid, "monitor": pid, "runner": runner}[whom]
    begin = time.monotonic()
    os.kill(hit, getattr(signal, f"SIG{how}"))
    if how == "STOP" and whom != "runner":  # a loop that hangs is ended while it does
        time.sleep(FROZEN_S)
        os.kill(hit, signal.SIGCONT)
    said = f"{how} of the {whom}"
    if whom == "monitor":
        return _monitor(place, target, runner, how, tally)
    if whom == "host":
        tally.expect(until(lambda: _trip(target) == "host lost"), f"{said}: no policy acts")
    else:
        told = until(lambda: target.status().state == "crashed")
        tally.expect(told and bool(target.status().crash), f"{said}: nobody is told")
        tally.expect(until(lambda: not alive(runner)), f"{said}: the runner is still there")
    tally.measure(f"s until it is told, {said}", time.monotonic() - begin)
    target.acquire_stop()
    rows = target.acquire_load()
    tally.expect(len(rows) >= 50 and rows.lost == 0, f"{said}: {len(rows)} rows, {rows.lost} lost")
    still = whom == "runner" or not any(target.status().io["aout"])
    tally.expect(still, f"{said}: outputs {target.status().io['aout']} after the trip")
    return target


def _monitor(place: Place, target: Target, runner: int, how: str, tally: Tally) -> Target:
    said = f"{how} of the monitor"
    if how == "STOP":
        tally.expect(until(lambda: _answers(target)), f"{said}: it does not answer again")
        tally.expect(alive(runner), f"{said}: the loop has ended")
        target.stop()
        tally.expect(until(lambda: _trip(target) != ""), f"{said}: STOP does not stop afterwards")
        return target
    pid = target.info.pid
    begin = time.monotonic()
    tally.expect(until(lambda: not alive(runner)), f"{said}: its runner goes on")
    tally.measure(f"s until the runner has ended, {said}", time.monotonic() - begin)
    try:
        target.status()
        tally.expect(False, f"{said}: it still answers")
    except ZendspError:
        pass
    target.close()
    if how == "TERM":
        tally.expect(until(lambda: not place.shared(pid)), f"{said}: shared memory is left")
    return place.local("shot")


def _alone(target: Target) -> bool:
    return until(lambda: len(target.status().hosts) == 1)


def _trip(target: Target) -> str:
    trip = target.status().trip
    return trip.reason if trip is not None else ""


def _answers(target: Target) -> bool:
    with contextlib.suppress(ZendspError):
        return bool(target.status().state)
    return False
