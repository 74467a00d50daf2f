"""The time of day is changed while a machine moves: only displayed times change."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from clocks import Clocks
from helpers import kill, python
from waiting import until

import zendsp
from zendsp.link import Target

YEAR_S = 366 * 86400
HOST = """
import json, sys, time, zendsp
from zendsp.errors import Incomplete
from zendsp import Trigger
with zendsp.connect(sys.argv[1]) as target:
    target.take_command()
    target.start()
    view = target.live(["tick"])
    print("moves", flush=True)
    found = target.acquire(["tick"], seconds=3.0)
    began = time.monotonic()
    try:  # never: it is no negative number
        target.acquire(["tick"], 1.0, trigger=Trigger(source="tick", level=-1.0), timeout=1.5)
    except Incomplete:
        waited = time.monotonic() - began
    steps = [int(b - a) for a, b in zip(found["tick"], found["tick"][1:])]
    print(json.dumps([found.lost, len(found), sorted(set(steps)), waited, target.alive,
        view.received, target.drive_status().commander != ""]), flush=True)
    time.sleep(999)
"""


@pytest.fixture
def clocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Clocks]:
    """Clocks of all processes of the test, of which the time of day jumps by years."""
    clocks, over = Clocks(tmp_path), threading.Event()
    for name, value in clocks.env.items():
        monkeypatch.setenv(name, value)

    def jump() -> None:
        ahead = YEAR_S
        while not over.wait(0.3):
            clocks.set(day_s=ahead)
            ahead = -ahead

    thread = threading.Thread(target=jump)
    thread.start()
    yield clocks
    over.set()
    thread.join()


def test_a_clock_that_jumps_neither_stops_nor_frees_anything(
    clocks: Clocks, start: Callable[..., Target]
) -> None:
    target = start(clock="real", options=["--no-realtime"])
    target.download("pd.c")
    host = python(HOST, target.name)
    assert host.stdout is not None
    assert host.stdout.readline() == "moves\n"
    lost, rows, steps, waited, alive, received, commands = json.loads(host.stdout.readline())
    status = target.status()
    assert status.state == "running" and status.trip is None, status
    assert alive and commands and received > 0
    assert rows == 3000 and lost == status.timing.missed and (lost or steps == [1])
    assert 1.5 <= waited < 60.0, "a second and a half, whatever the year"
    kill(host)
    until(lambda: target.status().trip is not None, "the policy acts", target.status)
    trip = target.status().trip
    assert trip is not None and trip.reason == "host lost"
    changes = [change.host_time for change in target.log()]
    assert changes == [] or max(changes) > 0.0
    assert target.name in {one.name for one in zendsp.discover()}
