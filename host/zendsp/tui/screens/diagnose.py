"""Diagnose: which physics does the model lack that the recordings show, and what to do about it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

from rich.style import Style
from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, DataTable, OptionList, Static
from textual.widgets.data_table import CellDoesNotExist
from textual.widgets.option_list import Option

from zendsp.tui.actions import bindings
from zendsp.tui.command import Command
from zendsp.tui.diagnoses import Diagnosed, begin, keep, list_diagnoses, recording_name
from zendsp.tui.dialogs import Choose, Field, Form
from zendsp.tui.dialogs import Option as Line
from zendsp.tui.panels.figure import FigureView
from zendsp.tui.panels.findings import LOOP, Hanging, entries, headline, unseen
from zendsp.tui.panels.table import ListTable
from zendsp.tui.runs import DATA, Outcome, Run, list_runs
from zendsp.tui.scope import Scope
from zendsp.tui.screens.analysis import existing, fits, is_shipped, models_for
from zendsp.tui.screens.diagnose_loop import LoopActions
from zendsp.tui.snapshot import Snapshot
from zendsp_protocol.texts import counted

ROLES = ("", "fit", "held out")  # what a recording is used for, in the order of the key
NEW = "new"  # of the dialog of models: one is begun
SPINNER = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
BUTTONS = (
    ("report", "Report v"),
    ("compensate", "Compensate c"),
    ("next", "Next n"),
    ("save", "Save w"),
    ("earlier", "Open o"),
    ("compare", "Compare d"),
)
NOTHING = (
    "s compares the recordings that are marked on the left with the model, and names what the model"
    " lacks."
)
NO_RECORDING = (
    "No recording yet: record on Console (F2, r), play a motion on Execute (F3), or add a file (a)."
)


class DiagnoseScreen(LoopActions):
    """Recordings and model on the left, findings on the right."""

    NAME: ClassVar[str] = "diagnose"
    BINDINGS = bindings("diagnose")

    def __init__(self) -> None:
        super().__init__()
        self.model = ""
        self._model_by_hand = False  # in this session
        self.roles: dict[str, str] = {}  # recording -> what it is used for
        self.added: list[str] = []  # recordings that are no runs of this folder
        self.runs: list[Run] = []
        self.command: Command | None = None
        self.said: list[str] = []  # lines of the diagnosis that runs, or ran
        self.shown: Diagnosed | None = None
        self._marked_by_hand = False
        self._marked = ""  # by itself: the last motion
        self._began = 0.0
        self._cancelled = False
        self._painted: object = None

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

    # -- what is given

    def fill(self) -> None:
        """List the recordings. Where none is marked, mark the last motion; not a frequency
        response, which is a small motion about one place and shows less.
        """
        found = [r for r in list_runs(self.lab.workspace.runs) if r.outcome != Outcome.SIMULATED]
        self.runs = found
        here = {str(r.folder / DATA) for r in found} | set(self.added)
        self.roles = {path: role for path, role in self.roles.items() if path in here}
        motions = [r for r in found if r.outcome != Outcome.RESPONSE] or found
        last = str(motions[0].folder / DATA) if motions else ""
        if last and not self._marked_by_hand and set(self.roles) <= {self._marked}:
            self.roles, self._marked = {last: "fit"}, last
        self.model = self._meant()
        table: DataTable[Text] = self.query_one("#recordings", DataTable)
        at = table.cursor_row
        table.clear(columns=True)
        for name in ("use", "name", "time", "s", "machine"):
            table.add_column(Text(name), key=name)
        for path in self.added:
            self._row(table, path, Path(path).name, "", "", "file")
        for run in found:
            when = time.strftime("%m-%d %H:%M:%S", time.localtime(run.created))
            path = str(run.folder / DATA)
            self._row(table, path, run.name, when, f"{run.seconds:.1f}", run.machine)
        table.move_cursor(row=min(at, table.row_count - 1))
        if self.shown is None and not self.said:
            hint = NOTHING if here else NO_RECORDING
            self.query_one("#words", Static).update(hint)
        self._painted = None

    def _row(self, table: DataTable[Text], path: str, *cells: str) -> None:
        role = self.roles.get(path, "")
        colour = self.app.theme_variables["success" if role == "fit" else "accent"]
        mark = Text(role, Style(color=colour, bold=True))
        table.add_row(mark, *(Text(cell) for cell in cells), key=path)

    def _machine(self) -> str:
        """The machine of the marked recordings, else of the newest run."""
        used = (r for r in self.runs if self.roles.get(str(r.folder / DATA)))
        run = next(used, self.runs[0] if self.runs else None)
        return run.machine if run is not None else self.lab.session.snapshot.machine

    def _meant(self) -> str:
        """The model that was chosen, also earlier; where none was chosen for the machine of the
        marked recordings, the model of that machine.
        """
        kept, machine = self.model or self.lab.model, self._machine()
        first = next(iter(self._models()), None)
        meant = str(first) if first and fits(first, machine) else ""
        of_another = kept and is_shipped(Path(kept)) and not fits(Path(kept), machine)
        if meant and of_another and not self._model_by_hand:
            return meant
        return kept or meant

    def _models(self) -> list[Path]:
        return models_for(self._machine(), self.lab.workspace)

    def chosen(self, role: str) -> list[str]:
        """The recordings with this use."""
        return [path for path, use in self.roles.items() if use == role]

    def take_run(self, run: Run, *, beside: Sequence[str] = ()) -> None:
        """Mark a run for the fit, alone or beside other recordings."""
        held = self.chosen("held out") if beside else []
        self._marked = ""
        self.roles = dict.fromkeys((*beside, str(run.folder / DATA)), "fit")
        self.roles |= dict.fromkeys(held, "held out")
        self.added += [p for p in beside if p not in self.added and Path(p).name != DATA]
        self.fill()

    @on(DataTable.RowSelected, "#recordings")
    def action_use(self) -> None:
        """Use the marked recording for the fit, hold it out, or leave it out."""
        table = self.query_one("#recordings", DataTable)
        if self.focused is self.query_one("#findings", OptionList):
            self.say("space marks recordings: go to their list first (Tab)", "warning")
            return
        try:
            key = table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value
        except CellDoesNotExist:
            self.say("no recording yet: record on Console (r), or add a file (a)", "warning")
            return
        now = ROLES[(ROLES.index(self.roles.get(str(key), "")) + 1) % len(ROLES)]
        self.roles.pop(str(key), None)
        if now:
            self.roles[str(key)] = now
        self._marked_by_hand = True
        self.fill()

    def action_add(self) -> None:
        """Choose files of recordings, from this folder and those below it, or by a path."""
        fields = [Field("path", "Recording", "", check=existing, hint="MAT, CSV, NPZ, Parquet …")]
        text = "Recorded by zendsp or anybody else; the model file names the columns."
        form = Form("Add a recording", fields, text, "Add")
        files = [p for p in self.lab.workspace.recordings() if str(p) not in self.added]
        options = [Line(str(p), p.name, p.parent.name) for p in files]
        options.append(Line("", "another file …", "its path is asked for"))

        def take(keys: Sequence[str] | None) -> None:
            if keys and "" in keys:
                self.app.push_screen(form, lambda r: take([r["path"]]) if r else None)
                return
            for path in keys or ():
                if path not in self.added:
                    self.added.append(path)
                self.roles[path] = "fit"
            self.fill()

        if files:
            self.app.push_screen(Choose("Add recordings", options, several=True, text=text), take)
        else:
            take([""])

    def action_model(self) -> None:
        """Choose the model file."""
        options = [Line(str(p), p.name, str(p.parent)) for p in self._models()]
        options.append(Line("", "another file …", "its path is asked for"))
        options.append(Line(NEW, "begin one …", "from the recording that is marked for the fit"))
        text = "The model whose missing physics is of interest."

        def take(keys: list[str] | None) -> None:
            if keys == [NEW]:
                self.begin_model()
            elif keys and keys[0]:
                self._take_model(keys[0])
            elif keys:
                form = Form("Model file", [Field("path", "Model file", "", check=existing)])
                self.app.push_screen(form, lambda r: self._take_model(r["path"]) if r else None)

        self.app.push_screen(Choose("Model", options, text=text), take)

    def _take_model(self, path: str) -> None:
        self.model = self.lab.model = path
        self._model_by_hand = True
        self._painted = None

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
        asked = file.read_text("utf-8").count("# ? ")
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
            if status == 0:  # cancelled or not: what was found so far is a report too
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
