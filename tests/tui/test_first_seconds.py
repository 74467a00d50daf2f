"""What the terminal does while its other screens are loaded and built, behind the first picture."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest
from steps import Until
from waiting import PATIENCE_S

from zendsp.tui import app as module
from zendsp.tui import workspace
from zendsp.tui.actions import SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.scope import Scope
from zendsp.tui.stop_process import StopState


async def test_keys_and_stop_are_seen_while_a_screen_is_loaded(
    app: ZendspApp, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They waited until all four screens were built: 4 to 14 s on a busy computer."""
    loaded, slow = module.import_module, threading.Event()

    def load(name: str) -> Any:
        if name.endswith("diagnose"):
            slow.wait(PATIENCE_S)
        return loaded(name)

    monkeypatch.setattr(module, "import_module", load)
    async with app.run_test() as pilot:
        try:
            app.run_worker(app._build_others())
            await pilot.press("f3")
            await until(pilot, lambda: app.current_mode == "execute", "Execute is shown")
            app.session.stops.tell(StopState.STOPPED, "stopped, at sample 7")
            await until(
                pilot,
                lambda: "sample&#160;7" in app.export_screenshot(),
                "the word of STOP is shown",
            )
            assert "diagnose" not in app._screens, "it is still being loaded"
        finally:
            slow.set()
        await until(
            pilot, lambda: {*app._screens} == {*SCREENS} and app.current_mode == "execute",
            "all are built, and the one that was asked for is shown",
        )


async def test_execute_opens_before_it_is_known_whether_references_are_there(
    app: ZendspApp, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, slow = threading.Event(), threading.Event()

    def look(path: Path) -> bool:
        asked.set()
        return slow.wait(PATIENCE_S)

    monkeypatch.setattr(workspace, "is_reference", look)
    (app.workspace.root / "a.mat").touch()
    async with app.run_test() as pilot:
        try:
            await pilot.press("f3")
            await until(pilot, asked.is_set, "the files are looked at")
            scope = app.screen.query_one("#run-preview", Scope)
            assert scope.empty_text == ""
        finally:
            slow.set()
        await until(pilot, lambda: "o chooses" in scope.empty_text, "it is said")
