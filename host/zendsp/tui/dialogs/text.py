"""A text to read, with or without a question that can be agreed to."""

from __future__ import annotations

from rich.console import RenderableType
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, Static

from zendsp.tui.dialogs.base import Dialog

WAYS = {  # key: pages and rows down
    "up": (0, -1),
    "down": (0, 1),
    "pageup": (-1, 0),
    "pagedown": (1, 0),
    "home": (-1000, 0),
    "end": (1000, 0),
}


class Message(Dialog[bool]):
    """Show a text; the result is True if the user agreed to its question."""

    DEFAULT_CSS = """
    Message > .box { width: 96; }
    Message VerticalScroll { height: auto; max-height: 36; }
    Message .words { height: auto; }
    """
    BINDINGS = [  # noqa: RUF012
        Binding("enter", "agree", "OK"),
        *(Binding(key, f"scroll_text('{key}')", show=False) for key in WAYS),
    ]

    long = 36

    def __init__(self, title: str, body: RenderableType, agree: str = "") -> None:
        super().__init__()
        self._title, self._body, self._agree = title, body, agree

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = self._title
            with VerticalScroll(can_focus=True, classes="long"):
                yield Static(self._body, classes="words", markup=False)
            with Horizontal(classes="buttons"):
                if self._agree:
                    yield Button(self._agree, variant="primary", id="ok", compact=True)
                yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        self.query_one("#ok" if self._agree else "#close", Button).focus()

    @on(Button.Pressed, "#ok")
    def action_agree(self) -> None:
        """Close with True."""
        self.dismiss(True)

    def action_scroll_text(self, key: str) -> None:
        """Scroll the text, whichever widget has the focus."""
        text = self.query_one(VerticalScroll)
        pages, rows = WAYS[key]
        text.scroll_relative(y=pages * text.size.height + rows, animate=False, immediate=True)
