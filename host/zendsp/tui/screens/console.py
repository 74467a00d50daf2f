"""Console: tune, watch and drive the machine."""

from __future__ import annotations

from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.containers import Container, Vertical

from zendsp.tui.actions import bindings
from zendsp.tui.panels.drive import DrivePanel
from zendsp.tui.panels.events import EventsPanel
from zendsp.tui.panels.variables import VariablesPanel
from zendsp.tui.scope import NO_CHANNELS, Scope
from zendsp.tui.scope.formula import sources
from zendsp.tui.screens.analysis import AnalysisActions
from zendsp.tui.screens.console_program import ProgramActions
from zendsp.tui.screens.console_variables import VariableActions
from zendsp.tui.screens.console_view import ViewActions
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp_protocol.states import ProgramState

FIRST_CURVES = ("q", "tau", "e", "u", "aout")  # shown first if the program has them


class ConsoleScreen(ViewActions, VariableActions, ProgramActions, AnalysisActions):
    """Scope and events on the left, drives and variables on the right; on a small terminal one
    below the other.
    """

    NAME: ClassVar[str] = "console"
    BINDINGS = bindings("console")

    def __init__(self) -> None:
        super().__init__()
        self._program = ""

    def body(self) -> ComposeResult:
        with Container(id="console-body"):
            with Vertical(id="left"):
                with Vertical(id="scope-box", classes="panel") as box:
                    box.border_title = "Scope"
                    yield Scope(id="scope")
                events = EventsPanel(id="events-box")
                events.add_class("panel")
                yield events
            with Vertical(id="right"):
                drive = DrivePanel(id="drive-box")
                drive.add_class("panel")
                yield drive
                variables = VariablesPanel(id="variables-box")
                variables.add_class("panel")
                yield variables

    def ready(self) -> None:
        self.variables.table.focus()

    def pull(self, snapshot: Snapshot, fresh: bool) -> None:
        """Show a snapshot."""
        self.query_one(EventsPanel).show(self.lab.session.events)
        if not fresh:
            return
        self.query_one(DrivePanel).show(snapshot)
        if self.scope.empty_text != (text := self._what_first(snapshot)):
            self.scope.empty_text = text
            self.scope.redraw()
        plotted = [c.name for c in self.scope.channels]
        self.variables.show(snapshot, self.staged, plotted)
        if snapshot.program != self._program and snapshot.variables:
            self._program = snapshot.program
            self._new_program(plotted)

    def _what_first(self, snapshot: Snapshot) -> str:
        """A hint on what to do first, where no curves are shown."""
        if snapshot.link != LinkState.UP:
            return "no target: Ctrl+O chooses one, or starts a simulated machine"
        if snapshot.state != ProgramState.EMPTY:
            return NO_CHANNELS
        source = self.lab.source
        what = f"builds {source.name}" if source else "chooses a program and builds it"
        return f"no program is loaded: b {what}"

    def _new_program(self, plotted: list[str]) -> None:
        """Keep the curves that the new program still has; show the usual ones where there were
        none.
        """
        names = [name for name, _, _ in self.element_names()]
        computed = {c.name: sources([c]) for c in self.computed()}
        keep = [
            name
            for name in plotted or self.lab.channels
            if set(names).issuperset(computed.get(name, [name]))
        ]
        gone = [name for name in plotted if name not in keep]
        if gone:
            self.say(f"no longer shown, this program has not: {', '.join(gone)}", "warning")
        if not keep:
            usual = [
                n
                for first in FIRST_CURVES
                for n in names
                if n == first or n.startswith(f"{first}[")
            ]
            keep = usual[: 4 if self.has_class("-narrow") else 6]
        # the past of the program before is none of this one
        self.scope.show_channels(self.scope.channels)
        self.plot_names(keep)

    def curve_names(self) -> list[str]:
        """The variables that the scope draws."""
        return sources(self.scope.channels)

    def action_plot(self) -> None:
        """Show the marked variable, or remove it."""
        name = self.variables.marked
        if name:
            self.toggle_plot(name)
            self._pulled = None

    def action_filter(self) -> None:
        """Filter the table."""
        self.lab.expect_dialog()
        self.variables.open_filter()

    def on_descendant_focus(self, event: events.DescendantFocus) -> None:
        """Give the filter line the keys that were typed before it was there."""
        if event.widget.id == "filter":
            self.app.call_later(self.lab.hand_over)

    def action_events(self) -> None:
        """Show events in place of the variables on a small terminal."""
        self.toggle_class("-events")
        # what is hidden loses the focus; give it to what is seen, so that the arrows go on working
        self.call_after_refresh(
            self.query_one(EventsPanel).focus
            if self.has_class("-events")
            else self.variables.table.focus
        )
