"""Diagnose: what follows a finding: the report, the compensation in the running program, the next
motion, the improved model, a comparison.
"""

from __future__ import annotations

import shutil
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text
from textual.widgets import OptionList, Static

from zendsp.errors import ZendspError
from zendsp.physics.codegen.compensation import SHARE
from zendsp.tui.compensating import (
    FILE,
    LINES,
    Compensation,
    compensation_of,
    has_room,
    written_out,
)
from zendsp.tui.diagnoses import Diagnosed, compare
from zendsp.tui.dialogs import Field, Form, Message, not_empty
from zendsp.tui.panels.findings import LABEL, LOOP, Entry, Hanging
from zendsp.tui.play_job import usual_channels
from zendsp.tui.port import Build, Port
from zendsp.tui.scope import Channel, History, Scope
from zendsp.tui.screens.base import LabScreen
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp_isr.sources import gather
from zendsp_protocol.messages import Program
from zendsp_protocol.states import ProgramState, Severity
from zendsp_protocol.values import Value

if TYPE_CHECKING:
    from zendsp.tui.runs import Run

LOOK_S = 2.0  # over which the tracking error is measured, where no turn is known
TURN = "turn_time"  # s: what comes again in every turn is measured over one
SWAY = "amplitude", "period"  # of joint_pd.c, whose joints sway at frequencies of their own
LONGEST_S = 10.0  # that the picture holds
ERRORS = ("e", "err", "error")


class Standing(StrEnum):
    """Whether a program can take the compensation of a diagnosis, and whether it acts."""

    NOTHING = "nothing"  # there is none: no torque can cancel it
    NO_PROGRAM = "no program"
    NO_ROOM = "no room"  # the program does not take it
    ON = "on"
    OFF = "off"
    OTHER = "other"  # that of something else is on


class LoopActions(LabScreen):
    """Actions on a diagnosis."""

    shown: Diagnosed | None

    def __init__(self) -> None:
        super().__init__()
        self.entries: list[Entry] = []  # lines that are shown
        self.coming: Diagnosed | None = None  # that is being made
        self.compensation: Compensation | None = None
        self.before: dict[str, float] = {}  # tracking errors before it was last switched on
        self._errors: tuple[Channel, ...] = ()
        self._followed: History | None = None
        self._state: Standing | None = None
        self._measuring = False  # the error without it, before it is switched on

    def _need(self) -> Diagnosed | None:
        if self.shown is None:
            self.say("diagnose first (s), or open an earlier one (o)", "warning")
        elif self.shown is self.coming:
            self.say("its figures are being drawn: in a moment", "warning")
            return None
        return self.shown

    # -- compensation in the running program

    def loop_entry(self, d: Diagnosed) -> Entry:
        """The line on the compensation of a diagnosis."""
        try:
            self.compensation = compensation_of(d)
        except (ZendspError, OSError):
            self.compensation = None
        self._state, self.before = None, {}
        return Entry(LOOP, self._line(self.lab.session.snapshot))

    def _line(self, s: Snapshot) -> Text:
        text = Text("loop".ljust(LABEL), "dim")
        text.append(self._standing(s)[1], "not dim")
        return text

    def _standing(self, s: Snapshot) -> tuple[Standing, str]:
        """The `Standing` of the running program, and a sentence on it."""
        c = self.compensation
        names = [v.name for v in s.variables]
        if self._acts(s) and (c is None or not c.fits(names) or not c.acts(s.values)):
            what = "nothing to cancel" if c is None or not c.values else "not of this diagnosis"
            return Standing.OTHER, f"{what}; the compensation in the program is on; c fades it out"
        if self.shown is not None and not self.shown.report["findings"]:
            return Standing.NOTHING, "nothing is named that a torque could cancel"
        if c is None or not c.values:
            return Standing.NOTHING, "nothing of it can be cancelled by a torque (c says why)"
        if not names:
            words = "compensation: needs a program (build and start it on Console, F2)"
            return Standing.NO_PROGRAM, words
        if not c.fits(names):
            return Standing.NO_ROOM, "compensation: c prepares the program for it"
        if c.acts(s.values):
            return Standing.ON, "compensation is on; c fades it out"
        return Standing.OFF, "compensation is off; c fades it in"

    @staticmethod
    def _acts(s: Snapshot) -> bool:
        """Whether the program adds a compensation now, of this or another diagnosis."""
        return s.link == LinkState.UP and float(s.values.get(SHARE, 0.0)) > 0.0

    def look_at_loop(self, s: Snapshot) -> None:
        """Bring the line on the compensation and its figures up to date."""
        state, _ = self._standing(s)
        if state != self._state:
            self._state = state
            lines = self.query_one("#findings", OptionList)
            lines.replace_option_prompt(LOOP, Hanging(self._line(s)))
        if self.query_one("#loop").display:
            self.query_one("#loop-words", Static).update(self._figures(state))

    def _figures(self, state: Standing) -> str:
        now = self._rms()
        parts, units = [], [channel.unit for channel in self._errors]
        for channel, following in zip(self._errors, [*units[1:], ""], strict=True):
            name, value = channel.name, now.get(channel.name)
            if value is None:
                continue
            was = self.before.get(name)
            before = f"{was:.3g} → " if was is not None and state == Standing.ON else ""
            unit = f" {channel.unit}" if channel.unit != following else ""
            parts.append(f"{name} {before}{value:.3g}{unit}")
        rms = "  ".join(parts) or "no program runs"
        state = Standing.ON if state == Standing.OTHER else state
        return f"compensation {state}: rms over {self._look_s():g} s  {rms}"  # 80 columns

    def _look_s(self) -> float:
        """The time over which the tracking error is measured, s: one turn of the program's circle,
        or periods of its sway.
        """
        return look_s(self.lab.session.snapshot.values)

    def _rms(self) -> dict[str, float]:
        if self._followed is None or self.lab.session.snapshot.state != ProgramState.RUNNING:
            return {}
        t, y = self._followed.since(self._followed.latest - self._look_s())
        if len(t) < 2:
            return {}
        with np.errstate(invalid="ignore"):
            values = np.sqrt(np.nanmean(y * y, axis=0))
        return {c.name: float(v) for c, v in zip(self._errors, values, strict=True)}

    def follow_loop(self) -> None:
        """Draw the tracking errors live."""
        snapshot = self.lab.session.snapshot
        units = {v.name: (v.unit, v.length) for v in snapshot.variables}
        names = [n for n in units if n.rstrip("0123456789") in ERRORS and n.startswith("e")]
        scalars = [n for n in names if units[n][1] == 1] or names or list(usual_channels(snapshot))
        channels: list[Channel] = []
        for name in scalars:
            unit, length = units.get(name, ("", 1))
            many = [f"{name}[{k}]" for k in range(length)] if length > 1 else [name]
            channels += [Channel(n, unit) for n in many]
        if tuple(channels[:8]) == self._errors and self.lab.session.history is self._followed:
            return
        self._errors = tuple(channels[:8])
        if not self._errors:
            return
        self._followed = self.lab.session.watch(self._errors)
        scope = self.query_one("#loop-scope", Scope)
        scope.show_channels(self._errors, self._followed)
        scope.set(replace(scope.settings, window=10.0))

    def action_compensate(self) -> None:
        """Switch the compensation on or off, or prepare the program for it."""
        s, c = self.lab.session.snapshot, self.compensation
        if self._measuring:
            return
        if self._acts(s):  # that can be ended at any time
            self._switch({SHARE: 0.0}, "out")
            return
        if self._need() is None:
            return
        state, words = self._standing(s)
        if state == Standing.NOTHING or c is None:
            left_out = "\n".join(c.left_out) if c else ""
            named = self.shown is None or bool(self.shown.report["findings"])
            nothing = "Nothing of it can be cancelled by a torque." if named else f"{words}."
            text = left_out or f"{nothing[:1].upper()}{nothing[1:]}"
            self.app.push_screen(Message("Compensation", Text(text)))
        elif state == Standing.NO_PROGRAM:
            self.say(words, "warning")
        elif state == Standing.NO_ROOM:
            self._offer_room(c)
        else:
            self._fade_in()

    def _fade_in(self) -> None:
        """Measure the tracking error without the compensation, then fade it in."""
        self._show_loop()
        self.follow_loop()

        def measured() -> None:
            self._measuring = False
            c, (state, words) = self.compensation, self._standing(self.lab.session.snapshot)
            if c is not None and state == Standing.OFF:
                self.before = self._rms()
                self._switch({**c.values, SHARE: 1.0}, "in")
            else:
                self.say(f"not faded in: {words}", "warning")

        self._measuring = True
        if self.lab.session.snapshot.state == ProgramState.RUNNING and not self._rms():
            self.set_timer(self._look_s(), measured)
        else:
            measured()

    def _show_loop(self) -> None:
        if self.entries:
            self.query_one("#findings", OptionList).highlighted = len(self.entries) - 1

    def _switch(self, values: Mapping[str, float], word: str) -> None:
        self._show_loop()
        fade = self.lab.session.snapshot.values.get("comp_fade", 0.0)

        def said(tick: int) -> None:
            self.say(f"compensation fades {word} over {fade:g} s from sample {tick} on", "good")

        self.ask("compensation", lambda port: port.update(values), said)

    def _offer_room(self, c: Compensation) -> None:
        """Offer to add the call of the compensation to the chosen source, else to the source of the
        loaded program.
        """
        source = self.lab.source
        if source is None:
            self.lab.expect_dialog()
            asked = self.ask(
                "program", lambda port: port.program(), lambda p: self._offer_loaded(c, p)
            )
            asked.add_done_callback(
                lambda done: self.app.call_later(self.lab.no_dialog) if done.exception() else None
            )
            return
        try:
            texts = gather(source)
        except ZendspError as error:
            self.say(str(error), "error")
            return
        self._offer(c, self._place(source), texts)

    def _offer_loaded(self, c: Compensation, program: Program) -> None:
        try:
            place, texts = written_out(program, self.lab.workspace.root)
        except (ZendspError, OSError) as error:
            text = f"{error}.\n\nChoose its source on Console (F2, O), then press c here again."
            self.app.push_screen(Message("Compensation", Text(text)))
            return
        definitions = [flag for flag in program.flags if flag.startswith("-D")]
        self._offer(c, place, texts, definitions)

    def _offer(
        self, c: Compensation, place: Path, texts: Mapping[str, str], flags: Sequence[str] = ()
    ) -> None:
        if not has_room(texts):
            text = (
                f"{place.name} has no room for a compensation yet. {FILE} is written to\n"
                f"{place.parent}; the program takes it with three lines:\n\n"
                f"{LINES}\n\n"
                "Then build it (b on Console)."
            )
            self.app.push_screen(
                Message("Compensation", Text(text), agree=f"Write {FILE}"),
                lambda yes: self._keep(c, place, texts) if yes else None,
            )
            return
        text = (
            f"{place.name} takes a {FILE} that lies beside it. It is written to\n{place.parent},"
            " and the program is built and downloaded. The compensation is off until you start"
            " the program (Console) and press c here again."
        )
        if self.lab.session.snapshot.state == ProgramState.RUNNING:
            self.lab.no_dialog()
            self.say("pause the program first (p on Console): it is built anew", "warning")
            return
        self.app.push_screen(
            Message("Compensation", Text(text), agree="Write and build"),
            lambda yes: self._build(c, place, texts, flags) if yes else None,
        )

    def _place(self, source: Path) -> Path:
        """The path of the program that is to take the compensation; a shipped program is copied
        here first.
        """
        shipped = source.parent in {p.parent for p in self.lab.examples()}
        return self.lab.workspace.root / source.name if shipped else source

    def _keep(self, c: Compensation, place: Path, texts: Mapping[str, str]) -> None:
        self._write(c, place, texts)

    def _write(self, c: Compensation, place: Path, texts: Mapping[str, str]) -> bool:
        try:
            for name, text in texts.items():
                file = place.parent / name
                if not file.exists():
                    file.write_text(text, encoding="utf-8")
            shutil.copyfile(c.source, place.parent / FILE)
        except OSError as error:
            self.say(f"{FILE} is not written: {error}", "error")
            return False
        self.lab.source = place
        self.say(f"wrote {place.parent / FILE}", "good")
        return True

    def _build(
        self, c: Compensation, place: Path, texts: Mapping[str, str], flags: Sequence[str]
    ) -> None:
        if not self._write(c, place, texts):
            return

        def job(port: Port) -> Build:
            build = port.build({**texts, **gather(place)}, flags)
            if build.ok:
                port.update({SHARE: 0.0})
            return build

        def done(build: Build) -> None:
            first = next((r for r in build.remarks if r.severity == Severity.ERROR), None)
            if first is not None:
                self.say(f"{first.file}:{first.line}: {first.message}", "error")
            else:
                self.say(f"built with {FILE}: enable and start it on Console (F2), then c", "good")

        self.ask("build", job, done)

    # -- files

    def action_report(self) -> None:
        """Open the report in a browser."""
        d = self._need()
        if d is not None:
            self.run_worker(lambda: self._open_page(d.page), thread=True, group="page")

    def _open_page(self, page: Path) -> None:
        if not (self.app.is_web or not graphical()) and webbrowser.open(page.as_uri()):
            self.app.call_from_thread(self.say, f"opened {page}")
            return
        words = f"No browser can be opened from here. The report is\n\n{page}"
        self.app.call_from_thread(self.app.push_screen, Message("Report", Text(words)))

    def action_save(self) -> None:
        """Ask where to save the improved model."""
        d = self._need()
        if d is None:
            return
        default = self.lab.workspace.root / f"{Path(d.model).stem}_improved.toml"
        form = Form("Save the improved model", [Field("path", "To", str(default), check=not_empty)])

        def write(r: Mapping[str, str] | None) -> None:
            if not r:
                return
            path = Path(r["path"]).expanduser()
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(d.folder / "model.toml", path)
            except OSError as error:
                self.say(f"the model is not saved: {error}", "error")
                return
            self.say(f"improved model saved: {path}", "good")
            self.lab.toast(f"saved {path}")

        self.app.push_screen(form, write)

    def compare_with(self, other: Diagnosed) -> None:
        """Show the differences between the shown diagnosis and another."""
        if self.shown is not None:
            try:
                text = compare(other, self.shown)
            except (OSError, ValueError, KeyError) as error:
                self.say(f"compare: {error}", "error")
                return
            self.app.push_screen(Message("Compare", Text(text)))

    # -- the next motion

    def action_next(self) -> None:
        """Open the proposed motion on Execute; its run is diagnosed together with the others."""
        d = self._need()
        if d is None:
            return
        reference = d.next_reference
        if reference is None:
            proposal = d.report["next_recording"]
            if proposal:
                self.say(f"no motion was planned; by hand: {proposal['sentence']}", "warning")
            else:
                self.say("no motion is proposed: none is known to tell more", "warning")
            return
        folder = self.lab.workspace.references
        folder.mkdir(parents=True, exist_ok=True)
        place = folder / f"next-{d.folder.name}.mat"
        shutil.copyfile(reference, place)
        self.lab.await_run(place, lambda run: self.take_next(d, run))
        self.lab.play(place)
        self.say("start it here (s): its run is diagnosed together with the others", "good")

    def take_next(self, d: Diagnosed, run: Run) -> None:
        """Diagnose a run together with the recordings of a diagnosis."""
        raise NotImplementedError


def look_s(values: Mapping[str, Value]) -> float:
    """The time over which the tracking error of a program with these values is compared, s: one
    turn, as many periods of a sway as fit into the picture, or LOOK_S.
    """
    number = {name: x for name, x in values.items() if isinstance(x, int | float)}
    turn = 0.0 if values.get("use_table") else number.get(TURN, 0.0)
    if not turn and number.get(SWAY[0]):
        period = number.get(SWAY[1], 0.0)
        turn = period * (LONGEST_S // period) if period > 0.0 else 0.0
    return turn if 0.0 < turn <= LONGEST_S else LOOK_S


def graphical() -> bool:
    """Whether a browser would open a window of its own; a text browser would take over this
    terminal.
    """
    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return False
    in_terminal = type(browser) is webbrowser.GenericBrowser
    return not in_terminal
