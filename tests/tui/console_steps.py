"""Steps that tests of Console take."""

from __future__ import annotations

import time

from steps import Step, Until
from textual.pilot import Pilot
from textual.widgets import Input

from zendsp.link import Target
from zendsp.tui.app import ZendspApp
from zendsp.tui.screens.console import ConsoleScreen


def console_of(app: ZendspApp) -> ConsoleScreen:
    assert isinstance(app.screen, ConsoleScreen)
    return app.screen


def events_of(app: ZendspApp) -> str:
    return "\n".join(e.text for e in app.session.events.since(0)[1])


async def mark_variable(app: ZendspApp, pilot: Pilot[None], name: str) -> None:
    """Put the cursor of the table on a variable, as soon as it is listed."""
    table, last = console_of(app).variables.table, time.monotonic() + 30.0
    while name not in table._keys and time.monotonic() < last:
        await pilot.pause(0.02)
    table.focus()
    table.mark(name)
    await pilot.pause()
    assert console_of(app).variables.marked == name


async def recording_of(
    lab: ZendspApp, target: Target, pilot: Pilot[None], built: Step, until: Until, seconds: str
) -> None:
    """Run pd.c, and begin to record it for some seconds."""
    await built(lab, pilot)
    target.start()
    await until(pilot, lambda: lab.session.snapshot.state == "running", "running")
    await pilot.press("r")
    await pilot.pause()
    await type_first(pilot, seconds)


async def type_first(pilot: Pilot[None], text: str) -> None:
    """Replace what a form's first field holds."""
    field = pilot.app.screen.query(Input).first()
    field.value = text
    await pilot.pause()
    await pilot.press("enter")
    await pilot.pause()
