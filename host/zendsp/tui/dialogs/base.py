"""The frame that all dialogs share."""

from __future__ import annotations

from typing import TypeVar

from textual.binding import Binding
from textual.screen import ModalScreen

Result = TypeVar("Result")


class Dialog(ModalScreen[Result | None]):
    """A centred box; Escape dismisses it with None."""

    DEFAULT_CSS = """
    Dialog { align: center middle; background: $background 30%; }
    Dialog > .box { width: 76; max-width: 96%; height: auto; max-height: 92%; background: $surface;
                    border: round $primary; border-title-color: $accent; border-title-style: bold; padding: 0 1; }
    Dialog .buttons { height: 1; width: 100%; align-horizontal: right; margin-top: 1; }
    Dialog .buttons Button { margin-left: 2; }
    Dialog .hint { color: $text-muted; height: auto; }
    """
    BINDINGS = [Binding("escape", "cancel", "Cancel", priority=True)]  # noqa: RUF012

    def on_mount(self) -> None:
        """Keep in sight that STOP works here too."""
        for box in self.query(".box"):
            box.border_subtitle = box.border_subtitle or "F9 STOP"

    def action_cancel(self) -> None:
        """Close and do nothing."""
        self.dismiss(None)
