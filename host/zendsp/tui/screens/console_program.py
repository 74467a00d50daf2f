"""Console: the drive sequence, building and running the program, recording, and the dialogs for
these.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from zendsp.errors import Incomplete, RunnerDied, ZendspError
from zendsp.tui.dialogs import Choose, Field, Form, Option
from zendsp.tui.dialogs.leave import moves
from zendsp.tui.dialogs.source import SourceView
from zendsp.tui.port import Build, Port, Shot
from zendsp.tui.runs import store_run
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.screens.console_scope import real
from zendsp_isr.sources import gather
from zendsp_protocol.messages import Diagnostic
from zendsp_protocol.states import DriveAction, DriveState, HostLost, Severity
from zendsp_protocol.texts import counted


def positive(text: str) -> float:
    """The number in a text; it has to be above zero."""
    value = real(text)
    if value <= 0.0:
        raise ValueError(f"{value:g} must be above 0")
    return value


def whole(text: str) -> int:
    """The whole number in a text; it has to be 1 or more."""
    try:
        value = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None
    if value < 1:
        raise ValueError(f"{value} must be 1 or more")
    return value


def first_words(path: Path) -> str:
    """The first sentence of the comment at the head of a shipped program."""
    first = path.read_text("utf-8").partition("*/")[0].split("\n *\n")[0]
    words = " ".join(first.replace("\n *", " ").split()).partition(": ")[2]
    return re.split(r"\.(?= |$)", words)[0]


class ProgramActions(LabScreen):
    """Actions on drives and program."""

    def __init__(self) -> None:
        super().__init__()
        self.remarks: tuple[Diagnostic, ...] = ()
        self._recording: Future[str] | None = None

    # -- the sequence

    def action_power(self) -> None:
        """Power on or off."""
        s = self.lab.session.snapshot
        on = not s.explicit or s.drive in (DriveState.OFF, "")
        if on:
            self.lab.drive("power on", DriveAction.POWER_ON)
        else:
            self.lab.drive("power off", DriveAction.POWER_OFF)

    def action_home(self) -> None:
        """Find the zero position."""
        self.lab.drive("home", DriveAction.HOME)

    def action_enable(self) -> None:
        """Enable or disable."""
        on = self.lab.session.snapshot.enabled
        action = DriveAction.DISABLE if on else DriveAction.ENABLE
        self.lab.drive(action, action)

    def action_start(self) -> None:
        """Start the program."""
        self.ask("start", lambda port: port.start())

    def action_pause(self) -> None:
        """Pause the program, or end a homing."""
        self.ask("pause", lambda port: port.pause(), by=self.lab.session.do_first)

    def action_host_lost(self) -> None:
        """Choose the host-lost policy."""
        options = [
            Option(HostLost.STOP, "stop", "zero velocity at once, latched as a trip (the default)"),
            Option(
                HostLost.HOLD,
                "hold",
                "the program's parameter hold is set: it comes to rest on its path; without one, as"
                " stop",
            ),
            Option(HostLost.FINISH, "finish", "the program goes on"),
        ]

        def chosen(keys: list[str] | None) -> None:
            if keys:
                self.lab.drive("host-lost policy", DriveAction.HOST_LOST, policy=keys[0])

        self.app.push_screen(Choose("If this host disappears", options), chosen)

    # -- the program

    def action_open_source(self) -> None:
        """Choose a C file."""
        self._choose_source(self._take_source)

    def _choose_source(self, then: Callable[[Path], None]) -> None:
        shipped = self.lab.examples()
        own, parts = self.lab.workspace.sources()
        options = [
            *(Option(str(p), p.name, str(p.parent)) for p in own),
            *(Option(str(p), p.name, first_words(p)) for p in shipped),
            *(Option(str(p), p.name, f"no program, but a part of one: {p.parent}") for p in parts),
        ]
        if not options:
            self.say(f"no C file in {self.lab.workspace.root} or one folder below", "warning")
            return
        self.app.push_screen(
            Choose("Source", options),
            lambda keys: then(Path(keys[0])) if keys else None,
        )

    def _take_source(self, path: Path) -> None:
        self._set_source(path)
        self.say(f"{path.name} is chosen: b builds it", "good")

    def _set_source(self, path: Path) -> None:
        self.lab.source = path
        self.remarks = ()
        self._pulled = None

    def _take_and_build(self, path: Path) -> None:
        self._set_source(path)
        self.action_build()

    def action_build(self) -> None:
        """Compile and load. Where the machine moves, ask first, since loading ends the running
        program.
        """
        path = self.lab.source
        if path is None:
            self._choose_source(self._take_and_build)
        elif moves(self.lab.session.snapshot):
            ways = [
                Option("stay", "stay"),
                Option("build", "build", f"the program ends, {path.name} is loaded"),
            ]
            self.app.push_screen(
                Choose("The machine moves", ways),
                lambda keys: self._build(path) if keys == ["build"] else None,
            )
        else:
            self._build(path)

    def _build(self, path: Path) -> None:
        try:
            sources = gather(path)  # with the headers beside it that it includes
        except ZendspError as error:
            self.say(str(error), "error")
            return
        self.say(f"building {path} …")
        self.ask(f"build {path.name}", lambda port: port.build(sources), self._built)

    def _built(self, build: Build) -> None:
        self.remarks = build.remarks
        for r in build.remarks:
            level = "error" if r.severity == Severity.ERROR else "warning"
            self.lab.session.events.add(str(r), level)
        errors = sum(r.severity == Severity.ERROR for r in build.remarks)
        if build.ok:
            warnings = (
                f", {len(build.remarks)} remark{'' if len(build.remarks) == 1 else 's'} (g)"
                if build.remarks
                else ""
            )
            self.say(
                f"built in {build.seconds:.2f} s{' (cached)' if build.cached else ''} and"
                f" downloaded{warnings}",
                "good",
            )
            self.built()
        else:
            first = next((r for r in build.remarks if r.severity == Severity.ERROR), None)
            where = f": {first.file}:{first.line}: {first.message}" if first else ""
            self.say(
                f"{errors} error{'' if errors == 1 else 's'}{where}; g opens the source there",
                "error",
            )

    def built(self) -> None:
        """Called after a successful build."""

    def action_source(self) -> None:
        """Show the source."""
        path = self.lab.source
        if path is None or not path.is_file():
            self.action_open_source()
            return
        view = SourceView(path, self.remarks, lambda text: self.say(text))
        self.app.push_screen(view, lambda build: self.action_build() if build else None)

    # -- recording

    def curve_names(self) -> list[str]:
        """The names of the curves on the scope."""
        return []

    def action_record(self) -> None:
        """Record the curves for some seconds, or end a recording."""
        if self._recording is not None and not self._recording.done():
            self.ask("record", lambda port: port.end_acquisition())
            return
        names = self.curve_names()
        if not names:
            self.say("choose curves first (c): what the scope shows is recorded", "warning")
            return
        fields = [
            Field("seconds", "Duration", "2", "s", positive),
            Field("decimation", "Every … sample", "1", "", whole),
            Field("name", "Name", "recording"),
            Field("note", "Note", ""),
        ]
        dialog = Form("Record", fields, f"Channels: {', '.join(names)}", "Record")
        self.app.push_screen(dialog, lambda r: self._record(names, r) if r else None)

    def _record(self, names: list[str], answer: Any) -> None:
        shot = Shot(tuple(names), answer["seconds"], answer["decimation"])
        folder = self.lab.workspace.runs
        sources = self.lab.source_texts()

        def job(port: Port) -> str:
            note, why = str(answer["note"]), ""
            try:
                recording = port.acquire(shot, note)
            except (Incomplete, RunnerDied) as error:  # what there is, is kept
                recording, why = port.load(note), f"; {error}"
            run = store_run(folder, str(answer["name"]), recording, sources=sources)
            return f"{len(recording)} rows, {recording.lost} lost, kept as {run.folder.name}{why}"

        self.say(f"recording {shot.seconds:g} s of {counted(len(names), 'curve')}; r ends it …")
        self._recording = self.ask(
            "record", job, lambda text: self.say(text, "good"), by=self.lab.session.do_beside
        )
