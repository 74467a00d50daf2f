"""Something to read, and perhaps to agree to."""

from __future__ import annotations

from rich.console import RenderableType
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, Static

from zendsp.tui.dialogs.base import Dialog


class Message(Dialog[bool]):
    """Show a text; the result is True if the user agreed, where there is something to agree to."""

    DEFAULT_CSS = """
    Message > .box { width: 96; }
    Message VerticalScroll { height: auto; max-height: 36; }
    Message .words { height: auto; }
    """
    BINDINGS = [  # noqa: RUF012
        Binding("enter", "agree", "OK"),
        *(  # while a button has the focus too
            Binding(key, f"scroll_text('{way}')", show=False)
            for key, way in {
                "up": "up",
                "down": "down",
                "pageup": "page_up",
                "pagedown": "page_down",
                "home": "home",
                "end": "end",
            }.items()
        ),
    ]

    def __init__(self, title: str, body: RenderableType, agree: str = "") -> None:
        super().__init__()
        self._title, self._body, self._agree = title, body, agree

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = self._title
            with VerticalScroll(can_focus=True):
                yield Static(self._body, classes="words", markup=False)
            with Horizontal(classes="buttons"):
                if self._agree:
                    yield Button(self._agree, variant="primary", id="ok", compact=True)
                yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        self.query_one("#ok" if self._agree else "#close", Button).focus()

    def action_agree(self) -> None:
        """Close with True."""
        self.dismiss(True)

    def action_scroll_text(self, way: str) -> None:
        """Scroll the text."""
        getattr(self.query_one(VerticalScroll), f"scroll_{way}")(animate=False, immediate=True)

    @on(Button.Pressed, "#ok")
    def _agreed(self) -> None:
        self.dismiss(True)

    @on(Button.Pressed, "#close")
    def _close(self) -> None:
        self.dismiss(None)
