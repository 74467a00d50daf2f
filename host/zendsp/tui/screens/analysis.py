"""What opens the simulation and the diagnosis of a run: worker processes whose words appear line by line."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button, RichLog, Static

from zendsp.tui.dialogs import Field, Form
from zendsp.tui.dialogs.base import Dialog
from zendsp.tui.runs import DATA, Run, list_runs
from zendsp.tui.screens.base import LabScreen

CALL = "import sys; from zendsp.cli import main; main()"


class ProcessView(Dialog[bool]):
    """Runs a command of zendsp in a process of its own and shows what it says; closing ends it."""

    DEFAULT_CSS = """
    ProcessView > .box { width: 96%; height: 92%; max-height: 92%; }
    ProcessView RichLog { height: 1fr; background: $surface; }
    """

    def __init__(self, title: str, arguments: Sequence[str], folder: Path) -> None:
        super().__init__()
        self._title, self._arguments, self._folder = title, list(arguments), folder
        self._process: asyncio.subprocess.Process | None = None
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
        self.run_worker(self._run(), exclusive=True)

    async def _run(self) -> None:
        log = self.query_one(RichLog)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", CALL, *self._arguments,
            cwd=self._folder, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT, env={**os.environ, "COLUMNS": str(max(self.size.width - 12, 60)), "NO_COLOR": "1"},
            start_new_session=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        async for line in self._process.stdout:
            log.write(line.decode(errors="replace").rstrip("\n"))
        self.status = await self._process.wait()
        log.write("— done —" if self.status == 0 else f"— ended with status {self.status} —")

    def on_unmount(self) -> None:
        process = self._process
        if process is not None and process.returncode is None:
            try:
                os.killpg(process.pid, signal.SIGTERM)
            except ProcessLookupError:
                return

    @on(Button.Pressed, "#close")
    def _close(self) -> None:
        self.dismiss(self.status == 0)


class AnalysisActions(LabScreen):
    """Simulate and diagnose the run that is meant: the newest one, unless a screen knows better."""

    def meant_run(self) -> Run | None:
        """Return the run that the user means."""
        runs = list_runs(self.lab.workspace.runs)
        return runs[0] if runs else None

    def action_diagnose(self) -> None:
        """Ask for the model, then diagnose the run."""
        run = self.meant_run()
        if run is None:
            self.say("no run to diagnose yet: record one (r on Console), or play a reference on Execute", "warning")
            return
        out = run.folder / "diagnosis"
        self._with_model("Diagnose", run, lambda model: ["diagnose", str(run.folder / DATA), "--model", model, "--out", str(out)])

    def action_simulate(self) -> None:
        """Ask for the model, then simulate the run: its source, its reference."""
        run = self.meant_run()
        if run is None:
            self.say("no run to simulate yet: play a reference on Execute first", "warning")
            return
        sources = sorted(run.folder.glob("*.c"))
        if not sources:
            self.say(f"{run.name} carries no source: it cannot be simulated", "warning")
            return
        reference = run.folder / "reference.mat"
        rest = ["--reference", str(reference)] if reference.is_file() else []
        self._with_model("Simulate", run, lambda model: ["simulate", str(sources[0]), "--model", model, *rest])

    def _with_model(self, title: str, run: Run, command: Callable[[str], list[str]]) -> None:
        """Ask for the model file, the last one given or one named like the machine, and start the worker."""
        near = [p for pattern in ("*.toml", "models/*.toml", "examples/models/*.toml") for p in sorted(self.lab.workspace.root.glob(pattern))]
        fitting = [p for p in near if p.stem == run.machine] + near
        default = self.lab.model or (str(fitting[0]) if fitting else "")
        fields = [Field("model", "Model file", default, check=_existing, hint="TOML, see docs")]

        def go(answer: Mapping[str, str] | None) -> None:
            if answer:
                self.lab.model = answer["model"]
                self.app.push_screen(ProcessView(f"{title} {run.name}", command(answer["model"]), run.folder))

        self.app.push_screen(Form(f"{title} {run.name}", fields, "The model of the machine whose missing physics is of interest.", title), go)


def _existing(text: str) -> str:
    path = Path(text.strip()).expanduser()
    if not path.is_file():
        raise ValueError("no such file")
    return str(path.resolve())
