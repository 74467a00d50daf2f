"""Diagnose: what is given: the recordings, what each is used for, and the model."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from rich.style import Style
from rich.text import Text
from textual import on
from textual.widgets import DataTable, OptionList, Static
from textual.widgets.data_table import CellDoesNotExist

from zendsp.tui.diagnoses import Diagnosed
from zendsp.tui.dialogs import Choose, Field, Form
from zendsp.tui.dialogs import Option as Line
from zendsp.tui.runs import DATA, Outcome, Run, list_runs
from zendsp.tui.screens.analysis import existing, fits, is_shipped, models_for
from zendsp.tui.screens.base import LabScreen

ROLES = ("", "fit", "held out")  # what a recording is used for, in the order of the key
NEW = "new"  # of the dialog of models: one is begun
NOTHING = (
    "s compares the recordings that are marked on the left with the model, and names what the model"
    " lacks."
)
NO_RECORDING = (
    "No recording yet: record on Console (F2, r), play a motion on Execute (F3), or add a file (a)."
)


class GivenActions(LabScreen):
    """Actions on the recordings and the model of a diagnosis."""

    shown: Diagnosed | None
    said: list[str]

    def __init__(self) -> None:
        super().__init__()
        self.model = ""
        self._model_by_hand = False  # in this session
        self.roles: dict[str, str] = {}  # recording -> what it is used for
        self.added: list[str] = []  # recordings that are no runs of this folder
        self.runs: list[Run] = []
        self._marked_by_hand = False
        self._marked = ""  # by itself: the last motion
        self._painted: object = None  # what the screen shows of this

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
        marked recordings, the model of that machine, or the only one there is.
        """
        kept, machine = self.model or self.lab.model, self._machine()
        models = self._models()
        # of a machine that is not known yet every model would be one
        likely = models and (fits(models[0], machine) if machine else len(models) == 1)
        meant = str(models[0]) if likely else ""
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

    def begin_model(self) -> None:
        """Write a model file from the first recording of the fit."""
        raise NotImplementedError
