"""Execute: the list of runs: overlay, rename, compare, export."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.style import Style
from rich.text import Text
from textual import events, on
from textual.widgets import DataTable
from textual.widgets.data_table import CellDoesNotExist

from zendsp.errors import ZendspError
from zendsp.tui.colours import trace_colours
from zendsp.tui.dialogs import Field, Form, Message, not_empty
from zendsp.tui.runs import Outcome, Run, compare, discard_run, list_runs, rename_run
from zendsp.tui.scope import Channel, History, Scope
from zendsp.tui.screens.analysis import AnalysisActions
from zendsp_protocol.texts import counted

MOST_OVERLAID = 4
NAME = 20  # characters of a run's name in the list


class RunActions(AnalysisActions):
    """Actions on stored runs."""

    def __init__(self) -> None:
        super().__init__()
        self.runs: list[Run] = []
        self.marked_runs: list[Path] = []  # folders of overlaid runs, in order

    @property
    def runs_table(self) -> DataTable[Text]:
        """The list of runs."""
        return self.query_one("#runs", DataTable)

    @on(events.ScreenResume)
    def _look_again(self) -> None:
        """Read the list again, since a recording on Console or a simulation may have added a run.
        """
        if self.is_mounted and [r.folder for r in list_runs(self.lab.workspace.runs)] != [
            r.folder for r in self.runs
        ]:
            self.fill_runs()

    def fill_runs(self, mark: Path | None = None) -> None:
        """Read the list from disk and put the cursor on the run ``mark``."""
        table = self.runs_table
        at = mark or (self.this_run().folder if self.this_run() else None)  # type: ignore[union-attr]
        table.clear(columns=True)
        for name in ("", "name", "outcome", "worst rms", "s", "lost", "time"):
            table.add_column(Text(name), key=name)
        self.runs = list_runs(self.lab.workspace.runs)
        colours = trace_colours(self.app.current_theme).traces
        for run in self.runs:
            k = self.marked_runs.index(run.folder) if run.folder in self.marked_runs else -1
            table.add_row(
                Text(
                    "▐" if k >= 0 else " ", Style(color=colours[2 * k % 8]) if k >= 0 else Style()
                ),
                Text(shorten(run.name), Style(bold=True)),
                Text(run.outcome, Style(dim=run.outcome == Outcome.COMPLETE)),
                Text(run.worst),
                Text(f"{run.seconds:.2f}", justify="right"),
                Text(str(run.lost)),
                Text(time.strftime("%m-%d %H:%M", time.localtime(run.created)), Style(dim=True)),
                key=str(run.folder),
            )
            if run.folder == at:
                table.move_cursor(row=table.row_count - 1)
        table.border_subtitle = counted(len(self.runs), "run")

    def this_run(self) -> Run | None:
        """The run under the cursor."""
        try:
            key = str(
                self.runs_table.coordinate_to_cell_key(
                    self.runs_table.cursor_coordinate
                ).row_key.value
            )
        except CellDoesNotExist:
            return None
        return next((run for run in self.runs if str(run.folder) == key), None)

    def meant_run(self) -> Run | None:
        """The marked run, else the newest."""
        return self.this_run() or super().meant_run()

    def _need_run(self) -> Run | None:
        run = self.this_run()
        if run is None:
            self.say("no run is marked: Start one, or record on Console", "warning")
        return run

    @on(DataTable.RowSelected, "#runs")
    def _row_selected(self) -> None:
        self.action_overlay()

    def action_overlay(self) -> None:
        """Add the marked run to the overlaid ones, or remove it."""
        run = self._need_run()
        if run is None:
            return
        if run.folder in self.marked_runs:
            self.marked_runs.remove(run.folder)
        elif len(self.marked_runs) >= MOST_OVERLAID:
            self.say(f"{MOST_OVERLAID} runs are overlaid already: take one away first", "warning")
            return
        else:
            self.marked_runs.append(run.folder)
        self.fill_runs()
        self.preview()

    def preview(self) -> None:
        """Show references or runs; the screen overrides this."""
        raise NotImplementedError

    def show_responses(self, runs: Sequence[Run]) -> None:
        """Draw frequency responses; the screen overrides this."""
        raise NotImplementedError

    def show_overlay(self, scope: Scope) -> None:
        """Show those overlaid runs that are of the same kind as the last one: frequency responses;
        or curves on one time axis, of each run up to two errors (or positions), the largest.
        """
        marked = [r for folder in self.marked_runs for r in self.runs if r.folder == folder]
        responses = [run for run in marked if run.outcome == Outcome.RESPONSE]
        if responses and marked[-1].outcome == Outcome.RESPONSE:
            self.show_responses(responses)
            return
        loaded = []
        for run in marked:
            if run.outcome == Outcome.RESPONSE:
                continue
            try:
                loaded.append((run, run.recording()))
            except (ZendspError, OSError) as error:
                self.say(f"{run.name}: {error}", "error")
        if not loaded:
            return
        step = min(rec.sample_time for _, rec in loaded)
        length = max(rec.t[-1] - rec.t[0] for _, rec in loaded if len(rec))
        t = np.arange(round(length / step) + 1) * step
        channels, columns = [], []
        for run, rec in loaded:
            there = signals_to_show(rec.columns)
            worst = sorted(there, key=lambda n: -loaded[0][0].errors.get(n, 0.0))[:2]
            for name in [n for n in there if n in worst]:
                unit = rec.column_units[rec.columns.index(name)]
                channels.append(Channel(f"{run.name} {name}", unit))
                columns.append(np.interp(t, rec.t - rec.t[0], rec[name], right=np.nan))
        history = History(len(channels), rows=len(t) + 1)
        history.append(np.arange(len(t)), np.stack(columns, axis=1), step)
        scope.limits = {}
        scope.settings = replace(scope.settings, mode="roll", window=max(length, step) * 1.0001)
        scope.show_channels(channels, history)

    def action_compare(self) -> None:
        """Show the differences between the overlaid runs."""
        chosen = [r for folder in self.marked_runs for r in self.runs if r.folder == folder]
        if len(chosen) < 2:
            self.say("overlay at least two runs first (space)", "warning")
            return
        try:
            text = compare(chosen)
        except (ZendspError, OSError) as error:
            self.say(f"compare: {error}", "error")
            return
        self.app.push_screen(Message("Compare", Text(text)))

    def action_rename(self) -> None:
        """Ask for another name."""
        run = self._need_run()
        if run is not None:
            form = Form("Rename run", [Field("name", "Name", run.name, check=not_empty)])
            self.app.push_screen(form, lambda r: self._rename(run, r["name"]) if r else None)

    def _rename(self, run: Run, name: str) -> None:
        rename_run(run, name)
        self.fill_runs(run.folder)

    def action_export(self) -> None:
        """Ask for the format and write the run."""
        run = self._need_run()
        if run is None:
            return
        fields = [
            Field("suffix", "Format", ".mat", choices=(".mat", ".csv", ".npz", ".parquet")),
            Field(
                "path",
                "To",
                str(self.lab.workspace.root / "exports" / run.folder.name),
                check=not_empty,
            ),
        ]

        def write(r: Any) -> None:
            if not r:
                return
            path = Path(f"{r['path']}{r['suffix']}").expanduser()
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                run.recording().save(path)
            except (ZendspError, OSError) as error:
                self.say(f"export: {error}", "error")
                return
            self.say(f"exported {path}", "good")
            self.lab.toast(f"exported {path}")

        self.app.push_screen(Form(f"Export {run.name}", fields, ok="Export"), write)

    def action_delete(self) -> None:
        """Ask, then move the run to the trash folder."""
        run = self._need_run()
        if run is not None:
            text = f"{run.name} goes to {run.folder.parent / '.trash'}; nothing is deleted."
            self.app.push_screen(
                Message("Delete run", text, agree="Move to trash"),
                lambda yes: self._discard(run) if yes else None,
            )

    def _discard(self, run: Run) -> None:
        discard_run(run)
        self.marked_runs = [folder for folder in self.marked_runs if folder != run.folder]
        self.fill_runs()
        self.preview()


def shorten(name: str) -> str:
    """A name cut to the width of the list. Its end is kept, since it tells the name from others."""
    half = NAME // 2
    return name if len(name) <= NAME else f"{name[:half]}…{name[1 - half :]}"


def signals_to_show(columns: tuple[str, ...]) -> list[str]:
    """The columns to overlay: errors, else positions, else the first."""
    for stem in ("e", "q"):
        found = [c for c in columns if c.split("[")[0].rstrip("0123456789") == stem]
        if found:
            return found
    return list(columns)
