"""A list to choose from, with a filter; one or several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, Input, OptionList, Static
from textual.widgets.option_list import Option as Row

from zendsp.tui.dialogs.base import Dialog


@dataclass(frozen=True)
class Option:
    """One line: the key that is returned, and the text that is shown. The key "" stands for
    something new: no filter hides it, and the typed text is returned with it.
    """

    key: str
    text: str
    detail: str = ""


class Choose(Dialog[list[str]]):
    """Choose one option, or several (space marks) in the order in which they were marked; the
    result is the list of keys.
    """

    DEFAULT_CSS = """
    Choose OptionList { height: auto; max-height: 16; border: none; padding: 0; background: $surface; }
    Choose Input { margin-bottom: 1; }
    """  # noqa: E501

    def __init__(
        self,
        title: str,
        options: Sequence[Option],
        *,
        several: bool = False,
        marked: Sequence[str] = (),
        most: int = 0,
        text: str = "",
    ) -> None:
        super().__init__()
        self._title, self._options, self._several, self._most = title, tuple(options), several, most
        self._marked = [key for key in marked if any(o.key == key for o in options)]
        self._text, self._words = text, ""

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = self._title
            if self._text:
                yield Static(self._text, classes="hint", markup=False)
            yield Input(placeholder="type to filter", compact=True)
            yield OptionList(markup=False, compact=True, classes="long")
            keys = (
                "space marks, ⏎ takes the marked ones (or this one)"
                if self._several
                else "⏎ chooses"
            )
            yield Static(f"{keys}, esc closes", classes="hint", id="keys", markup=False)
            if self._several:
                with Horizontal(classes="buttons"):
                    yield Button("OK", variant="primary", id="ok", compact=True)

    def on_mount(self) -> None:
        self._fill("")
        self.query_one(OptionList).focus()

    def _fill(self, words: str) -> None:
        rows = self.query_one(OptionList)
        at = rows.highlighted
        rows.clear_options()
        shown = [
            o for o in self._options if not o.key or words.lower() in f"{o.text} {o.detail}".lower()
        ]
        if words:  # who typed a name whole, or its beginning, means that one
            shown.sort(key=lambda o: _far(o.text.lower(), words.lower()))
        width = max((len(o.text) for o in shown), default=0)
        for o in shown:
            text = Text(no_wrap=True, overflow="ellipsis")
            if self._several:
                text.append(
                    f"{self._marked.index(o.key) + 1} ▐ " if o.key in self._marked else "  · "
                )
            text.append(o.text.ljust(width))
            text.append(f"  {o.detail}", "dim")
            rows.add_option(Row(text, id=o.key))
        if not shown:
            rows.add_option(Row(Text(f"nothing has {words!r} in it", "dim"), disabled=True))
        else:
            rows.highlighted = min(at or 0, len(shown) - 1)

    @on(Input.Changed)
    def _edited(self, event: Input.Changed) -> None:
        self._filter(event.value)

    def _filter(self, words: str) -> None:
        if words != self._words:
            self._words = words
            self.query_one(OptionList).highlighted = None
            self._fill(words)

    @on(Input.Submitted)
    def _to_list(self) -> None:
        rows = self.query_one(OptionList)
        rows.focus()
        if not self._several:
            rows.action_select()

    def on_key(self, event: events.Key) -> None:
        rows = self.query_one(OptionList)
        if (
            event.key == "space"
            and self._several
            and rows.has_focus
            and rows.highlighted is not None
        ):
            event.stop()
            key = str(rows.get_option_at_index(rows.highlighted).id)
            if key in self._marked:
                self._marked.remove(key)
            elif not self._most or len(self._marked) < self._most:
                self._marked.append(key)
            else:
                self.query_one("#keys", Static).update(f"at most {self._most}: take one away first")
                return
            self._fill(self.query_one(Input).value)
        elif event.character == "/" and rows.has_focus:
            event.stop()
            self.query_one(Input).focus()
        elif rows.has_focus and self._typed(event):
            event.stop()

    def _typed(self, event: events.Key) -> bool:
        """Type into the filter; arrows and ⏎ still act on the list."""
        field = self.query_one(Input)
        if event.key == "backspace":
            field.value = field.value[:-1]
        elif event.character is not None and event.is_printable:
            field.value += event.character
        else:
            return False
        field.cursor_position = len(field.value)
        # at once: an ⏎ that comes with the keys is heard before Input.Changed is
        self._filter(field.value)
        return True

    @on(OptionList.OptionSelected)
    def _selected(self, event: OptionList.OptionSelected) -> None:
        key = str(event.option.id)
        if not key:  # something new, by the name that was typed
            self.dismiss([key, self.query_one(Input).value])
        else:
            self.dismiss(self._marked if self._several and self._marked else [key])

    @on(Button.Pressed, "#ok")
    def _accept(self) -> None:
        self.dismiss(self._marked)


def _far(text: str, words: str) -> int:
    return 0 if text == words else 1 if text.startswith(words) else 2
