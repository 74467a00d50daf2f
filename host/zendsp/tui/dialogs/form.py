"""A form: labelled fields with units, checked while typing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from textual import events, on
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal, VerticalScroll
from textual.widgets import Button, Input, Select, Static, Switch

from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.dialogs.yes_no import YesNo

Check = Callable[[str], Any]  # returns the value, or raises ValueError with the words for the user


def not_empty(text: str) -> str:
    """The text without blanks around it; an empty one is refused."""
    if not text.strip():
        raise ValueError("must not be empty")
    return text.strip()


@dataclass(frozen=True)
class Field:
    """One line of a form: a list where it has ``choices``, a switch where ``value`` is a bool, else
    text that ``check`` converts.
    """

    key: str
    label: str
    value: Any = ""
    unit: str = ""
    check: Check = str
    choices: Sequence[str] = ()
    hint: str = ""


class Line(Input):
    """An input that handles Enter itself, in the order of the keys. A binding for Enter would act
    after keys that were typed later.
    """

    BINDINGS = [  # noqa: RUF012
        Binding("down", "app.focus_next", show=False),
        Binding("up", "app.focus_previous", show=False),
    ]

    async def key_enter(self, event: events.Key) -> None:
        """Submit the text."""
        event.stop()
        await self.action_submit()


class Label(Static):
    """The label or unit of an input; a click on it focuses the input."""

    def on_click(self) -> None:
        """Give the input in the same line the focus."""
        beside = (w for w in self.parent.children if w.focusable) if self.parent else iter(())
        if (widget := next(beside, None)) is not None:
            self.screen.set_focus(widget)


class Form(Dialog[Mapping[str, Any]]):
    """Ask for several values; the result maps each key to its checked value."""

    DEFAULT_CSS = """
    Form .fields { height: auto; max-height: 16; }
    Form .field { height: 1; margin-bottom: 0; }
    Form .label { width: 22; height: 1; }
    Form .unit { width: 12; height: 1; color: $text-muted; padding-left: 1; }
    Form Input, Form Select { width: 1fr; }
    Form .problem { color: $error; height: auto; min-height: 1; }
    """

    def __init__(self, title: str, fields: Sequence[Field], text: str = "", ok: str = "OK") -> None:
        super().__init__()
        self._title, self._fields, self._text, self._ok = title, tuple(fields), text, ok

    def compose(self) -> ComposeResult:
        with VerticalScroll(classes="box") as box:
            box.border_title = self._title
            if self._text:
                yield Static(self._text, classes="hint", markup=False)
            for field in self._fields:
                with Horizontal(classes="field"):
                    yield Label(field.label, classes="label", markup=False)
                    yield self._widget(field)
                    yield Label(field.unit, classes="unit", markup=False)
            yield Static("", classes="problem", id="problem", markup=False)
            with Horizontal(classes="buttons"):
                yield Button(self._ok, variant="primary", id="ok", compact=True)
                yield Button("Cancel", id="cancel", compact=True)

    def _widget(self, field: Field) -> Input | Select[str] | Switch:
        if field.choices:
            options = [(choice, choice) for choice in field.choices]
            return Select(
                options, value=str(field.value), allow_blank=False, compact=True,
                id=f"f-{field.key}",
            )
        if isinstance(field.value, bool):
            return YesNo(field.value, id=f"f-{field.key}")
        return Line(str(field.value), compact=True, id=f"f-{field.key}", placeholder=field.hint)

    def on_mount(self) -> None:
        first = self.query_one(f"#f-{self._fields[0].key}")
        self.set_focus(first)  # now: what was typed before the form was there is for it
        if isinstance(first, Input):
            first.action_select_all()
        self._check()

    def _check(self) -> dict[str, Any] | None:
        """The values of all fields; None where one is wrong, whose problem is shown."""
        values: dict[str, Any] = {}
        for field in self._fields:
            widget = self.query_one(f"#f-{field.key}")
            raw = widget.value if isinstance(widget, Input | Select | Switch) else ""
            try:
                values[field.key] = (
                    raw if isinstance(widget, Select | Switch) else field.check(str(raw))
                )
            except ValueError as error:
                self.query_one("#problem", Static).update(f"{field.label}: {error}")
                self.query_one("#ok", Button).disabled = True
                return None
        self.query_one("#problem", Static).update("")
        self.query_one("#ok", Button).disabled = False
        return values

    @on(Input.Changed)
    @on(Select.Changed)
    @on(Switch.Changed)
    def _changed(self) -> None:
        self._check()

    @on(Input.Submitted)
    def _entered(self, event: Input.Submitted) -> None:
        event.input.value = event.value  # what was typed after Enter is no part of it
        self._submit()

    @on(Button.Pressed, "#ok")
    def _submit(self) -> None:
        values = self._check()
        if values is not None:
            self.dismiss(values)
