"""The event log on the screen."""

from __future__ import annotations

import time

from rich.style import Style
from rich.text import Text
from textual import events
from textual.widgets import RichLog

from zendsp.tui.events import EventLog

COLOURS = {"good": "success", "warning": "warning", "error": "error"}


class EventsPanel(RichLog):
    """The newest events at the bottom, of a bounded number."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(
            id=id, max_lines=1000, wrap=True, markup=False, highlight=False, min_width=20
        )
        self._count = 0
        self.border_title = "Events"

    def on_resize(self, event: events.Resize) -> None:
        """Wrap the lines to the new width."""
        self.clear()
        self._count = 0

    def show(self, log: EventLog) -> None:
        """Append new events. While the panel is hidden it does nothing, since lines are wrapped at
        the width that it has when they are written.
        """
        if not self.size.width:
            return
        self._count, fresh = log.since(self._count)
        c = self.app.theme_variables
        for event in fresh:
            line = Text(
                time.strftime("%H:%M:%S ", time.localtime(event.host_time)), Style(dim=True)
            )
            colour = COLOURS.get(event.level)
            line.append(event.text, Style(color=c[colour]) if colour else Style())
            self.write(line)
