"""Parameters as sliders between their declared limits: each move is written at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from rich.style import Style
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.message import Message
from textual.widget import Widget
from textual.widgets import Static

from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.snapshot import Variable
from zendsp.tui.values import show_value
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Assignable

STEP, COARSE, FINE = 1 / 200, 1 / 20, 1 / 2000  # of the range
SEND_S = 0.1  # between writes while a slider moves
QUIET = 5  # of these without a move, until what the target has is shown again
NAME, VALUE = 14, 22  # columns
MOST_ELEMENTS = 16  # of an array that has sliders


@dataclass(frozen=True)
class Range:
    """The ends of a slider."""

    low: float
    high: float
    whole: bool

    def at(self, share: float) -> float:
        """The value at a fraction of the range; a whole number where the parameter is one."""
        value = self.low + min(max(share, 0.0), 1.0) * (self.high - self.low)
        return float(round(value)) if self.whole else float(f"{value:.6g}")

    def share(self, value: float) -> float:
        """The fraction of the range at which a value lies, 0 … 1."""
        return min(max((value - self.low) / (self.high - self.low), 0.0), 1.0)


def slides(v: Variable) -> bool:
    """Whether a parameter can have sliders: it has finite limits, and not too many elements."""
    ends = (v.minimum, v.maximum)
    number = v.type in ("double", "float", "int32") and v.kind == VariableKind.PARAMETER
    few = 1 <= v.length <= MOST_ELEMENTS
    return number and few and all(map(math.isfinite, ends)) and v.maximum > v.minimum


def elements(v: Variable) -> list[Variable]:
    """The elements of an array or a matrix as parameters of their own, ``K[1,2]``."""
    if v.length == 1:
        return [v]
    initial = np.ravel(v.initial).tolist() if v.initial is not None else [v.minimum]
    found = []
    for k in range(v.length):
        at = f"{k // v.columns},{k % v.columns}" if v.columns > 1 else str(k)
        first = initial[min(k, len(initial) - 1)]
        found.append(replace(v, name=f"{v.name}[{at}]", length=1, columns=1, initial=first))
    return found


def numbers(variables: Sequence[Variable], values: Mapping[str, Assignable]) -> dict[str, float]:
    """The values of all elements by name; those that the target does not send are left out."""
    return {
        part.name: value
        for v in variables
        if v.name in values
        for part, value in zip(elements(v), np.ravel(values[v.name]).tolist(), strict=True)
    }


class Slider(Widget, can_focus=True):
    """One parameter: name, bar, value. Arrows move it, the mouse sets and drags it."""

    DEFAULT_CSS = """
    Slider { height: 1; width: 100%; }
    Slider:focus { background: $boost; text-style: bold; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "app.focus_previous", "up"),  # here: the list would scroll, and no more
        Binding("down", "app.focus_next", "down"),
        Binding("left", f"move({-STEP})", "less"),
        Binding("right", f"move({STEP})", "more"),
        Binding("shift+left,pagedown", f"move({-COARSE})", "much less"),
        Binding("shift+right,pageup", f"move({COARSE})", "much more"),
        Binding("ctrl+left", f"move({-FINE})", "a little less"),
        Binding("ctrl+right", f"move({FINE})", "a little more"),
    ]

    class Moved(Message):
        """Another value was chosen."""

        def __init__(self, name: str, value: float | int) -> None:
            super().__init__()
            self.name, self.value = name, value

    def __init__(self, variable: Variable, value: Any) -> None:
        super().__init__()
        self.variable = variable
        self.range = Range(variable.minimum, variable.maximum, variable.type == "int32")
        self.value = float(value)

    def take(self, value: Any) -> None:
        """Show the value of the target."""
        if float(value) != self.value:
            self.value = float(value)
            self.refresh()

    def _set(self, value: float) -> None:
        if value != self.value:
            self.value = value
            self.refresh()
            given = int(value) if self.range.whole else value
            self.post_message(self.Moved(self.variable.name, given))

    def action_move(self, share: float) -> None:
        """Move by a fraction of the range; a whole number by at least one."""
        r = self.range
        step = share * (r.high - r.low)
        if r.whole:
            step = math.copysign(max(1.0, abs(round(step))), step)
        self._set(r.at(r.share(self.value + step)))

    @property
    def bar(self) -> int:
        """The number of columns of the bar."""
        return max(self.size.width - NAME - VALUE - 2, 4)

    def _by_mouse(self, x: int) -> None:
        self._set(self.range.at((x - NAME) / max(self.bar - 1, 1)))

    def on_mouse_down(self, event: events.MouseDown) -> None:
        if event.x >= NAME:
            self.capture_mouse()
            self._by_mouse(event.x)

    def on_mouse_move(self, event: events.MouseMove) -> None:
        if self.app.mouse_captured is self:
            self._by_mouse(event.x)

    def on_mouse_up(self, _: events.MouseUp) -> None:
        self.release_mouse()

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_move(STEP)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.action_move(-STEP)

    def render(self) -> Text:
        colours = self.app.theme_variables
        at = round(self.range.share(self.value) * (self.bar - 1))
        first = round(self.range.share(float(self.variable.initial)) * (self.bar - 1))
        text = Text(self.variable.name[: NAME - 1].ljust(NAME), no_wrap=True, overflow="crop")
        for k in range(self.bar):
            if k == at:
                text.append("█", Style(color=colours["accent"]))
            elif k == first:
                text.append("┼", Style(color=colours["foreground"]))
            else:
                text.append("━" if k < at else "─", Style(color=colours["border"]))
        text.append(f" {show_value(self.value)} {self.variable.unit}")
        return text


class Sliders(Dialog[None]):
    """Sliders of several parameters, at the edge of the screen so that the curves stay in sight.

    Parameters
    ----------
    values : callable
        Returns the newest values of the target by name.
    write : callable
        ``write(values)`` hands values on; called at most ten times a second.
    """

    DEFAULT_CSS = """
    Sliders { align: right bottom; background: transparent; }
    Sliders > .box { max-height: 60%; margin: 3 1 1 0; }
    Sliders VerticalScroll { height: auto; max-height: 100%; margin-bottom: 1; }
    Sliders .hint { dock: bottom; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("z", "undo", "back"),
        Binding("enter", "cancel", "close"),
    ]

    def __init__(
        self,
        variables: Sequence[Variable],
        values: Callable[[], Mapping[str, Assignable]],
        write: Callable[[Mapping[str, float], bool], None],
    ) -> None:
        super().__init__()
        self._write = write
        self._values: Callable[[], dict[str, float]] = lambda: numbers(variables, values())
        self._variables = tuple(part for v in variables for part in elements(v))
        now = self._values()
        self._before = {v.name: now.get(v.name, float(v.initial)) for v in self._variables}
        self._moved: dict[str, float] = {}  # not handed on yet
        self.before: dict[str, float] = {}  # of what was moved and is not back again
        self._quiet = 0  # ticks since something was handed on

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = "Sliders"
            with VerticalScroll(can_focus=False):
                for v in self._variables:
                    yield Slider(v, self._before[v.name])
            keys = "← → 0.5 %, shift 5 %, ctrl 0.05 %; ┼ initial; z as before; esc closes"
            yield Static(keys, classes="hint", markup=False)

    def on_mount(self) -> None:
        self.query(Slider).first().focus()
        self.set_interval(SEND_S, self._tick)

    def on_slider_moved(self, event: Slider.Moved) -> None:
        self._moved[event.name] = event.value
        self.before[event.name] = self._before[event.name]

    def _tick(self) -> None:
        """Write the sliders that have moved; where none moves, show the values of the target."""
        if self._moved:
            moved, self._moved, self._quiet = self._moved, {}, 0
            self._write(moved, False)
            return
        self._quiet += 1
        if self._quiet < QUIET:  # the target's word is on its way
            return
        now = self._values()
        for slider in self.query(Slider):
            if slider.variable.name in now:
                slider.take(now[slider.variable.name])

    def action_undo(self) -> None:
        """Restore the values that the parameters had when this opened, in one sample."""
        self._moved, self.before, self._quiet = {}, {}, 0
        for slider in self.query(Slider):
            slider.take(self._before[slider.variable.name])
        self._write(dict(self._before), True)

    def action_cancel(self) -> None:
        """Close; the last move is still written."""
        if self._moved:
            self._write(self._moved, False)
        self.dismiss(None)
