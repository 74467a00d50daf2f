"""Steps that many tests of the terminal take."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static

from zendsp.errors import LinkError
from zendsp.recording import Recording
from zendsp.reference import make_reference, save_reference
from zendsp.tui.actions import SCREENS
from zendsp.tui.app import ZendspApp
from zendsp.tui.dialogs import Message
from zendsp.tui.link_port import open_port
from zendsp.tui.port import Port
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.screens.diagnose import DiagnoseScreen
from zendsp.tui.screens.execute import ExecuteScreen

COLLECTED = pytest.StashKey[list[pytest.Item]]()  # all tests, also those that are not run
Until = Callable[[Pilot[None], Callable[[], object], str], Awaitable[None]]
Step = Callable[[ZendspApp, Pilot[None]], Awaitable[None]]
AnyScreen = TypeVar("AnyScreen", bound=LabScreen)


def nobody(name: str) -> Port:
    """Open no target: there is none."""
    raise LinkError(f"no target {name}")


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


async def slow_circle(
    app: ZendspApp, pilot: Pilot[None], until: Until, folder: Path
) -> ExecuteScreen:
    """Play a circle of 40 s: two of the clock, long enough to be caught in the act."""
    slow = folder / "references" / "slow.mat"
    save_reference(make_reference("circle", "imi_planar", duration=40.0), slow)
    screen = await opened(app, pilot, until, ExecuteScreen)
    app.chosen = (slow,)
    await until(
        pilot,
        lambda: screen.references and screen.conditions and all(c.met for c in screen.conditions),
        "ready",
    )
    await pilot.press("s")
    await until(pilot, lambda: screen.job and screen.job.progress.phase == "play", "it plays")
    return screen


def short_run(gain: float) -> Recording:
    """Half a second of a run with this ``Kp1``."""
    t = np.arange(500) * 1e-3
    columns = {
        "q": np.stack((np.sin(t), np.cos(t)), axis=1),
        "e": np.stack((0.01 * t, 0.02 * t), axis=1),
    }
    return Recording.from_columns(
        columns, 1e-3, units={"q": "rad", "e": "rad"}, parameters={"Kp1": gain, "Kd1": 5.0},
        sources={"pd.c": f"/* {gain} */"}, machine="imi_planar", note="n",
    )  # fmt: skip


def text_of(screen: DiagnoseScreen, name: str) -> str:
    return str(screen.query_one(name, Static).render())


async def stored_shown(pilot: Pilot[None], until: Until) -> DiagnoseScreen:
    """Open Diagnose, and on it the newest diagnosis that is stored."""
    assert isinstance(pilot.app, ZendspApp)
    screen = await opened(pilot.app, pilot, until, DiagnoseScreen)
    await pilot.press("o", "enter")
    await until(pilot, lambda: screen.shown is not None, "the newest is opened")
    return screen


def dialog_words(pilot: Pilot[None]) -> str:
    """What the dialog in sight says."""
    assert isinstance(pilot.app.screen, Message)
    return str(pilot.app.screen.query_one(".words").render())


async def answer(pilot: Pilot[None], text: str) -> None:
    await pilot.pause()
    field = pilot.app.screen.query_one(Input)
    field.value = text
    await pilot.pause()
    await pilot.press("enter")
    await pilot.pause()


@asynccontextmanager
async def alone(
    folder: Path, until: Until, size: tuple[int, int] = (100, 30)
) -> AsyncIterator[tuple[Pilot[None], DiagnoseScreen]]:
    """The application without a target, on Diagnose."""
    app = ZendspApp(open_port, folder=folder, first="diagnose", frames=4.0)
    async with app.run_test(size=size) as pilot:
        yield pilot, await opened(app, pilot, until, DiagnoseScreen)
