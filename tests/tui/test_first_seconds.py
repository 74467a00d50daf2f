"""What the terminal does in its first seconds."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from steps import Until, opened
from textual.events import Resize
from textual.geometry import Size
from textual.screen import Screen
from waiting import PATIENCE_S

from zendsp.tui import workspace
from zendsp.tui.app import ZendspApp
from zendsp.tui.scope import Scope
from zendsp.tui.screens.execute import ExecuteScreen

EARLY = """
import sys
from zendsp.tui import stopper

def started(target):
    print(target, "zendsp.tui.app" in sys.modules)
    raise SystemExit

stopper.Stopper = started
from zendsp.cli import main
main()
"""


def test_stop_is_made_ready_for_its_target_before_the_screens_are_loaded() -> None:
    """F9 at the first picture waited until the process that reads the keys had begun, after it."""
    done = subprocess.run(
        [sys.executable, "-c", EARLY, "tui", "imi"], env=os.environ | {"TEXTUAL_DRIVER": "none"},
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.stdout == "imi False\n", done


async def test_a_screen_is_built_when_its_key_is_pressed_and_no_earlier(
    app: ZendspApp, until: Until
) -> None:
    """F3 and the word of a STOP waited for 2 to 6 s until all screens were built."""
    async with app.run_test() as pilot:
        app._first_picture()
        await pilot.press("?", "escape")
        assert {*app._screens} == {"console"}
        await opened(app, pilot, until, ExecuteScreen)
        assert {*app._screens} == {"console", "execute"}


async def test_execute_opens_before_it_is_known_whether_references_are_there(
    app: ZendspApp, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To look at the first one SciPy is loaded, which takes a second on a busy computer."""
    asked, slow = threading.Event(), threading.Event()

    def look(path: Path) -> bool:
        asked.set()
        return slow.wait(PATIENCE_S)

    monkeypatch.setattr(workspace, "is_reference", look)
    (app.workspace.root / "a.mat").touch()
    async with app.run_test() as pilot:
        try:
            screen = await opened(app, pilot, until, ExecuteScreen)
            await until(pilot, asked.is_set, "the files are looked at")
            scope = screen.query_one("#run-preview", Scope)
            assert scope.empty_text == ""
        finally:
            slow.set()
        await until(pilot, lambda: "o chooses" in scope.empty_text, "it is said")


async def test_a_resize_while_a_screen_is_built_is_followed_at_once(
    app: ZendspApp, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The picture before it stood there in its old size for 2 s."""
    begun, go_on = asyncio.Event(), asyncio.Event()
    compose = ExecuteScreen._compose

    async def slowly(screen: ExecuteScreen) -> None:
        begun.set()
        await go_on.wait()
        await compose(screen)

    monkeypatch.setattr(ExecuteScreen, "_compose", slowly)
    async with app.run_test(size=(130, 40)) as pilot:
        console, larger = app.screen, Size(150, 50)
        app.call_later(app.action_show, "execute")
        await begun.wait()
        await app._post_message(Resize(larger, larger))  # as the driver does
        try:
            await asyncio.wait_for(_sized(console, larger), PATIENCE_S)
            assert app.screen is console, "and it is shown until the new one is built"
        finally:
            go_on.set()
        await until(pilot, lambda: isinstance(app.screen, ExecuteScreen), "the new one follows")
        await asyncio.wait_for(_sized(app.screen, larger), PATIENCE_S)


async def _sized(screen: Screen[object], size: Size) -> None:
    while screen.size != size or screen.children[0].size.width != size.width:
        await asyncio.sleep(0.01)
