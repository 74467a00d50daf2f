"""The keys at the bottom of every screen, as one line of text.

Textual's own footer makes a widget of each key, and computes the styles of all of them at every
change of focus. That took a third of the terminal's processor time while keys were typed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import ClassVar

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual import events
from textual.screen import Screen
from textual.widget import Widget


@dataclass(frozen=True)
class Key:
    """One key with what it does."""

    key: str
    display: str
    description: str
    action: str
    enabled: bool
    help: str

    @property
    def width(self) -> int:
        """Columns that it takes."""
        return cell_len(f"{self.display} {self.description}")


class Keys(Widget):
    """The keys: as many as there is room for, STOP and Help first. A click on one presses it."""

    ALLOW_SELECT: ClassVar[bool] = False
    COMPONENT_CLASSES: ClassVar[set[str]] = {"keys--key", "keys--description", "keys--hover"}
    DEFAULT_CSS = """
    Keys { dock: bottom; height: 1; background: $panel; }
    Keys > .keys--key { color: $footer-key-foreground; text-style: bold; }
    Keys > .keys--description { color: $footer-description-foreground; }
    Keys > .keys--hover { background: $block-hover-background; }
    """
    FIRST = ("stop", "help")
    LAST = "command_palette"

    def __init__(self) -> None:
        super().__init__()
        self._every: list[Key] = []
        self._called: Mapping[str, str] = {}
        self._under: Key | None = None  # the mouse

    def on_mount(self) -> None:
        self.screen.bindings_updated_signal.subscribe(self, self._changed)

    def _changed(self, screen: Screen[object]) -> None:
        if not self.is_attached or screen is not self.screen or not self.app.app_focus:
            return
        every: dict[str, Key] = {}
        for _, binding, enabled, tooltip in screen.active_bindings.values():
            if binding.show and binding.action not in every:
                shown = self.app.get_key_display(binding), binding.description
                every[binding.action] = Key(
                    binding.key, *shown, binding.action, enabled, tooltip or binding.tooltip
                )
        if self._every != [*every.values()]:
            self._every = [*every.values()]
            self.refresh()

    def call(self, called: Mapping[str, str]) -> None:
        """Show these words for these actions, which do not always do what the table calls them."""
        if called != self._called:
            self._called = called
            self.refresh()

    @property
    def _keys(self) -> list[Key]:
        called = self._called
        return [replace(k, description=called.get(k.action, k.description)) for k in self._every]

    @property
    def shown(self) -> dict[Key, range]:
        """The keys that are shown, with the columns that each takes."""
        room = self.size.width + 1  # nothing is beside the last one
        kept: set[Key] = set()
        every = self._keys
        for key in sorted(every, key=self._rank):
            room -= key.width + 1
            if room < 0:
                break
            kept.add(key)
        keys = [key for key in every if key in kept]
        ends = accumulate((key.width + 1 for key in keys), initial=0)
        return {key: range(at, at + key.width) for key, at in zip(keys, ends, strict=False)}

    def _rank(self, key: Key) -> int:
        name = key.action.removeprefix("app.")
        return self.FIRST.index(name) - 2 if name in self.FIRST else int(name == self.LAST)

    def render(self) -> Text:
        name, said = (self.get_component_rich_style(f"keys--{n}") for n in ("key", "description"))
        text = Text(no_wrap=True)
        for key in self.shown:
            more = Style(dim=not key.enabled)
            if key == self._under:
                more += Style(bgcolor=self.get_component_rich_style("keys--hover").bgcolor)
            text.append(key.display, name + more)
            text.append(f" {key.description}", said + more)
            text.append(" ")
        return text

    def _at(self, x: int) -> Key | None:
        return next((key for key, columns in self.shown.items() if x in columns), None)

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Show which key a click would press, and what it does."""
        self._point(self._at(event.x))

    def on_leave(self) -> None:
        self._point(None)

    def _point(self, key: Key | None) -> None:
        if key != self._under:
            self._under = key
            self.tooltip = key.help if key else None
            self.refresh()

    def on_mouse_down(self, event: events.MouseDown) -> None:
        key = self._at(event.x)
        if key is not None and key.enabled:
            self.app.simulate_key(key.key)
        elif key is not None:
            self.app.bell()
