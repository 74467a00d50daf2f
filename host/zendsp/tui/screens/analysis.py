"""Simulates a run and opens its diagnosis. The simulation is a process of its own, whose output
appears line by line.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, RichLog, Static

from zendsp.errors import ZendspError
from zendsp.physics.files.shipped import model_folder
from zendsp.recording import Recording
from zendsp.tui.command import Command
from zendsp.tui.dialogs import Field, Form
from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.runs import Outcome, Run, list_runs, store_run
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.workspace import Workspace
from zendsp_protocol import written


class ProcessView(Dialog[bool]):
    """Runs a command of zendsp in a process of its own and shows its output; closing the view ends
    it.
    """

    DEFAULT_CSS = """
    ProcessView > .box { width: 96%; height: 100%; }
    ProcessView RichLog { height: 1fr; background: $surface; }
    """

    def __init__(
        self,
        title: str,
        arguments: Sequence[str],
        folder: Path,
        finish: Callable[[], str] | None = None,
    ) -> None:
        super().__init__()
        self._title, self._arguments, self._folder = title, list(arguments), folder
        self._finish = finish  # with the result; returns a sentence about it, "" if there is none
        self._began = time.monotonic()
        self.status: int | None = None

    def compose(self) -> ComposeResult:
        with Vertical(classes="box") as box:
            box.border_title = self._title
            box.border_subtitle = "F9 STOP"
            yield Static("zendsp " + " ".join(self._arguments), classes="hint", markup=False)
            yield RichLog(wrap=True, markup=False, highlight=False, max_lines=4000, min_width=20)
            with Horizontal(classes="buttons"):
                yield Button("Close", id="close", compact=True)

    def on_mount(self) -> None:
        log = self.query_one(RichLog)
        width = max(self.size.width - 12, 60)
        self._command = Command(self._arguments, self._folder, log.write, width)
        self.run_worker(self._run(), exclusive=True)
        self.set_interval(1.0, self._show_time)

    def _show_time(self) -> None:
        if self.status is None:
            self.query_one(".box").border_title = (
                f"{self._title} · {time.monotonic() - self._began:.0f} s"
            )

    async def _run(self) -> None:
        log = self.query_one(RichLog)
        status = await self._command.run()
        if status in (0, 1) and self._finish is not None:  # 1: done, and something is wrong in it
            try:
                if said := self._finish():
                    log.write(said)
            except (ZendspError, OSError) as error:
                log.write(str(error))
        log.write("— done —" if status == 0 else f"— ended with status {status} —")
        self.status = status

    def on_unmount(self) -> None:
        self._command.end()

    @on(Button.Pressed, "#close")
    def _close(self) -> None:
        self.dismiss(self.status == 0)


class AnalysisActions(LabScreen):
    """Actions that simulate or diagnose a run: the newest one, unless the screen has one marked."""

    def meant_run(self) -> Run | None:
        """The run that the user means."""
        runs = list_runs(self.lab.workspace.runs)
        return next((r for r in runs if r.outcome != Outcome.SIMULATED), None)

    def action_diagnose(self) -> None:
        """Show the run on Diagnose."""
        run = self.meant_run()
        if run is None:
            self.say(
                "no run to diagnose yet: record one (r on Console), or play a reference on Execute",
                "warning",
            )
            return
        self.lab.diagnose(run)

    def action_simulate(self) -> None:
        """Ask for the model, then simulate the run with its source and its reference."""
        run = self.meant_run()
        if run is None:
            self.say("no run to simulate yet: play a reference on Execute first", "warning")
            return
        sources = sorted(run.folder.glob("*.c"))
        if not sources:
            self.say(f"{run.name} carries no source: it cannot be simulated", "warning")
            return
        if len(run.references) > 1:
            self.say(
                f"{run.name} played {len(run.references)} references; one that played one can be"
                " simulated",
                "warning",
            )
            return
        try:
            rest, finish = simulation_of(run, self.lab.workspace.runs)
        except (ZendspError, OSError) as error:
            self.say(f"{run.name}: {error}", "error")
            return
        self._with_model(
            "Simulate",
            run,
            lambda model: ["simulate", str(sources[0]), "--model", model, *rest],
            finish,
        )

    def _with_model(
        self,
        title: str,
        run: Run,
        command: Callable[[str], list[str]],
        finish: Callable[[], str] | None = None,
    ) -> None:
        """Ask for the model file, then start the process. Proposed are the file given last, one of
        this folder that is named like the machine, or the shipped one.
        """
        default = self.lab.model or next(map(str, models_for(run.machine, self.lab.workspace)), "")
        fields = [Field("model", "Model file", default, check=existing, hint="TOML, see docs")]

        def go(answer: Mapping[str, str] | None) -> None:
            if answer:
                self.lab.model = answer["model"]
                self.app.push_screen(
                    ProcessView(f"{title} {run.name}", command(answer["model"]), run.folder, finish)
                )

        self.app.push_screen(
            Form(
                f"{title} {run.name}", fields,
                "The model of the machine whose missing physics is of interest.", title,
            ),
            go,
        )


def simulation_of(run: Run, runs: Path) -> tuple[list[str], Callable[[], str]]:
    """The arguments with which ``zendsp simulate`` repeats a run, and a function that stores the
    result as another run.

    It has the same parameters, reference and channels; the motion before the reference is left out,
    as in the run.
    """
    taken = run.recording()
    reference = run.folder / "reference.mat"
    played = reference.is_file()
    values = {
        k: v
        for k, v in taken.parameters.items()
        if not played or k not in ("use_table", "row_rate")
    }
    out = run.folder / "simulation.mat"
    out.unlink(missing_ok=True)  # of an earlier one
    words = [
        "--channels",
        ",".join(dict.fromkeys(c.split("[")[0] for c in taken.columns)),
        "--out",
        str(out),
    ]
    for name, value in values.items():
        words += ["--set", f"{name}={json.dumps(np.asarray(value).tolist())}"]
    words += (
        ["--reference", str(reference)]
        if played
        else ["--seconds", f"{max(run.seconds, 0.01):.6g}"]
    )

    def keep() -> str:
        if not out.is_file():
            return ""
        made = Recording.load(out)
        approach = np.asarray(made.parameters.get("approach_time", 0.0)).item() if played else 0.0
        first = min(round(approach / made.sample_time), len(made))
        same = slice(first, first + max(round(run.seconds / made.sample_time), 1))
        made = replace(
            made, t=made.t[same], data=made.data[same], start_tick=made.start_tick + first
        )
        kept = store_run(
            runs, f"{run.name} simulated", made, references=[reference] if played else [],
            outcome=Outcome.SIMULATED,
        )
        return (
            f"kept as the run “{kept.name}”: space on Execute lays it over {run.name}, d compares"
        )

    return words, keep


def models_for(machine: str, workspace: Workspace) -> list[Path]:
    """The model files of a folder and those that come with zendsp; those that are named like the
    machine come first. Files that cannot be read come last, so that the reason can be told.
    """
    patterns = ("*.toml", "models/*.toml", "examples/models/*.toml")
    near = [p for pattern in patterns for p in sorted(workspace.root.glob(pattern))]
    shipped = _shipped(machine)
    fit = [p for p in near if fits(p, machine)]
    other = [p for p in near if p not in fit and fits(p)]
    broken = [p for p in near if _table(p) is None]
    return fit + ([shipped] if shipped else []) + other + broken


def fits(path: Path, machine: str = "") -> bool:
    """Whether a file is a model and, where a machine is given, whether the file or the model in it
    is named like the machine.
    """
    table = _table(path)
    if table is None or "mechanism" not in table:
        return False
    return machine in ("", path.stem, table.get("name"))


def is_shipped(path: Path) -> bool:
    """Whether a model comes with zendsp."""
    try:
        return path.parent == model_folder()
    except FileNotFoundError:
        return False


def _table(path: Path) -> dict[str, Any] | None:
    """The contents of a TOML file; None where it cannot be read."""
    try:
        return written.toml(path.read_text("utf-8"))
    except (OSError, ValueError):
        return None


def _shipped(machine: str) -> Path | None:
    """The model that comes with zendsp for a machine, None where there is none."""
    try:
        path = model_folder() / f"{machine}.toml"
    except FileNotFoundError:
        return None
    return path if path.is_file() else None


def existing(text: str) -> str:
    """The full path of the file that a text names."""
    if not text.strip():
        raise ValueError("the path of a file")
    path = Path(text.strip()).expanduser()
    if not path.is_file():
        raise ValueError("no such file")
    return str(path.resolve())
