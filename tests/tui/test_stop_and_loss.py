"""STOP during a motion from each screen, a target killed while running, and a terminal that
disappears.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from steps import Step, Until, slow_circle
from textual.widgets import Input
from waiting import until as come

from zendsp.link import Target
from zendsp.recording import Recording
from zendsp.tui.actions import SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Field, Form
from zendsp.tui.link_port import open_port
from zendsp.tui.screens.reference import ReferenceScreen

VELOCITY = 2.0  # the built-in signal `drive`


def _judge(target: Target) -> tuple[Recording, int]:
    """Return the target's own record around the STOP, and the sample at which it was latched."""
    trip = target.status().trip
    assert trip is not None and trip.reason == "stop"
    target.acquire_stop()
    return target.acquire_load(), trip.tick


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("dialog", [False, True], ids=["plain", "under a dialog"])
@pytest.mark.covers("app.stop")
async def test_stop_makes_outputs_safe_within_two_samples(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, screen: str, dialog: bool
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        target.acquire_configure(["tick", "aout", "drive"], seconds=20.0, continuous=True)
        target.acquire_start()
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 2.0, "the arm moves")
        await pilot.press(
            {"console": "f2", "execute": "f3", "reference": "f4", "diagnose": "f5"}[screen]
        )
        await until(pilot, lambda: lab.current_mode == screen, screen)
        if dialog:
            await lab.push_screen(Form("Note", [Field("note", "Note", "")]))
        await pilot.press("f9")
        await until(pilot, lambda: target.status().trip is not None, "latched on the target")
        await until(
            pilot,
            lambda: target.status().tick > (target.status().trip or pytest.fail("trip")).tick + 50,
            "time goes on after it",
        )
        record, latched = _judge(target)
        tick = record["tick"]
        before, after = tick < latched, tick >= latched + 2
        assert np.abs(record["aout"][before]).max() > 50.0, "the arm was being driven"
        assert after.sum() > 20
        assert not record["aout"][after].any(), "zero reference"
        assert (record["drive"][after] == VELOCITY).all(), "in velocity mode"
        assert record.lost == 0
        await until(
            pilot, lambda: lab.session.snapshot.drive == "stopped", "and every screen shows it"
        )


async def test_a_click_on_the_red_field_stops_as_well(
    lab: ZendspApp, target: Target, enabled: Step, until: Until
) -> None:
    async with lab.run_test(size=(80, 24)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 0.5, "moves")
        assert await pilot.click("StopButton")
        await until(pilot, lambda: target.drive_status().state == "stopped", "stopped")
        assert await pilot.click("Tabs", offset=(22, 0))
        await until(
            pilot, lambda: lab.current_mode == "execute", "a click on its name opens a screen"
        )


async def test_after_stop_nothing_moves_until_somebody_enables(
    lab: ZendspApp, target: Target, enabled: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 1.0, "moves")
        await pilot.press("f9")
        await until(pilot, lambda: lab.session.snapshot.drive == "stopped", "stopped")
        refused = lambda: [  # noqa: E731
            e.text for e in lab.session.events.since(0)[1] if "refused" in e.text
        ]
        # one after the other: a start asked while enabling waits goes with it
        for key, count in (("e", 1), ("s", 2)):
            await pilot.press(key)
            await until(pilot, lambda n=count: len(refused()) == n, f"{key} is refused: latched")
        await until(
            pilot, lambda: not lab.session.stops.unseen(time.monotonic()), "somebody saw it"
        )
        await pilot.press("ctrl+k")
        await until(pilot, lambda: lab.session.snapshot.drive == "homed", "acknowledged")
        await pilot.press("s")
        await until(pilot, lambda: len(refused()) == 3, "start is refused: not enabled")
        assert not np.any(target.status().io["aout"])
        await pilot.press("e")
        await until(pilot, lambda: lab.session.snapshot.drive == "enabled", "enabled again")


async def test_what_was_asked_before_a_stop_is_not_done_after_it(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP passes what waits for a slow screen or a slow request: neither undoes it afterwards."""
    monkeypatch.setattr("zendsp.tui.stop_lane.REACTION_S", 1e9)
    gate = Event()
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 0.5, "moves")
        lab.session.do("slow", lambda port: gate.wait())
        late = lab.session.do("acknowledge", lambda port: port.drive("acknowledge"))
        await pilot.press("f9")
        await until(pilot, lambda: lab.session.snapshot.drive == "stopped", "stopped")
        gate.set()
        await until(pilot, late.done, "its turn came")
        assert "STOP came after" in str(late.exception())
        await pilot.press("ctrl+k")
        await until(pilot, lambda: bool(lab._notifications), "it says why it does nothing")
        later = lab.session.do("look", lambda port: port.drive("status"))
        await until(pilot, later.done, "all that was asked is done")
        trip = target.status().trip
        assert trip is not None and trip.reason == "stop"


async def test_a_key_that_was_typed_before_a_trip_was_shown_does_not_acknowledge_it(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 0.5, "moves")
        target.stop()  # by somebody else
        await until(pilot, lambda: lab.session.snapshot.drive == "stopped", "it is told")
        monkeypatch.setattr("zendsp.tui.stop_lane.REACTION_S", 1e9)
        await pilot.press("ctrl+k")
        await until(pilot, lambda: bool(lab._notifications), "it says why it does nothing")
        monkeypatch.undo()
        seen = lab.session.snapshot
        target.stop()
        await until(pilot, lambda: lab.session.snapshot.trip != seen.trip, "one more is told")
        lab.session.snapshot = seen  # what the screen still shows
        monkeypatch.setattr("zendsp.tui.stop_lane.REACTION_S", -1e9)
        lab.action_acknowledge()
        refused = lambda: any(  # noqa: E731
            "another STOP or trip came" in e.text for e in lab.session.events.since(0)[1]
        )
        await until(pilot, refused, "the target refuses")
        assert target.status().trip is not None


async def test_acknowledging_what_is_not_latched_pauses_nothing(
    lab: ZendspApp, target: Target, enabled: Step, until: Until
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.t > 0.5, "moves")
        await pilot.press("ctrl+k")
        await until(pilot, lambda: bool(lab._notifications), "it says that nothing is latched")
        await pilot.press("r")
        await until(pilot, lambda: isinstance(lab.screen, Form), "the form of a recording")
        field = lab.screen.query_one("#f-seconds", Input)
        field.focus()
        await pilot.press("home", "ctrl+k")
        assert field.value == "", "in an input field the key cuts the line, as in any shell"
        await until(pilot, lambda: lab.session.snapshot.t > 1.0, "it goes on")
        assert target.status().state == "running"


async def test_stop_during_a_run_ends_it_and_keeps_the_data(
    lab: ZendspApp, target: Target, enabled: Step, until: Until, folder: Path
) -> None:
    async with lab.run_test(size=(100, 30)) as pilot:
        await enabled(lab, pilot)
        screen = await slow_circle(lab, pilot, until, folder)
        await pilot.press("f9")
        await until(pilot, lambda: screen.runs, "the run is kept")
        assert screen.runs[0].outcome.startswith("stopped") and screen.runs[0].rows > 0


# -- loss


def _spawn(name: str) -> subprocess.Popen[bytes]:
    command = [
        sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--name", name,
        "--clock", "fast", "--speed", "20", "--json",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None and json.loads(process.stdout.readline())["name"] == name
    return process


@pytest.fixture
def own_target() -> Iterator[tuple[str, Callable[[], subprocess.Popen[bytes]]]]:
    """A target of its own name that may be killed and started again."""
    name = f"lost-{os.getpid()}"
    alive: list[subprocess.Popen[bytes]] = []

    def start() -> subprocess.Popen[bytes]:
        alive.append(_spawn(name))
        return alive[-1]

    yield name, start
    for process in alive:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


async def test_a_killed_target_is_shown_nothing_freezes_and_the_link_comes_back(
    own_target: tuple[str, Callable[[], subprocess.Popen[bytes]]], until: Until, folder: Path
) -> None:
    name, start = own_target
    process = start()
    app = ZendspApp(open_port, target=name, folder=folder, source=folder / "pd.c", frames=4.0)
    async with app.run_test(size=(100, 30)) as pilot:
        await until(pilot, lambda: app.session.snapshot.link == "up", "link")
        await pilot.press("b")
        await until(
            pilot, lambda: app.session.snapshot.state == "loaded" and app.session.channels, "built"
        )
        await pilot.press("s")
        await until(pilot, lambda: app.session.history.count > 200, "live")
        process.send_signal(signal.SIGKILL)
        process.wait()
        await until(pilot, lambda: app.session.snapshot.link == "lost", "the loss is shown")
        assert "LINK LOST" in app.screen.bar.where(app.session.snapshot).plain  # type: ignore[attr-defined]
        await until(pilot, lambda: app.session.snapshot.gone, "its process has ended")
        await pilot.press("f9")  # STOP without a link says so, at once
        await until(
            pilot, lambda: any("NOT STOPPED" in e.text for e in app.session.events.since(0)[1]),
            "told",
        )
        await pilot.press("f4")
        await until(
            pilot, lambda: isinstance(app.screen, ReferenceScreen) and app.screen.plan is not None,
            "Reference works",
        )
        await pilot.press("f2")
        start()
        await until(pilot, lambda: app.session.snapshot.link == "up", "reconnected by itself")
        await pilot.press("b")
        await until(
            pilot, lambda: app.session.snapshot.state == "loaded", "and it can be used again"
        )
        await pilot.press("s")
        count = app.session.history.count
        await until(pilot, lambda: app.session.history.count > count + 100, "curves are live again")


async def test_a_runner_that_crashes_is_shown_with_its_signal(
    lab: ZendspApp, built: Step, until: Until, folder: Path
) -> None:
    crash = folder / "crash.c"
    crash.write_text(
        '#include "isr.h"\nstatic double a;\nvoid UserInit(void) { SIGNAL(a, "", ""); }\n'
        "void UserISR_INT2(void) { a += 1.0; if (a > 500.0) *(volatile int *)8 = 1; }\n"
        "void UserBackground(void) {}\n"
    )
    async with lab.run_test(size=(100, 30)) as pilot:
        await built(lab, pilot)
        lab.source = crash
        await pilot.press("b")
        await until(
            pilot, lambda: [v.name for v in lab.session.snapshot.variables][:1] == ["a"],
            "downloaded",
        )
        await pilot.press("s")
        await until(pilot, lambda: lab.session.snapshot.state == "crashed", "crashed")
        assert "SIGSEGV" in lab.session.snapshot.crash
        assert "SIGSEGV" in lab.screen.bar.trouble(lab.session.snapshot).plain  # type: ignore[attr-defined]
        lab.source = folder / "pd.c"
        await pilot.press("b")
        await until(pilot, lambda: lab.session.snapshot.state == "loaded", "a new download works")


_HOST = """
import sys, time
from zendsp.link import connect
with connect(sys.argv[1]) as t:
    t.power_on(); t.enable(); t.set_host_lost(sys.argv[2]); t.start()
    print("running", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("policy", ["stop", "hold", "finish"])
def test_when_the_commanding_host_disappears_the_policy_decides(
    target: Target, folder: Path, policy: str
) -> None:
    target.download(folder / "pd.c")
    host = subprocess.Popen(
        [sys.executable, "-c", _HOST, target.name, policy], stdout=subprocess.PIPE
    )
    try:
        assert host.stdout is not None and host.stdout.readline() == b"running\n"
        assert target.drive_status().state == "running" and target.drive_status().commander
        host.kill()
        come(lambda: not target.drive_status().commander, "the right to command is freed")
        if policy == "stop":
            come(lambda: target.status().trip, "a trip")
            trip = target.status().trip
            assert trip is not None and trip.reason == "host lost"
            assert target.drive_status().state == target.status().drive == "stopped"
            assert not np.any(target.status().io["aout"])
        else:
            if policy == "hold":
                come(lambda: target["hold"], "the program holds")
            tick = target.status().tick
            come(lambda: target.status().tick >= tick + 200, "the program goes on")
            assert target.status().trip is None
    finally:
        host.kill()
        host.wait()
        if host.stdout is not None:
            host.stdout.close()
