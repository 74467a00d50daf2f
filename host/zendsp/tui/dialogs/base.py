"""The frame that all dialogs share."""

from __future__ import annotations

from typing import TypeVar

from textual import events, on
from textual.await_complete import AwaitComplete
from textual.binding import Binding
from textual.screen import ModalScreen
from textual.widget import Widget
from textual.widgets import Button

from zendsp.tui.statusbar import StopButton

LEAST = 3  # rows of what scrolls
Result = TypeVar("Result")


class Dialog(ModalScreen[Result | None]):
    """A centred box; Escape dismisses it with None."""

    DEFAULT_CSS = """
    Dialog { align: center middle; background: $background 30%; }
    /* the margin: what the status bar says stays in sight */
    Dialog > .box { width: 76; max-width: 96%; height: auto; max-height: 100%; margin: 3 0 1 0; background: $surface;
                    border: round $primary; border-title-color: $accent; border-title-style: bold; padding: 0 1; }
    Dialog .buttons { height: 1; width: 100%; align-horizontal: right; margin-top: 1; }
    Dialog .buttons Button { margin-left: 2; }
    Dialog .hint { color: $text-muted; height: auto; }
    """  # noqa: E501
    BINDINGS = [Binding("escape", "cancel", "Cancel", priority=True)]  # noqa: RUF012

    long = 16  # rows of a list, or another part that scrolls, at most
    opened = False  # whether it takes keys already
    closed = False  # whether it has its answer

    def on_screen_resume(self) -> None:
        """Take the keys that were typed before the dialog was there, once the focus is in its
        place.
        """
        if not self.opened:
            self.call_after_refresh(self._ready)

    def _ready(self) -> None:
        hand_over = getattr(self.app, "hand_over", None)
        if hand_over is not None:
            self.app.call_later(hand_over, self)

    def on_mount(self) -> None:
        """Show that STOP works here too."""
        for box in self.query(".box"):
            box.border_subtitle = box.border_subtitle or "F9 STOP"

    def on_resize(self) -> None:
        """Shrink long contents, so that the lines and buttons below them stay in sight."""
        self.call_after_refresh(self._fit)

    def _fit(self) -> None:
        for long in self.query(".long"):
            box = long.query_ancestor(".box", Widget)
            rest = sum(
                part.outer_size.height + part.styles.margin.height
                for part in (box, *box.children) if part is not long
            ) - box.size.height  # margins and frame of the box remain
            long.styles.max_height = max(LEAST, min(self.long, self.size.height - rest))

    def on_click(self, event: events.Click) -> None:
        """STOP on a click on the red field, although the field belongs to the screen below."""
        below = [
            button for screen in self.app.screen_stack[:-1] for button in screen.query(StopButton)
        ]
        if any(button.region.contains(event.screen_x, event.screen_y) for button in below):
            event.stop()
            self.app.call_later(self.app.run_action, "stop")

    def dismiss(self, result: Result | None = None) -> AwaitComplete:
        """Close with the first answer. A second key, pressed before the dialog is gone, would
        otherwise close the screen below.
        """
        if self.closed:
            return AwaitComplete()
        self.closed = True
        gone = super().dismiss(result)
        answered = getattr(self.app, "answered", None)
        if answered is not None:
            answered()
        return gone

    @on(Button.Pressed, "#cancel")
    @on(Button.Pressed, "#close")
    def action_cancel(self) -> None:
        """Close and do nothing."""
        self.dismiss(None)
