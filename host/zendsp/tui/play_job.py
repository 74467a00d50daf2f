"""One run, from Start to its folder on disk, on a thread of its own; the screen reads its
``progress``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import Refused, ZendspError
from zendsp.link.put_back import Before
from zendsp.recording import Recording
from zendsp.recording.notes import CutNote
from zendsp.reference import Machine, Reference
from zendsp.tui.job import Job, Progress
from zendsp.tui.playing import Player, Setup, present_position
from zendsp.tui.port import Port, Shot
from zendsp.tui.runs import Outcome, Run, store_run
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp.tui.trial import Plan, Trial, make_plan
from zendsp_protocol.states import LATCHED, Clock, DriveState, ProgramState, VariableKind

LOOK_S = 0.05
REST_S = 1.0  # for an arm to come to rest under its control law
# of the drives: no command moves the arm
SAFE = (DriveState.OFF, DriveState.READY, DriveState.HOMED, *LATCHED)
USUAL = ("r", "q", "qd", "e", "tau")  # recorded where the user chose no channels


def usual_channels(snapshot: Snapshot) -> tuple[str, ...]:
    """The reference, position, velocity, error and command signals that the program declares,
    arrays first.
    """
    names = [v.name for v in snapshot.variables if v.kind == VariableKind.SIGNAL]
    chosen = [n for n in USUAL if n in names]
    for stem in USUAL:
        if stem not in chosen:
            chosen += [n for n in names if n.startswith(stem) and n[len(stem) :].isdigit()]
    return tuple(chosen) or tuple(names[:8])


class PlayJob(Job[Run | None]):
    """Moves to the start, plays, records, returns, and stores the run."""

    def __init__(
        self,
        session: Any,
        references: Sequence[Reference],
        files: Sequence[Path],
        machine: Machine,
        setup: Setup,
        runs: Path,
        sources: dict[str, str],
        trial: Trial,
    ) -> None:
        super().__init__(session, "run")
        self._references, self._files = tuple(references), tuple(files)
        self._machine, self._setup, self._runs, self._sources = machine, setup, runs, sources
        self._trial = trial
        self._records = False  # the target has been asked to

    def saved(self) -> str:
        """How the rows come home that the target still holds."""
        now = self._session.snapshot
        if not self._records or now.link == LinkState.ENDED:
            return ""
        return (
            f"; once it is back, zendsp acquire --last -t {now.target} -o FILE brings home what was"
            " recorded until then; the next recording replaces it"
        )

    def _do(self, port: Port) -> Run | None:
        snapshot = port.snapshot()
        if snapshot.state == ProgramState.RUNNING:  # what is tried begins where the arm then is
            port.pause()
            snapshot = port.snapshot()
        plan = make_plan(snapshot, self._references, self._machine, self._setup)
        if not self._rehearse(port, plan):
            return None
        before = port.before([*plan.values, *plan.tables])
        try:
            first, outcome, why = self._move(port, plan)
            if self._setup.acquire:
                self._end_acquisition(port, outcome)
        finally:
            self._put_back(port, before)
        if not self._setup.acquire:
            return None
        begins, ends = plan.playlist.play
        return self._keep(port, first, outcome, why, (begins + plan.lead, ends + plan.lead))

    def _move(self, port: Port, plan: Plan) -> tuple[Snapshot, Outcome, str]:
        """Play the motion; return the values before it, the outcome, and its reason."""
        playlist = plan.playlist
        for name, rows in plan.tables.items():
            port.fill(name, rows)
        if plan.values:
            port.update(plan.values)
        before = port.snapshot()
        if self._setup.acquire:
            port.arm(self._shot(before, plan.seconds))
            self._records = True
        ticks = round(plan.seconds * before.rate_hz) if before.clock == Clock.FAST else None
        self._session.events.add(f"run: {playlist.duration:.2f} s, {len(playlist.rows)} rows")
        port.start(ticks)
        return before, *self._follow(port, plan, before.tick)

    def _put_back(self, port: Port, before: Before) -> None:
        """Pause a program that still moves, and restore what the run has set, on which a later
        start relies.
        """
        try:
            snapshot = port.snapshot()
            if snapshot.state == ProgramState.RUNNING and snapshot.drive not in SAFE:
                port.pause()
            why = before.put_back()
        except ZendspError as error:
            why = f"the program is as the run has set it: {error}"
        if why:
            self._session.events.add(f"run: {why}", "warning")

    def _rehearse(self, port: Port, plan: Plan) -> bool:
        """Try the run on a simulated twin before anything moves, unless the preflight has done so.
        Returns False where it was aborted meanwhile.
        """

        def tell(share: float) -> None:
            self.progress = Progress("simulating", share)

        tell(0.0)
        found = self._trial.found(plan) or port.rehearse(
            plan.tables, plan.values, plan.seconds, tell
        )
        if found.trip is not None:
            raise Refused(f"nothing was moved: {found.text}")
        not_tried = "" if found.simulated else "not tried: "
        self._session.events.add(
            f"run: {not_tried}{found.text}", "info" if found.good else "warning"
        )
        return not self._abort.is_set()

    def _shot(self, snapshot: Snapshot, total: float) -> Shot:
        s = self._setup
        channels = s.channels or usual_channels(snapshot)
        return Shot(channels, total, s.decimation, s.trigger, s.level, s.edge, s.pre_s)

    def _come_to_rest(self, port: Port, player: Player, clock: str) -> None:
        """Bring the motion to rest, and pause once the arm stands: a pause in motion would let it
        coast.

        A program without ``hold`` is given the present position as its reference, which is a step.
        """
        holds = "hold" in player.parameters
        here = None if holds else present_position(port.snapshot(), self._machine.joints)
        if holds:
            port.update({"hold": True})
        if here is not None:
            if player.torque_table:
                port.fill(player.torque_table, np.zeros((1, len(here))))
            port.fill(player.table, np.repeat(here[None, :], 2, axis=0))
        if clock == Clock.REAL:
            time.sleep(REST_S)
        port.pause()
        if holds:
            port.update({"hold": False})

    def _follow(self, port: Port, plan: Plan, first: int) -> tuple[Outcome, str]:
        """Watch the run until its end; return the outcome and its reason."""
        playlist, lead, total = plan.playlist, plan.lead, plan.seconds
        while True:
            s = port.snapshot()
            t = (s.tick - first) / s.rate_hz - lead
            self.progress = Progress(
                playlist.phase(max(t, 0.0)), min(max(t / playlist.duration, 0.0), 1.0), t,
                playlist.duration,
            )
            if s.trip is not None:
                return Outcome(DriveState.latched(s.trip.reason)), s.trip.text
            if s.drive in LATCHED:
                return Outcome.STOPPED, ""
            if s.crash or s.state == ProgramState.CRASHED:
                return Outcome.CRASHED, s.crash
            if t >= total - lead - 0.5 / s.rate_hz:  # half a sample: of rounding
                return Outcome.COMPLETE, ""
            if s.state == ProgramState.PAUSED:
                return Outcome.PAUSED, f"at {self.progress.share:.0%} of it"
            if self._abort.wait(LOOK_S):
                self._come_to_rest(port, plan.player, s.clock)
                return Outcome.ABORTED, ""

    def _end_acquisition(self, port: Port, outcome: Outcome) -> None:
        self.progress = replace(self.progress, phase="loading")
        if outcome != Outcome.COMPLETE:
            port.end_acquisition()
        else:
            self._wait_acquired(port)

    def _keep(
        self, port: Port, before: Snapshot, outcome: Outcome, why: str, play: tuple[float, float]
    ) -> Run:
        recording = port.load(self._setup.note)
        if outcome == Outcome.COMPLETE and not self._setup.trigger:
            recording = cut(recording, before.tick, before.rate_hz, play)
        recording = replace(recording, sources=recording.sources or self._sources)
        name = self._setup.name or "+".join(p.stem for p in self._files) or "run"
        run = store_run(
            self._runs, name, recording, references=self._files, outcome=outcome, why=why
        )
        self.progress = replace(self.progress, phase=run.ending, share=1.0)
        return run

    def _wait_acquired(self, port: Port) -> None:
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            if port.recorded():
                return
            time.sleep(LOOK_S)
        port.end_acquisition()


def cut(
    recording: Recording, first_tick: int, rate_hz: float, play: tuple[float, float]
) -> Recording:
    """The rows of the motion itself, without the way to its start and the way home."""
    start = (recording.start_tick - first_tick) / rate_hz
    step = recording.decimation / rate_hz
    a = max(round((play[0] - start) / step), 0)
    b = min(round((play[1] - start) / step), len(recording))
    if b - a < 2:
        return recording
    return replace(
        recording,
        t=recording.t[a:b],
        data=recording.data[a:b],
        start_tick=recording.start_tick + a * recording.decimation,
        extra={**recording.extra, "cut": CutNote(first_row=a, rows=b - a, of=len(recording))},
    )
