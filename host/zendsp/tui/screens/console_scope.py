"""Console: the keys of the scope."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from textual import events

from zendsp.tui.dialogs import Choose, Field, Form, Option
from zendsp.tui.scope import Channel, Scope
from zendsp.tui.scope.formula import sources
from zendsp.tui.scope.picture import arrange
from zendsp.tui.scope.settings import LANES, MOST_CHANNELS
from zendsp.tui.screens.base import LabScreen
from zendsp_protocol.states import VariableKind
from zendsp_protocol.texts import counted, number_hint, units_of


def real(text: str) -> float:
    """The finite number in a text."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number{number_hint(text)}") from None
    if value != value or abs(value) == float("inf"):
        raise ValueError("must be finite")
    return value


def percent(text: str) -> float:
    """The fraction that a text gives in per cent, 0 … 100."""
    value = real(text)
    if not 0.0 <= value <= 100.0:
        raise ValueError(f"{value:g} is outside 0 … 100")
    return value


class ScopeActions(LabScreen):
    """Actions on channels, modes, cursors and time."""

    @property
    def scope(self) -> Scope:
        """The scope of this screen."""
        return self.query_one("#scope", Scope)

    def element_names(self) -> list[tuple[str, str, str]]:
        """Every possible curve: name, unit, description."""
        found = []
        for v in self.lab.session.snapshot.variables:
            if v.kind == VariableKind.TABLE:
                continue
            if v.length == 1:
                found.append((v.name, v.unit, v.description))
            else:
                found += [
                    (f"{v.name}[{k}]", unit, v.description)
                    for k, unit in enumerate(units_of(v.unit, v.length))
                ]
        return found

    def plot_names(self, names: Sequence[str]) -> None:
        """Show these curves, at most eight; names that the program lacks are left out."""
        units = {name: unit for name, unit, _ in self.element_names()}
        computed = {c.name: c for c in self.scope.channels if c.formula}
        self.plot_channels([computed.get(n) or Channel(n, units.get(n, "")) for n in names])

    def plot_channels(self, channels: Sequence[Channel]) -> list[str]:
        """Show these curves and return those that the program lacks. Curves that were shown before
        keep their rows.
        """
        known = {name for name, _, _ in self.element_names()}
        shown = [c for c in channels if known.issuperset(sources([c]))][:MOST_CHANNELS]
        before = list(self.scope.channels)
        columns = [before.index(c) if c in before else -1 for c in shown]
        kept = self.scope.history.chosen(columns) if max(columns, default=-1) >= 0 else None
        self.scope.show_channels(shown, self.lab.session.watch(shown, kept))
        return [c.name for c in channels if c not in shown]

    def action_channels(self) -> None:
        """Choose curves."""
        options = [
            Option(name, name, f"{unit:<8} {text}") for name, unit, text in self.element_names()
        ]
        if not options:
            self.say("no signals yet: build a program first (b)", "warning")
            return
        options += [Option(c.name, c.name, f"= {c.formula}") for c in self.computed()]
        marked = [c.name for c in self.scope.channels]
        dialog = Choose(
            "Curves of the scope", options, several=True, marked=marked, most=MOST_CHANNELS
        )
        self.app.push_screen(
            dialog, lambda keys: self.plot_names(keys) if keys is not None else None
        )

    def computed(self) -> list[Channel]:
        """The curves that are computed."""
        return [c for c in self.scope.channels if c.formula]

    def toggle_plot(self, name: str) -> None:
        """Add a variable with all its elements to the scope, or remove it."""
        mine = [n for n, _, _ in self.element_names() if n == name or n.startswith(f"{name}[")]
        have = [c.name for c in self.scope.channels]
        if any(n in have for n in mine):
            self.plot_names([n for n in have if n not in mine])
        elif len(have) + 1 > MOST_CHANNELS:
            self.say(
                f"the scope shows {MOST_CHANNELS} curves already: take one away first", "warning"
            )
        else:
            free = MOST_CHANNELS - len(have)
            if len(mine) > free:
                self.say(
                    f"{name} has {counted(len(mine), 'curve')}, {free} of {MOST_CHANNELS} are free:"
                    f" {', '.join(mine[free:])} {'are' if len(mine) > free + 1 else 'is'} left out;"
                    " c chooses",
                    "warning",
                )
            self.plot_names([*have, *mine])

    def action_mode(self) -> None:
        """Switch between roll and trigger mode."""
        s = self.scope.settings
        self.scope.single = False
        self.scope.set(replace(s, mode="trigger" if s.mode == "roll" else "roll"))
        if self.scope.paused:
            self.scope.pause(False)

    def action_trigger(self) -> None:
        """Ask for the trigger's source, level and edge."""
        names = [c.name for c in self.scope.channels]
        if not names:
            self.say("choose curves first (c): the trigger watches one of them", "warning")
            return
        s = self.scope.settings
        fields = [
            Field("source", "Source", names[s.source], choices=names),
            Field(
                "level", "Level", f"{s.level:g}", unit=self.scope.channels[s.source].unit,
                check=real,
            ),
            Field("edge", "Edge", s.edge, choices=("rising", "falling", "both")),
            Field("pre", "Before the trigger", f"{100.0 * s.pre:g}", unit="%", check=percent),
        ]

        def take(result: Any) -> None:
            if result:
                source = names.index(result["source"])
                self.scope.set(
                    replace(
                        s, mode="trigger", source=source, level=result["level"],
                        edge=result["edge"], pre=result["pre"] / 100.0,
                    )
                )

        self.app.push_screen(Form("Trigger", fields), take)

    def action_single(self) -> None:
        """Wait for one trigger, then freeze."""
        self.scope.pause(False)
        self.scope.arm_single()

    def action_freeze(self) -> None:
        """Freeze the picture, or let it run again."""
        self.scope.pause(not self.scope.paused)

    def action_autoscale(self) -> None:
        """Fit the axes; pressed again, keep them fixed."""
        s = self.scope.settings
        self.scope.set(replace(s, auto=not s.auto))
        self.scope.autoscale()

    def action_lanes(self) -> None:
        """Switch between a lane for each unit, a lane for each curve, and one for all."""
        s = self.scope.settings
        s = replace(s, lanes=LANES[(LANES.index(s.lanes) + 1) % len(LANES)])
        self.scope.set(s)
        if self.scope.picture is None or not self.scope.channels:
            return
        height = len(self.scope.picture.codes)
        lanes = arrange(self.scope.channels, s, height)
        said = "over one another" if s.lanes == "over" else f"a lane for each {s.lanes}"
        if len(lanes) > 1 and lanes[0].row == lanes[1].row:
            if s.lanes != "over":
                said += f": no room for {len(lanes)}, so over one another"
            chosen = self.scope.channels[s.selected].name
            said += f": the axis is that of {chosen}, y chooses another"
        self.lab.toast(said)
        self.say(f"scope: {said}")

    def action_cursors(self) -> None:
        """Show or hide the cursors."""
        self.scope.set(replace(self.scope.settings, cursors=not self.scope.settings.cursors))
        self.scope.focus()

    def action_swap_cursor(self) -> None:
        """Let the arrows move the other cursor."""
        s = self.scope.settings
        self.scope.set(replace(s, cursors=True, active="b" if s.active == "a" else "a"))
        self.scope.focus()

    def action_next_curve(self) -> None:
        """Select the next curve."""
        if self.scope.channels:
            s = self.scope.settings
            self.scope.set(replace(s, selected=(s.selected + 1) % len(self.scope.channels)))

    def action_zoom(self, steps: int) -> None:
        """Change the time across the picture."""
        self.scope.zoom(steps)

    def action_pan(self, share: float) -> None:
        """Move through the history."""
        self.scope.pan(share)

    def on_key(self, event: events.Key) -> None:
        """Arrow keys while the scope has the focus: they move the cursors if these are shown, else
        through the history, or the trigger level.
        """
        scope = self.scope
        if not scope.has_focus or event.key not in ("left", "right", "up", "down"):
            return
        event.stop()
        s = scope.settings
        sign = 1.0 if event.key in ("right", "up") else -1.0
        if event.key in ("left", "right"):
            if s.cursors:
                scope.move_cursor(sign * 0.01)
            else:
                scope.pan(-0.1 * sign)
        elif s.mode == "trigger" and scope.picture is not None:
            for lane in scope.picture.lanes:
                if s.source in lane.channels:
                    scope.set(replace(s, level=s.level + sign * (lane.top - lane.bottom) / 40.0))
