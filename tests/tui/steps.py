"""Steps that many tests of the terminal take."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

from textual.pilot import Pilot

from zendsp.tui.actions import SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.screens.base import LabScreen

Until = Callable[[Pilot[None], Callable[[], object], str], Awaitable[None]]
Step = Callable[[ZendspApp, Pilot[None]], Awaitable[None]]
AnyScreen = TypeVar("AnyScreen", bound=LabScreen)


async def opened(
    app: ZendspApp, pilot: Pilot[None], until: Until, kind: type[AnyScreen]
) -> AnyScreen:
    """Open a screen by its key; returns it when its widgets are there."""
    await pilot.press(f"f{list(SCREENS).index(kind.NAME) + 2}")
    await until(
        pilot, lambda: isinstance(app.screen, kind) and app.screen.is_mounted, f"{kind.NAME} opens"
    )
    screen = app.screen
    assert isinstance(screen, kind)
    return screen
