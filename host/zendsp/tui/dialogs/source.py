"""The C source with the compiler's messages: read, correct, save and build again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.style import Style
from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, OptionList, Static, TextArea
from textual.widgets.option_list import Option

from zendsp.tui.dialogs.base import Dialog
from zendsp.whole_file import write_whole
from zendsp_protocol.messages import Diagnostic
from zendsp_protocol.states import Severity
from zendsp_protocol.texts import placed


class SourceView(Dialog[bool]):
    """An editor; the result is True if the user asked to build."""

    DEFAULT_CSS = """
    SourceView > .box { width: 96%; height: 100%; }
    SourceView TextArea { height: 1fr; border: none; padding: 0; }
    SourceView OptionList { height: auto; max-height: 6; border: none; padding: 0; background: $surface; }
    """  # noqa: E501
    BINDINGS = [  # noqa: RUF012
        Binding("ctrl+s", "save", "Save"),
        Binding("ctrl+b", "save_and_build", "Save and build"),
        Binding("f8", "next_remark", "Next remark"),
    ]

    def __init__(
        self, path: Path, remarks: Sequence[Diagnostic], saved: Callable[[str], None]
    ) -> None:
        super().__init__()
        self._path, self._remarks, self._saved = path, tuple(remarks), saved
        self._at = -1

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = str(self._path)
            box.border_subtitle = "^b saves and builds  f8 next remark  F9 STOP"
            yield TextArea(
                self._path.read_text(), show_line_numbers=True, tab_behavior="indent",
                soft_wrap=False,
            )
            yield OptionList(
                *[Option(self._line(r)) for r in self._remarks], markup=False, compact=True
            )
            yield Static("", classes="hint", id="said", markup=False)
            with Horizontal(classes="buttons"):
                yield Button("Save and build ^b", id="build", variant="primary", compact=True)
                yield Button("Save ^s", id="save", compact=True)
                yield Button("Close", id="close", compact=True)

    def _line(self, r: Diagnostic) -> Text:
        c = self.app.theme_variables
        colour = (
            c["error"]
            if r.severity == Severity.ERROR
            else c["warning"]
            if r.severity == Severity.WARNING
            else c["foreground"]
        )
        text = Text(placed(r.file, r.line, r.column, ""), Style(bold=True))
        return text.append(f"{r.severity}: {r.message}", Style(color=colour))

    def on_mount(self) -> None:
        self.query_one(OptionList).display = bool(self._remarks)
        self.query_one(TextArea).focus()
        self.action_next_remark()
        self.call_after_refresh(self._see)  # once the editor knows its size

    def action_next_remark(self) -> None:
        """Go to the next message of the compiler in this file."""
        here = [r for r in self._remarks if r.file == self._path.name and r.line > 0]
        if here:
            self._at = (self._at + 1) % len(here)
            self._go(here[self._at])

    def _go(self, r: Diagnostic) -> None:
        area = self.query_one(TextArea)
        area.move_cursor((max(r.line - 1, 0), max(r.column - 1, 0)))
        area.focus()
        self._see()

    def _see(self) -> None:
        """Scroll to the line of the cursor; the beginning of the line stays in sight where the
        column permits it.
        """
        area = self.query_one(TextArea)
        area.scroll_cursor_visible(center=True)
        if area.cursor_location[1] < area.scrollable_content_region.width - area.gutter_width:
            area.scroll_to(x=0, animate=False)

    @on(OptionList.OptionSelected)
    def _picked(self, event: OptionList.OptionSelected) -> None:
        self._go(self._remarks[event.option_index])

    @on(Button.Pressed, "#save")
    def action_save(self) -> bool:
        """Write the file."""
        try:
            write_whole(self._path, self.query_one(TextArea).text)
        except OSError as error:
            self.query_one("#said", Static).update(f"not saved: {error}")
            return False
        self.query_one("#said", Static).update("saved")
        self._saved(f"saved {self._path}")
        return True

    @on(Button.Pressed, "#build")
    def action_save_and_build(self) -> None:
        """Write the file and build it."""
        if self.action_save():
            self.dismiss(True)
