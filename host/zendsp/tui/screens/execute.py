"""Execute: plays planned references, stores each run with everything needed to repeat it, compares
runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from rich.style import Style
from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical
from textual.widgets import Button, DataTable, Static

from zendsp.errors import ZendspError
from zendsp.reference import Reference, load_reference
from zendsp.tui.actions import bindings
from zendsp.tui.dialogs import Choose, Field, Form, Option
from zendsp.tui.measure_job import MeasureJob
from zendsp.tui.panels.response import ResponseView
from zendsp.tui.panels.sweep import SweepView
from zendsp.tui.panels.table import ListTable
from zendsp.tui.play_job import PlayJob, usual_channels
from zendsp.tui.playing import Setup
from zendsp.tui.preflight import Condition, machine_of, preflight
from zendsp.tui.preview import columns_of, curves_of, limits_of, views_of
from zendsp.tui.runs import Outcome
from zendsp.tui.scope import Channel, Scope
from zendsp.tui.screens.analysis import existing
from zendsp.tui.screens.console_program import positive, whole
from zendsp.tui.screens.console_scope import percent, real
from zendsp.tui.screens.execute_measure import MeasureActions
from zendsp.tui.screens.execute_runs import shorten, signals_to_show
from zendsp.tui.snapshot import Snapshot
from zendsp.tui.trial import Trial
from zendsp_protocol.states import VariableKind
from zendsp_protocol.texts import units_of

LOOK_S = 0.5  # between looks at the conditions, where nothing told that they changed


class ExecuteScreen(MeasureActions):
    """Plan and runs on the left, curves on the right."""

    NAME: ClassVar[str] = "execute"
    BINDINGS = bindings("execute")

    def __init__(self) -> None:
        super().__init__()
        self.setup = Setup()
        self.files: tuple[Path, ...] = ()
        self.references: tuple[Reference, ...] = ()
        self.conditions: list[Condition] = []
        self.trial = Trial()
        self._looked = 0
        self._checked: object = None

    # -- layout

    def body(self) -> ComposeResult:
        with Container(id="execute-body"):
            with Vertical(id="plan"):
                with Vertical(id="plan-box", classes="panel") as box:
                    box.border_title = "Next run"
                    yield Static("", id="setup", markup=False)
                    with Horizontal(classes="line"):
                        yield Button(
                            "Start s", id="run-start", variant="success", compact=True,
                            disabled=True,
                        )
                        yield Button(
                            "Abort b", id="run-abort", variant="warning", compact=True,
                            disabled=True,
                        )
                        yield Button("Bode f", id="run-bode", compact=True)
                        yield Button("Sweep p", id="run-sweep-button", compact=True)
                    yield Static("", id="progress", markup=False)
                    yield Static("", id="preflight", markup=False)
                with Vertical(id="runs-box", classes="panel") as box:
                    box.border_title = "Runs"
                    yield ListTable(id="runs", cursor_type="row")
            with Vertical(id="show", classes="panel"):
                yield Scope(id="run-preview", live=False)
                yield Scope(id="run-live")
                yield ResponseView(id="run-response")
                yield SweepView(id="run-sweep")

    def ready(self) -> None:
        self.query_one("#progress").display = False  # no line of its own before there is any
        self.query_one("#run-preview", Scope).empty_text = ""  # until it is known what comes next
        self.fill_runs()
        self.preview()
        self.query_one("#runs", DataTable).focus()

    # -- what is shown

    def pull(self, snapshot: Snapshot, fresh: bool) -> None:
        """Show a snapshot."""
        if self.lab.chosen != self.files:
            self.files = self.lab.chosen
            self._load()
        self._looked += 1
        busy = self.job is not None and self.job.busy
        key = (
            snapshot.link, snapshot.state, snapshot.drive, snapshot.program, snapshot.machine,
            snapshot.mine, snapshot.trip, snapshot.commander, self.references, self.setup, busy,
            self.app.theme, self.size, self.has_class("-narrow"),
        )
        frames = max(1, round(LOOK_S / self.lab.frame_s))
        if key != self._checked or (self._looked % frames == 0 and not busy):
            self._checked = key
            self.conditions = self.look(snapshot)
            self._paint(busy)
        if self.job is not None:
            self._follow(self.job, busy)

    def _paint(self, busy: bool) -> None:
        c = self.app.theme_variables
        s = self.setup
        text = Text(no_wrap=True, overflow="ellipsis")
        names = ", ".join(f.stem for f in self.files) or "none"
        for label, value in (
            ("reference", f"{names}{f' × {s.cycles}' if s.cycles > 1 else ''}"),
            (
                "moves",
                (
                    f"{'pre-position' if s.preposition else 'from here'},"
                    f" {'home after' if s.go_home else 'stay'}, {100 * s.share:g} % speed"
                ),
            ),
            ("acquire", self._acquire_words()),
            ("note", s.note or "—"),
        ):
            text.append(f"{label:<11}", Style(dim=True))
            text.append(f"{value}\n")
        text.rstrip()
        self.query_one("#setup", Static).update(text)
        unmet = [x for x in self.conditions if not x.met]
        room = 3 if self.has_class("-narrow") else 20
        lines = Text()
        seen = [x for x in self.conditions if x.met and x.warning]
        plain = [x for x in self.conditions if x.met and not x.warning]
        for x in [*unmet, *seen, *plain][:room]:
            sign, colour = ("✔", "success") if x.met else ("✖", "error")
            if x.warning:
                sign, colour = "!", "warning"
            lines.append(f"{sign} ", Style(color=c[colour], bold=True))
            lines.append(x.text, Style(color=c[colour] if x.warning else None, bold=not x.met))
            if not x.met and x.advice:
                lines.append(f": {x.advice}", Style(color=c["warning"]))
            lines.append("\n")
        lines.rstrip()
        self.query_one("#preflight", Static).update(lines)
        self.query_one("#run-start", Button).disabled = bool(unmet)
        self.query_one("#run-abort", Button).disabled = not busy

    def _acquire_words(self) -> str:
        s = self.setup
        if not s.acquire:
            return "off"
        channels = (
            ", ".join(s.channels or usual_channels(self.lab.session.snapshot))
            or "the usual signals"
        )
        return (
            f"{channels}{f', every {s.decimation}.' if s.decimation > 1 else ''}{f', on {s.trigger}' if s.trigger else ''}"  # noqa: E501
        )

    def _load(self) -> None:
        """Read the chosen references and show them with the limits."""
        found = []
        for path in self.files:
            try:
                found.append(load_reference(path))
            except (ZendspError, OSError) as error:
                self.say(f"{path.name}: {error}", "error")
        self.references = tuple(found)
        self.marked_runs = []
        self.preview()

    def preview(self) -> None:
        """Show the first chosen reference, or the overlaid runs."""
        scope = self.query_one("#run-preview", Scope)
        self.show_only("#run-preview")
        if self.marked_runs:
            self.show_overlay(scope)
        elif self.references:
            reference = self.references[0]
            machine = machine_of(self.lab.session.snapshot)
            if machine is not None and machine.joints == reference.joints:
                columns = columns_of(machine, reference, machine.torque(reference))
                curves_of(scope, columns, reference, views_of(columns, tall=not self.small)[0])
                scope.limits = limits_of(machine)
            else:
                curves_of(scope, columns_of(None, reference, None), reference, "position")
                scope.limits = {}
        scope.redraw()
        self.run_worker(self._what_next, thread=True, exclusive=True, group="hint")

    def _what_next(self) -> None:
        """Find what to do next, and show it where no curves are shown; on a thread, since files are
        read.
        """
        any_planned = self.lab.workspace.has_references()

        def show() -> None:
            looks = "space shows the marked run" if self.runs else ""
            planned = "o chooses a planned reference" if any_planned else ""
            scope = self.query_one("#run-preview", Scope)
            words = (planned or "plan a motion on Reference (F4)", looks)
            scope.empty_text = "; ".join(x for x in words if x)
            scope.redraw()

        self.call_later(show)

    def look(self, snapshot: Snapshot) -> list[Condition]:
        """The present conditions of Start."""
        busy = self.job is not None and self.job.busy
        return preflight(
            snapshot, self.references, self.files, self.setup, busy, self.trial,
            self.lab.session.port,
        )

    # -- the run

    @on(Button.Pressed, "#run-start")
    def action_start(self) -> None:
        """Start, if every condition holds."""
        snapshot = self.lab.session.snapshot
        self.conditions = self.look(snapshot)
        unmet = [x for x in self.conditions if not x.met]
        machine = machine_of(snapshot)
        if unmet or machine is None:
            self.say(
                (
                    f"cannot start: {unmet[0].text}: {unmet[0].advice}"
                    if unmet
                    else "cannot start: unknown machine"
                ),
                "warning",
            )
            return
        self.follow_live(snapshot)
        self.job = PlayJob(
            self.lab.session, self.references, self.files, machine, self.setup,
            self.lab.workspace.runs, self.lab.source_texts(), self.trial,
        )
        self.job.start()

    def follow_live(self, snapshot: Snapshot) -> None:
        """Follow the run's channels live."""
        units = {v.name: (v.unit, v.length) for v in snapshot.variables}
        channels: list[Channel] = []
        names = tuple(self.setup.channels or usual_channels(snapshot))
        for name in signals_to_show(names) if self.small else names:
            unit, length = units.get(name.split("[")[0], ("", 1))
            one = length == 1 or "[" in name
            channels += (
                [Channel(name, unit)]
                if one
                else [Channel(f"{name}[{k}]", u) for k, u in enumerate(units_of(unit, length))]
            )
        live = self.query_one("#run-live", Scope)
        live.show_channels(channels[:8], self.lab.session.watch(channels[:8]))
        live.set(replace(live.settings, window=10.0))
        self.show_only("#run-live")

    @on(DataTable.RowHighlighted, "#runs")
    def _tell_outcome(self) -> None:
        """Show the outcome of the marked run in full, for which the list has no room."""
        run, shown = self.this_run(), self.query_one("#progress", Static)
        if run is not None and self.job is None:
            words = f"{run.name}: {run.ending}"
            several = len(run.errors) > 1 and not self.has_class("-narrow")
            if several:
                words += f"; rms {', '.join(f'{name} {run.rms(name)}' for name in run.errors)}"
            shown.update(Text(words, Style(dim=True), no_wrap=not several, overflow="ellipsis"))
            shown.display = several or bool(run.why) or shorten(run.name) != run.name

    @on(Button.Pressed, "#run-abort")
    def action_abort(self) -> None:
        """Bring the run to rest."""
        if self.job is not None and self.job.busy:
            self.job.abort()
            self.say("aborting: soft stop", "warning")
        else:
            self.say("no run is in progress")

    def _follow(self, job: PlayJob | MeasureJob, busy: bool) -> None:
        p, shown = job.progress, self.query_one("#progress", Static)
        shown.display = True
        if p.why and not busy:  # until something else is begun: a message goes after some seconds
            colour = self.app.theme_variables["error"]
            shown.update(Text(f"{job.label}: {p.why}", Style(color=colour)))
            self._finished(job)
            return
        width = max(shown.size.width - 32, 4)
        done = round(p.share * width)
        c = self.app.theme_variables
        text = Text(no_wrap=True, overflow="ellipsis")
        text.append("━" * done, Style(color=c["success"]))
        text.append("─" * (width - done), Style(dim=True))
        text.append(f" {100 * p.share:3.0f} % {p.phase}", Style(bold=True))
        shown.update(text, layout=False)
        if not busy:
            self._finished(job)

    def _finished(self, job: PlayJob | MeasureJob) -> None:
        self.job = None
        if isinstance(job, MeasureJob):
            self.measured(job)
            return
        error = job.result.exception()
        if error is not None:
            self.say(f"run failed: {error}", "error")
            return
        run = job.result.result()
        if run is None:
            self.say("run complete, nothing acquired", "good")
            return
        figures = ", ".join(f"{name} {run.rms(name)}" for name in run.errors)  # of all joints
        self.say(
            f"run {run.ending}: {run.rows} rows, {run.lost}"
            f" lost{f'; rms of {figures}' if figures else ''}",
            "good" if run.outcome == Outcome.COMPLETE else "warning",
        )
        self.fill_runs(run.folder)
        self.lab.run_made(run)

    # -- choosing

    def action_choose(self) -> None:
        """Choose references."""
        options = [
            Option(str(p), p.stem, p.parent.name) for p in self.lab.workspace.saved_references()
        ]
        options.append(Option("", "another file …", "its path is asked for"))
        marked = [str(p) for p in self.files]
        title = "References, played in the order of marking"
        text = f"Those in {self.lab.workspace.root} and a folder below; F4 plans others."
        self.app.push_screen(
            Choose(title, options, several=True, marked=marked, text=text), self._chosen
        )

    def _chosen(self, keys: Sequence[str] | None) -> None:
        if keys is not None and "" not in keys:
            self.lab.chosen = tuple(Path(k) for k in keys)
        elif keys:
            form = Form("Reference", [Field("path", "File", "", check=existing)])
            self.app.push_screen(form, lambda r: self._chosen([r["path"]]) if r else None)

    def action_cyclic(self) -> None:
        """Ask how many times to play."""
        if self.setup.cycles > 1:
            self.setup = replace(self.setup, cycles=1)
            return
        form = Form(
            "Cyclic",
            [Field("cycles", "Cycles", "3", check=whole)],
            "Again and again, joined by smooth moves where the ends differ.",
        )
        self.app.push_screen(form, lambda r: self._set(cycles=r["cycles"]) if r else None)

    def _set(self, **values: Any) -> None:
        self.setup = replace(self.setup, **values)

    def action_note(self) -> None:
        """Ask for name and note."""
        fields = [
            Field("name", "Name", self.setup.name, hint="name of the reference"),
            Field("note", "Note", self.setup.note),
        ]
        self.app.push_screen(
            Form("Name and note of the run", fields), lambda r: self._set(**r) if r else None
        )

    def action_settings(self) -> None:
        """Ask for the other settings of a run."""
        s = self.setup
        sources = [
            "none",
            *(
                v.name
                for v in self.lab.session.snapshot.variables
                if v.kind == VariableKind.SIGNAL and v.length == 1
            ),
        ]
        fields = [
            Field("preposition", "Pre-position first", s.preposition),
            Field("go_home", "Go home after", s.go_home),
            Field("share", "Speed of these", f"{100 * s.share:g}", "% of limit", percent),
            Field("acquire", "Acquire", s.acquire),
            Field(
                "channels",
                "Channels",
                " ".join(s.channels),
                check=lambda t: tuple(t.replace(",", " ").split()),
                hint="the usual ones",
            ),
            Field("decimation", "Every … sample", str(s.decimation), "", whole),
            Field("trigger", "Trigger on", s.trigger or "none", choices=sources),
            Field("level", "Level", f"{s.level:g}", "", real),
            Field("edge", "Edge", s.edge, choices=("rising", "falling", "both")),
            Field(
                "pre_s",
                "Before the trigger",
                f"{s.pre_s:g}",
                "s",
                lambda t: 0.0 if real(t) == 0.0 else positive(t),
            ),
        ]

        def take(r: Any) -> None:
            if r:
                share = max(r["share"], 1.0) / 100.0
                self._set(
                    **{
                        **r,
                        "share": share,
                        "trigger": "" if r["trigger"] == "none" else r["trigger"],
                    }
                )

        self.app.push_screen(Form("Moves and acquisition", fields), take)
