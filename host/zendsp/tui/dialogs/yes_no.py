"""A switch that says in words whether it is on, for people who cannot tell its colours."""

from __future__ import annotations

from rich.text import Text
from textual.widgets import Switch


class YesNo(Switch):
    """On or off, in words."""

    def render(self) -> Text:  # type: ignore[override]  # not the slider
        """Return a mark and a word."""
        return Text(" ● yes" if self.value else " ○ no")
