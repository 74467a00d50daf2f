"""Console: computed curves, the views of the scope, export and layouts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from textual import on

from zendsp.errors import ZendspError
from zendsp.tui.dialogs import Choose, Field, Form, Option, not_empty
from zendsp.tui.scope import Channel, Scale, Scope
from zendsp.tui.scope.export import Seen, check_name, export
from zendsp.tui.scope.formula import FUNCTIONS, Formula
from zendsp.tui.scope.layouts import Layout, layouts_folder, load_layout, save_layout
from zendsp.tui.scope.settings import MOST_CHANNELS
from zendsp.tui.screens.console_scope import ScopeActions, real
from zendsp.tui.workspace import file_name
from zendsp_protocol.texts import counted


def real_or_none(text: str) -> float | None:
    """The finite number in a text, None for an empty one."""
    return real(text) if text.strip() else None


class ViewActions(ScopeActions):
    """Actions on views, formulas, scales, files, layouts."""

    def action_view(self) -> None:
        """Go to the next view: over time, over the selected curve, over frequency."""
        self.scope.next_view()

    def action_formula(self) -> None:
        """Ask for the formula of a computed curve."""
        units = {name: unit for name, unit, _ in self.element_names()}
        if not units:
            self.say("no signals yet: build a program first (b)", "warning")
            return
        chosen = next(iter(self.scope.channels[self.scope.settings.selected :]), Channel(""))
        old = f"{chosen.name} [{chosen.unit}] = {chosen.formula}" if chosen.formula else ""

        def check(text: str) -> Formula | None:
            return Formula.read(text, units) if text.strip() or not old else None

        fields = [Field("formula", "name = expression", old, check=check, hint="e = r1 - q1")]
        text = (
            "Signals of the program, numbers, + - * / **, d(x) per second, lp(x, Hz),"
            f" {', '.join(FUNCTIONS[:-2])}. e [rad] = … states the unit."
        )

        def take(answer: Any) -> None:
            if answer:
                self._take_formula(answer["formula"], chosen if old else None)

        self.app.push_screen(Form("A computed curve", fields, text), take)

    def _take_formula(self, formula: Formula | None, old: Channel | None) -> None:
        """Show a computed curve in place of another, or as the last; or remove one."""
        channels = list(self.scope.channels)
        if formula is None:
            self.plot_channels([c for c in channels if c != old])
            return
        fresh = Channel(formula.name, formula.unit, formula.expression)
        places = [k for k, c in enumerate(channels) if c == old or c.name == fresh.name]
        if places:
            channels[places[0]] = fresh
        elif len(channels) < MOST_CHANNELS:
            channels.append(fresh)
        else:
            self.say(f"the scope shows {MOST_CHANNELS} curves already: take one away", "warning")
            return
        self.plot_channels(channels)

    @on(Scope.ScaleWanted)
    def action_scale(self) -> None:
        """Ask for the lane and the axis of the selected curve."""
        if not self.scope.channels:
            self.say("choose curves first (c)", "warning")
            return
        s = self.scope.settings
        channel = self.scope.channels[s.selected]
        scale = s.scales.get(channel.name, Scale())
        lanes = ["as the others", *(str(k) for k in range(1, MOST_CHANNELS + 1))]
        fields = [
            Field("lane", "Lane", lanes[scale.lane], choices=lanes),
            Field("low", "Bottom", "" if scale.low is None else f"{scale.low:g}",
                  channel.unit, real_or_none, hint="what is seen"),
            Field("high", "Top", "" if scale.high is None else f"{scale.high:g}",
                  channel.unit, real_or_none, hint="what is seen"),
        ]  # fmt: skip
        text = "Curves of one lane share an axis. An end that is left empty follows what is seen."

        def take(r: Any) -> None:
            if r:
                fresh = Scale(lanes.index(r["lane"]), r["low"], r["high"])
                low, high = fresh.low, fresh.high
                if low is not None and high is not None and low >= high:
                    self.say(f"{low:g} … {high:g} is no axis: bottom above top", "error")
                    return
                scales = {**self.scope.settings.scales, channel.name: fresh}
                scales = {name: scale for name, scale in scales.items() if scale != Scale()}
                self.scope.set(replace(self.scope.settings, scales=scales))

        self.app.push_screen(Form(f"Scale of {channel.name}", fields, text), take)

    def action_export(self) -> None:
        """Write the visible rows to a file."""
        if not self.scope.channels:
            self.say("choose curves first (c)", "warning")
            return
        t, y = self.scope.seen()
        s = self.scope.settings
        seen = Seen(self.scope.channels, t, y, s.view, s.selected)
        path = self.lab.workspace.free(self.lab.workspace.root, "scope", ".csv")
        fields = [Field("path", "File", path.name, check=check_name)]
        between = "between the cursors" if s.cursors else "in the picture"
        text = f"{len(t)} rows {between}. CSV, MAT … for rows; PNG, SVG, PDF for a picture."

        def take(r: Any) -> None:
            if r:
                self.run_worker(lambda: self._export(seen, r["path"]), thread=True)

        self.app.push_screen(Form("Export", fields, text, "Write"), take)

    def _export(self, seen: Seen, name: str) -> None:
        try:
            said, level = f"written: {export(seen, self.lab.workspace.root / name)}", "good"
        except ZendspError as error:
            said, level = str(error), "error"
        self.app.call_from_thread(self.say, said, level)

    def action_layouts(self) -> None:
        """Save or open a layout of the scope."""
        folder = layouts_folder()
        options = [Option("", "save this one …", counted(len(self.scope.channels), "curve"))]
        options += [Option(str(p), p.stem, "") for p in sorted(folder.glob("*.json"))]
        dialog = Choose("Layouts of the scope", options, text=str(folder))
        self.app.push_screen(dialog, lambda keys: self._layout(*keys) if keys else None)

    def _layout(self, key: str, typed: str = "") -> None:
        if key:
            try:
                layout = load_layout(Path(key))
            except ZendspError as error:
                self.say(str(error), "error")
                return
            lacking = self.plot_channels(layout.channels)
            last = max(len(self.scope.channels) - 1, 0)
            found = layout.settings
            self.scope.set(
                replace(found, selected=min(found.selected, last), source=min(found.source, last))
            )
            if lacking:
                self.say(f"not in this program: {', '.join(lacking)}", "warning")
            return
        form = Form("Save the layout", [Field("name", "Name", typed, check=not_empty)])
        self.app.push_screen(form, lambda r: self._save_layout(r["name"]) if r else None)

    def _save_layout(self, name: str) -> None:
        layout = Layout(self.scope.channels, self.scope.settings)
        try:
            path = save_layout(layout, layouts_folder() / f"{file_name(name)}.json")
        except ZendspError as error:
            self.say(str(error), "error")
        else:
            self.say(f"layout saved: {path}", "good")
