"""Execute: frequency responses and sweeps of the running program."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from textual import on
from textual.widgets import Button, DataTable

from zendsp.errors import ZendspError
from zendsp.tui.dialogs import Field, Form
from zendsp.tui.measure_job import MeasureJob
from zendsp.tui.panels.response import ResponseView
from zendsp.tui.panels.sweep import SweepView
from zendsp.tui.play_job import PlayJob, usual_channels
from zendsp.tui.port import Quantity, Swing, Tries
from zendsp.tui.runs import Outcome, Run, store_run
from zendsp.tui.screens.console_program import positive, whole
from zendsp.tui.screens.console_scope import real
from zendsp.tui.screens.execute_runs import RunActions
from zendsp.tui.snapshot import LinkState, Snapshot, Variable
from zendsp_protocol.states import ProgramState, VariableKind

if TYPE_CHECKING:
    from zendsp.experiment.response import FrequencyResponse
    from zendsp.experiment.sweep_result import Sweep
    from zendsp.tui.port import Port, Tell

MOVES = "Moves the machine; b ends it, F9 stops."
BODE = (
    "One joint swings about where it stands, by many sines at once. It is tried on a simulated"
    " twin, then takes (periods + 1.5) / from seconds."
)
SWEEP = (
    "The program goes on as it does now, so let it move; every combination is faded in over 1 s and"
    " measured, then the parameters go back. Values: Kp1=100,200 or FIRST:LAST:COUNT."
)


class MeasureActions(RunActions):
    """Actions that measure the machine, and their results."""

    def __init__(self) -> None:
        super().__init__()
        self.job: PlayJob | MeasureJob | None = None
        self._swing, self._tries = Swing(), Tries()  # last answers of the two forms

    # -- frequency response

    @on(Button.Pressed, "#run-bode")
    def action_respond(self) -> None:
        """Ask for the joint and the motion of a frequency response."""
        snapshot = self._ready_to_measure()
        if snapshot is None:
            return
        last = self._swing
        joints = max(snapshot.joints, 1)
        swings: list[Quantity] = ["position"]
        if any(v.name == "ref_tau" for v in snapshot.variables):
            swings.append("torque")
        quantity = last.quantity if last.quantity in swings else "position"
        fields = [
            Field("joint", "Joint", last.joint, f"1 … {joints}", lambda t: _up_to(t, joints)),
            Field("quantity", "What swings", quantity, choices=swings),
            Field("amplitude", "Peak", last.amplitude or "", "rad, N m", _or_usual,
                  hint=_usual(snapshot, swings)),
            Field("f_min", "From", last.f_min, "Hz", positive),
            Field("f_max", "To", last.f_max, "Hz", positive),
            Field("lines", "Frequencies at most", last.lines, "", whole),
            Field("periods", "Periods", last.periods, "", whole),
            Field("input", "Input", last.input, hint="else the reference, or torque"),
            Field("output", "Output", last.output, hint="else the position"),
        ]  # fmt: skip
        form = Form("Frequency response", fields, f"{BODE} {MOVES}", ok="Measure")
        self.app.push_screen(form, lambda r: self._respond(Swing(**r)) if r else None)

    def _respond(self, asked: Swing) -> None:
        self._swing = asked
        channels = usual_channels(self.lab.session.snapshot)
        runs = self.lab.workspace.runs
        name = f"bode joint {asked.joint}"

        def keep(found: FrequencyResponse) -> Run:
            sources = self.lab.source_texts()
            run = store_run(runs, name, found.recording, sources=sources, outcome=Outcome.RESPONSE)
            found.save(run.folder / "response.csv")  # for any other tool
            return run

        self._measure(
            MeasureJob(
                self.lab.session,
                "frequency response",
                lambda port, tell: port.respond(asked, channels, tell),
                keep,
            )
        )

    def show_responses(self, runs: Sequence[Run]) -> None:
        """Draw the frequency responses of these runs in one plot."""
        from zendsp.experiment.response import FrequencyResponse

        found = []
        for run in runs:
            try:
                response = FrequencyResponse.of(run.recording())
            except (ZendspError, OSError) as error:
                self.say(f"{run.name}: {error}", "error")
                continue
            if response is not None:
                found.append((run.name, 2 * self.marked_runs.index(run.folder) % 8, response))
        if found:
            self.query_one("#run-response", ResponseView).show(found)
            self.show_only("#run-response")

    # -- sweep

    @on(Button.Pressed, "#run-sweep-button")
    def action_sweep(self) -> None:
        """Ask for the parameters of a sweep and their values."""
        snapshot = self._ready_to_measure()
        if snapshot is None:
            return
        if snapshot.state != ProgramState.RUNNING:
            self.say("a sweep is of a program that runs: start it first (F2, s)", "warning")
            return
        last = self._tries
        parameters = [v for v in snapshot.variables if v.kind == VariableKind.PARAMETER]
        known, example = {v.name: v.length for v in parameters}, _example(parameters)
        errors = [c for c in usual_channels(snapshot) if c.rstrip("0123456789") == "e"]
        fields = [
            Field("words", "Parameters", last.words, hint=example,
                  check=lambda text: _parameters(text, known, example)),
            Field("channels", "Measured of", last.channels or " ".join(errors), check=_words),
            Field("measures", "Measures", last.measures, check=_words,
                  hint="rms max mean std p2p"),
            Field("seconds", "Measured for", last.seconds, "s", positive),
            Field("settle", "Left out before", last.settle, "s", _from_zero),
            Field("together", "Not all combinations", last.together),
        ]  # fmt: skip
        form = Form("Sweep", fields, f"{SWEEP} {MOVES}", ok="Measure")
        self.app.push_screen(form, lambda r: self._sweep(Tries(**r)) if r else None)

    def _sweep(self, asked: Tries) -> None:
        self._tries = asked
        from zendsp.experiment.sweep import announced, tried_of

        tried = tried_of(asked.words.split())
        try:
            self.say(announced(tried, asked.seconds, asked.settle, asked.together))
        except ZendspError as error:
            self.say(str(error), "error")
            return
        workspace = self.lab.workspace

        def keep(found: Sweep) -> tuple[Sweep, Path]:
            stem = f"{time.strftime('%Y%m%d-%H%M%S')}-{'-'.join(found.parameters)}"
            return found, found.save(workspace.free(workspace.sweeps, stem, ".csv"))

        def measure(port: Port, tell: Tell) -> Sweep:
            return port.sweep(asked, reached, tell)

        def reached(found: Sweep) -> None:
            job.reached = found

        job = MeasureJob(self.lab.session, "sweep", measure, keep)
        self._measure(job)

    @on(DataTable.RowSelected, "#sweep")
    def _use_row(self, event: DataTable.RowSelected) -> None:
        """Fade the program to the values of a row."""
        from zendsp.experiment.sweep_result import short

        values = self.query_one(SweepView).values(event.cursor_row)
        words = ", ".join(f"{name} = {short(value, 6)}" for name, value in values.items())
        self.lab.session.do("sweep", lambda port: port.fade(values)).add_done_callback(
            lambda done: None if done.exception() else self.lab.session.events.add(words, "good")
        )
        self.lab.toast(words)

    # -- both

    def _ready_to_measure(self) -> Snapshot | None:
        """The snapshot; None after saying why nothing can be measured now."""
        snapshot = self.lab.session.snapshot
        if self.job is not None and self.job.busy:
            self.say("a run is in progress: abort it with b", "warning")
        elif snapshot.link != LinkState.UP:
            self.say("no link to a target: Ctrl+O chooses one", "warning")
        elif snapshot.state not in (ProgramState.LOADED, ProgramState.PAUSED, ProgramState.RUNNING):
            self.say("no program is loaded: build one on Console (F2, b)", "warning")
        else:
            return snapshot
        return None

    def _measure(self, job: MeasureJob) -> None:
        self.follow_live(self.lab.session.snapshot)
        self.job = job
        job.start()

    def measured(self, job: MeasureJob) -> None:
        """Show the result of a measurement."""
        error = job.result.exception()
        found = job.result.result() if error is None else job.left
        if error is not None:
            self.lab.toast(f"{job.label}: {error}", "error")  # the job has put it into the log
        if error is not None and found is None:
            self.preview()
        elif found is None:
            self.say(f"{job.label} aborted; nothing is kept", "warning")
            self.preview()
        elif isinstance(found, Run):
            self.marked_runs = [found.folder]
            self.fill_runs(found.folder)
            self.preview()
            self.say(f"{job.label}: {found.name} is kept as a run", "good")
        else:
            swept, path = found
            self.query_one(SweepView).show(swept)
            self.show_only("#run-sweep")
            self.query_one("#sweep", DataTable).focus()
            self.say(f"{repr(swept)[1:-1]}; {path}", "info" if error else "good")

    def show_only(self, widget: str) -> None:
        """Show one of the widgets of the right side."""
        for child in self.query_one("#show").children:
            child.display = f"#{child.id}" == widget

    def follow_live(self, snapshot: Snapshot) -> None:
        """Follow the run's channels live; the screen overrides this."""
        raise NotImplementedError


def _or_usual(text: str) -> float | None:
    return positive(text) if text.strip() else None


def _usual(s: Snapshot, swings: Sequence[Quantity]) -> str:
    """The amplitude that is used where none is typed, in words."""
    from zendsp.experiment.frequency import usual_amplitude

    if s.described is None or s.limits is None:
        return "else by the machine"
    peaks = []
    for quantity in swings:
        try:
            peak, unit = usual_amplitude(s.described, s.limits, 1, quantity)
        except ZendspError:
            continue
        peaks.append(f"{peak:g} {unit}")
    of = "joint 1: " if s.joints > 1 else ""
    return f"else by the machine, {of}{' or '.join(peaks)}"


def _words(text: str) -> str:
    if not text.split():
        raise ValueError("name at least one")
    return text.replace(",", " ")


def _up_to(text: str, most: int) -> int:
    value = whole(text)
    if value > most:
        raise ValueError(f"{value}: the machine has {most}, counted from 1")
    return value


def _from_zero(text: str) -> float:
    value = real(text)
    return value if value == 0.0 else positive(text)


def _example(parameters: Sequence[Variable]) -> str:
    """Values for the first gain of the program, from half of it to twice as much."""
    numbers = [v for v in parameters if v.length == 1 and v.type == "double" and v.initial]
    gains = [v for v in numbers if v.name[:1] in "kK"]
    if not gains:
        return "Kp1=500:2500:5 Kd1=60,120"
    value = float(np.asarray(gains[0].initial))
    return f"{gains[0].name}={value / 2:.4g}:{2 * value:.4g}:4"


def _parameters(text: str, known: Mapping[str, int], example: str) -> str:
    from zendsp.experiment.sweep import tried_of

    if not text.split():
        raise ValueError(f"for example {example}")
    try:
        tried = tried_of(text.split())
    except ZendspError as error:
        raise ValueError(str(error)) from error
    for name in tried:
        if known.get(name, 1) > 1:
            raise ValueError(f"{name} has {known[name]} elements: only a single number is swept")
        if name not in known:
            raise ValueError(f"the program has no {name}: it has {', '.join(known)}")
    return text
