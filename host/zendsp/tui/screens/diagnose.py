"""Diagnose: which physics does the model lack that the recordings show, and what to do about it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from rich.style import Style
from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, DataTable, OptionList, Static
from textual.widgets.option_list import Option

from zendsp.physics.files.questions import open_questions
from zendsp.tui.actions import bindings
from zendsp.tui.command import INTERRUPTED, Command
from zendsp.tui.diagnoses import Diagnosed, begin, keep, list_diagnoses, recording_name
from zendsp.tui.dialogs import Choose
from zendsp.tui.dialogs import Option as Line
from zendsp.tui.panels.figure import FigureView
from zendsp.tui.panels.findings import LOOP, Hanging, entries, headline, unseen
from zendsp.tui.panels.table import ListTable
from zendsp.tui.runs import DATA, Run
from zendsp.tui.scope import Scope
from zendsp.tui.screens.diagnose_given import NOTHING, GivenActions
from zendsp.tui.screens.diagnose_loop import LoopActions
from zendsp.tui.snapshot import Snapshot
from zendsp_protocol.texts import counted

SPINNER = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
BUTTONS = (
    ("report", "Report v"),
    ("compensate", "Compensate c"),
    ("next", "Next n"),
    ("save", "Save w"),
    ("earlier", "Open o"),
    ("compare", "Compare d"),
)


class DiagnoseScreen(GivenActions, LoopActions):
    """Recordings and model on the left, findings on the right."""

    NAME: ClassVar[str] = "diagnose"
    BINDINGS = bindings("diagnose")

    def __init__(self) -> None:
        super().__init__()
        self.command: Command | None = None
        self.said: list[str] = []  # lines of the diagnosis that runs, or ran
        self.shown: Diagnosed | None = None
        self._began = 0.0
        self._cancelled = False

    # -- layout

    def body(self) -> ComposeResult:
        with Container(id="diagnose-body"):
            with Vertical(id="given"):
                with Vertical(id="given-box", classes="panel") as box:
                    box.border_title = "Diagnosis"
                    yield Static("", id="given-model", markup=False)
                    with Horizontal(classes="line"):
                        yield Button("Start s", id="do-start", variant="success", compact=True)
                        yield Button("Cancel ^c", id="do-cancel", variant="warning", compact=True)
                        yield Static("", id="stage", markup=False)
                with Vertical(id="recordings-box", classes="panel") as box:
                    box.border_title = "Recordings"
                    yield ListTable(id="recordings", cursor_type="row")
            with Vertical(id="found", classes="panel") as box:
                box.border_title = "Findings"
                yield Static("", id="verdict", markup=False)
                yield OptionList(id="findings", markup=False, compact=True)
                with Vertical(id="detail"):
                    yield FigureView(id="figure")
                    with VerticalScroll(id="words-box"):
                        yield Static(NOTHING, id="words", markup=False)
                    with Vertical(id="loop"):
                        yield Static("", id="loop-words", markup=False)
                        yield Scope(id="loop-scope")
                with Horizontal(id="found-buttons"):
                    for name, text in BUTTONS:
                        yield Button(text, id=f"do-{name}", compact=True)

    def ready(self) -> None:
        self._detail("words-box")
        self.fill()
        self.query_one("#recordings", DataTable).focus()

    @on(Button.Pressed)
    def _pressed(self, event: Button.Pressed) -> None:
        event.stop()
        name = str(event.button.id).removeprefix("do-")
        self.app.call_later(self.app.run_action, name, self)

    @on(events.ScreenResume)
    def _look_again(self) -> None:
        """Read the list of runs again, since one may have been made meanwhile."""
        if self.is_mounted:
            self.fill()

    # -- the diagnosis

    @property
    def busy(self) -> bool:
        """Whether a diagnosis runs."""
        return self.command is not None

    def action_start(self) -> None:
        """Diagnose in a process of its own."""
        fit, held = self.chosen("fit"), self.chosen("held out")
        if self.busy:
            self.say("a diagnosis runs already; Ctrl+C ends it", "warning")
        elif not fit:
            self.say(
                "mark a recording first (space): record one on Console (r), play a reference on"
                " Execute, or add a file (a)",
                "warning",
            )
        elif not self.model and self._models():
            self.action_model()
        elif not self.model:
            self.begin_model()
        else:
            self._cancelled, self.said, self._began = False, [], time.monotonic()
            self._show_nothing()
            name = recording_name(fit[0])
            made, folder = begin(self.lab.workspace.diagnoses, name)
            self.coming = coming = Diagnosed(
                made, name, time.time(), self.model, tuple(fit), tuple(held)
            )
            words = ["diagnose", *fit, "--model", self.model, "--out", str(made)]
            for path in held:
                words += ["--heldout", path]
            self.command = Command(words, self.lab.workspace.root, self._hear)
            self.run_worker(self._diagnose(self.command, coming, folder), group="diagnosis")

    def begin_model(self) -> None:
        """Write a model file from the first recording of the fit; start the diagnosis where nothing
        in the file is left open.
        """
        fit = self.chosen("fit")
        if self.busy or not fit:
            self.say("mark the recording that it is to be made from first (space)", "warning")
            return
        run = next((r for r in self.runs if str(r.folder / DATA) == fit[0]), None)
        name = run.machine if run is not None else Path(fit[0]).name.partition(".")[0]
        file = self.lab.workspace.free(self.lab.workspace.root, name, ".toml").resolve()
        self._cancelled, self.said, self._began = False, [], time.monotonic()
        self._detail("words-box")
        words = ["model", "new", fit[0], "--out", str(file)]
        self.command = Command(words, self.lab.workspace.root, self._hear)
        self.run_worker(self._begin_model(self.command, file), group="diagnosis")

    async def _begin_model(self, command: Command, file: Path) -> None:
        try:
            status = await command.run()
        finally:
            self.command = None
        if status != 0 or self._cancelled:
            last = next((line for line in reversed(self.said) if line.strip()), "")
            self.say(f"no model could be begun: {last}", "error")
            return
        self._take_model(str(file))
        asked = len(open_questions(file))
        if asked:
            self._hear(f"Answer them in {file.name}, above their lines; s diagnoses with it.")
            self.say(f"{file.name} is begun; {counted(asked, 'question')} in it", "warning")
        else:
            self.say(f"{file.name} is made of the recording", "good")
            self.action_start()

    def _hear(self, line: str) -> None:
        self.said.append(line)
        coming = self.coming
        if self.shown is None and coming is not None and coming.written:
            self.open(coming)
            seconds = time.monotonic() - self._began
            self.say(f"diagnosis: {headline(coming.report)} ({seconds:.0f} s)", "good")
        if self.shown is None:
            self.query_one("#words", Static).update("\n".join(self.said[-200:]))
            self.query_one("#words-box", VerticalScroll).scroll_end(animate=False)

    async def _diagnose(self, command: Command, coming: Diagnosed, folder: Path) -> None:
        try:
            status = await command.run()
            self.coming = None
            # what was found before it was interrupted is a report too; its page is written last
            if status == 0 or (status == INTERRUPTED and coming.page.exists()):
                self.open(keep(coming, folder))
                return
            if self.shown is coming:
                self._show_nothing()
            if self._cancelled:
                self._hear("— cancelled —")
            else:
                last = next((line for line in reversed(self.said) if line.strip()), "")
                self.say(f"diagnosis failed: {last}", "error")
        finally:
            self.command = self.coming = None
            shutil.rmtree(coming.folder, ignore_errors=True)
            if self.is_mounted:
                self._paint(0.0)

    def action_cancel(self) -> None:
        """End the running diagnosis with what it has found so far; pressed again, at once."""
        if self.command is None:
            return
        if self.coming is None or self._cancelled:
            self.command.end()
            self.say("diagnosis cancelled", "warning")
        else:
            self.command.interrupt()
            self.say("the diagnosis ends with what it has found; once more ends it at once")
        self._cancelled = True

    def on_unmount(self) -> None:
        if self.command is not None:
            self.command.end()

    # -- what was found

    def _show_nothing(self) -> None:
        self.shown, self.entries = None, []
        self.query_one("#found").remove_class("-said")
        self.query_one("#findings", OptionList).clear_options()
        self.query_one("#verdict", Static).update("")
        self.query_one("#words", Static).update("")
        self._detail("words-box")

    def open(self, d: Diagnosed) -> None:
        """Show a diagnosis. If its report is still being drawn, it is opened again later, and the
        marked line stays marked.
        """
        lines = self.query_one("#findings", OptionList)
        same = self.shown is not None and self.shown.created == d.created
        at = lines.highlighted if same else 0
        self.shown = d
        theme = self.app.theme_variables
        colour = {"complete": "success", "missing": "error"}.get(d.report["verdict"], "warning")
        if colour == "success" and unseen(d.report):
            colour = "warning"
        self.query_one("#verdict", Static).update(
            Text(headline(d.report), Style(color=theme[colour], bold=True))
        )
        self.entries = [*entries(d, theme), self.loop_entry(d)]
        lines.clear_options()
        lines.add_options([Option(Hanging(e.text), id=e.key) for e in self.entries])
        lines.highlighted = at
        if not same:
            lines.focus()

    @on(OptionList.OptionHighlighted, "#findings")
    def _highlighted(self, event: OptionList.OptionHighlighted) -> None:
        entry = next((e for e in self.entries if e.key == event.option.id), None)
        if entry is None:
            return
        more = entry.key == LOOP or entry.chart is not None or bool(entry.words)
        self.query_one("#found").set_class(not more, "-said")  # the line says it all
        if entry.key == LOOP:
            self._detail("loop")
            self.follow_loop()
        elif entry.chart is not None:
            self._detail("figure")
            self.query_one(FigureView).show(entry.chart)
        else:
            self._detail("words-box")
            self.query_one("#words", Static).update(entry.words)
            self.query_one("#words-box", VerticalScroll).scroll_home(animate=False)

    def _detail(self, shown: str) -> None:
        for name in ("figure", "words-box", "loop"):
            self.query_one(f"#{name}").display = name == shown
        self.query_one("#loop-scope").display = shown == "loop"

    def take_next(self, d: Diagnosed, run: Run) -> None:
        """Diagnose a run together with the recordings of a diagnosis."""
        self.take_run(run, beside=d.recordings)
        self._take_model(d.model)
        self.action_start()

    def action_compare(self) -> None:
        """Show the differences between this diagnosis and another."""
        if self._need() is not None:
            self._choose_diagnosis("Compare with", self.compare_with, but=self.shown)

    def action_earlier(self) -> None:
        """Open an earlier diagnosis and its model."""

        def then(d: Diagnosed) -> None:
            self.open(d)
            if Path(d.model).is_file():
                self._take_model(d.model)

        self._choose_diagnosis("Diagnoses", then)

    def _choose_diagnosis(
        self, title: str, then: Callable[[Diagnosed], None], but: Diagnosed | None = None
    ) -> None:
        known = list_diagnoses(self.lab.workspace.diagnoses)
        if but is not None:
            known = [d for d in known if d.folder != but.folder]
        if not known:
            self.say("there is no other diagnosis yet", "warning")
            return
        options = [Line(str(d.folder), f"{d.name}  {d.when}", headline(d.report)) for d in known]

        def take(keys: list[str] | None) -> None:
            if keys:
                then(next(d for d in known if str(d.folder) == keys[0]))

        self.app.push_screen(Choose(title, options), take)

    # -- the screen

    def pull(self, snapshot: Snapshot, fresh: bool) -> None:
        """Show the progress of a running diagnosis."""
        seconds = time.monotonic() - self._began if self.busy else 0.0
        key = (int(4 * seconds), self.busy, len(self.said), self.model, self.app.theme, self.size)
        if key != self._painted:
            self._painted = key
            self._paint(seconds)
        if fresh and self.shown is not None:
            self.look_at_loop(snapshot)

    def _paint(self, seconds: float) -> None:
        c = self.app.theme_variables
        text = Text("model  ", "dim", no_wrap=True, overflow="ellipsis")
        path = Path(self.model)
        text.append(path.name or "none: m chooses or begins one", Style(dim=False, bold=True))
        if path.name and path.parent not in (Path("."), self.lab.workspace.root):
            text.append(f"  in {path.parent}", Style(dim=True))
        given = self.query_one("#given-model", Static)
        given.update(text)
        given.tooltip = self.model or None
        self.query_one("#do-cancel", Button).disabled = not self.busy
        waits = {"start": self.busy}
        for name in ("report", "compensate", "next", "save", "compare"):
            waits[name] = self.shown in (None, self.coming)
        for name, idle in waits.items():  # not disabled: a click says why, as the key does
            self.query_one(f"#do-{name}", Button).set_class(idle, "-waits")
        stage = Text(" ", no_wrap=True, overflow="ellipsis")
        if self.busy:
            stage.append(SPINNER[int(4 * seconds) % len(SPINNER)], Style(color=c["accent"]))
            stage.append(f" {seconds:.0f} s  {self.said[-1] if self.said else 'starting'}")
        elif self.shown is not None:
            names = ", ".join(recording_name(r) for r in self.shown.recordings)
            stage.append(f"{self.shown.report['seconds']:.1f} s  {names}", "dim")
        self.query_one("#stage", Static).update(stage)
