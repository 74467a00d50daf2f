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
    """Newest at the bottom; bounded."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(
            id=id, max_lines=1000, wrap=True, markup=False, highlight=False, min_width=20
        )
        self._count = 0
        self.border_title = "Events"

    def on_resize(self, event: events.Resize) -> None:
        """Break the lines anew."""
        self.clear()
        self._count = 0

    def show(self, log: EventLog) -> None:
        """Append what is new; nothing while it is hidden, since lines are broken at the width of
        the moment.
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
