"""What the terminal does in its first seconds."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from steps import Until, opened
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
