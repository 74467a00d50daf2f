"""The terminal's view of a target, on top of :class:`zendsp.link.Target`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import CompileFailed, LinkError, RunnerDied, ZendspError
from zendsp.here.stopped import stopped
from zendsp.link import Rehearsal, Target, Trigger, connect, discover, local, rehearse
from zendsp.link.live import LiveBlock
from zendsp.link.outside import outside, positions
from zendsp.link.put_back import Before
from zendsp.link.variables import plain
from zendsp.link.way_back import HOLD, way_back
from zendsp.recording import Recording
from zendsp.tui.port import Build, Shot, Sink, Swing, Tell, Tries
from zendsp.tui.snapshot import LinkState, Snapshot, TripView, Variable
from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveAction, ProgramState, RecorderState, VariableKind
from zendsp_protocol.values import Assignable, Value

if TYPE_CHECKING:
    from zendsp.experiment import FrequencyResponse, Sweep

FADE_S = 0.5  # of values that are taken over from a table
LIVE_RATE = 5000.0  # rows a second of a live curve at the most
LIVE_INTERVAL_S = 0.02  # between live messages: a screen needs no more
LOST_EVERY = 5  # snapshots between looks at the recorder and the limits
RECORDING = (RecorderState.ARMED, RecorderState.RUNNING)
SHOWN_ELEMENTS = 64  # longer arrays are not read for the table


class LinkPort:
    """Implements ``zendsp.tui.port.Port``."""

    def __init__(self, target: Target, here: bool = False) -> None:
        self.target = target
        self.here = here  # started by this terminal, and ends with it
        self._program = ""
        self._variables: tuple[Variable, ...] = ()
        self._names: list[str] = []
        self._described: m.MachineInfo | None = None
        self._limits: m.Limits | None = None
        self._looked = 0
        self._recorder: m.AcquireStatus | None = None

    # -- what is

    @property
    def over(self) -> bool:
        """Whether the target's process has ended."""
        return self.target.link.over

    def farewell(self) -> bool | None:
        """Whether its machine is safe, as a target that ends by itself said; waits for it."""
        return self.target.link.farewell()

    def snapshot(self) -> Snapshot:
        """Everything that a screen shows, by at most six quick requests."""
        asked, begin = time.monotonic(), time.perf_counter()
        s = self.target.status()
        latency = time.perf_counter() - begin
        drive = self.target.drive_status()
        if s.program != self._program or (s.program and not self._variables):
            self._learn(s.program)
        values: Mapping[str, Value] = {}
        if self._names and s.state not in (ProgramState.EMPTY, ProgramState.CRASHED):
            with contextlib.suppress(RunnerDied):
                values = self.target.read(self._names).values
        if self._looked % LOST_EVERY == 0 or (
            self._recorder is not None and self._recorder.state in RECORDING
        ):
            with contextlib.suppress(ZendspError):
                self._recorder = self.target.acquire_status()
        if self._described is not None and (self._limits is None or self._looked % LOST_EVERY == 0):
            with contextlib.suppress(RunnerDied):
                self._limits = self.target.limits()
        self._looked += 1
        if not self.target.alive:
            raise LinkError(f"target {self.target.name} is out of reach")
        return replace(self._make(s, drive, values, latency), asked=asked)

    def _make(
        self, s: m.Status, drive: m.DriveStatus, values: Mapping[str, Value], latency: float
    ) -> Snapshot:
        t, recorder, described = s.timing, self._recorder, self._described
        away = outside(s, described.joints, self._limits) if described and self._limits else ()
        io = {name: np.ravel(np.asarray(plain(value))) for name, value in s.io.items()}
        return Snapshot(
            link=LinkState.UP,
            target=self.target.name,
            machine=s.machine,
            joints=s.joints,
            described=described,
            limits=self._limits,
            state=s.state,
            drive=drive.state,
            homing=s.homing,
            explicit=drive.explicit,
            program=s.program,
            clock=s.clock,
            tick=s.tick,
            t=s.t,
            rate_hz=s.rate_hz,
            exec_mean_ns=t.exec_mean_ns,
            exec_max_ns=float(t.exec_max_ns),
            late_max_ns=float(t.late_max_ns),
            overruns=t.overruns,
            missed=t.missed,
            lost=recorder.lost if recorder is not None else 0,
            latency_s=latency,
            commander=drive.commander,
            moved_by="you" if drive.moved_by == self.target.link.author else drive.moved_by,
            mine=bool(drive.commander) and drive.commander == self.target.link.author,
            recording=recorder is not None and recorder.state in RECORDING,
            host_lost=drive.host_lost,
            trip=_trip(s.trip),
            crash=s.crash or s.unsafe,
            unsafe=s.unsafe,
            own=s.own,
            scheduling=s.scheduling,
            io=io,
            position=positions(s, described.joints) if described and s.homed else (),
            outside=away,
            conditions=tuple((c.name, c.met, c.advice) for c in drive.conditions),
            steps=way_back(s, drive, self.target.link.author, values.get(HOLD) is True, bool(away)),
            variables=self._variables,
            values=values,
        )

    def _learn(self, program: str) -> None:
        """Read the dictionary of a new program: its own variables first, then the runtime's
        signals.
        """
        self._program = program
        if not program:
            self._variables, self._names, self._described, self._limits = (), [], None, None
            return
        self._described, self._limits = self.target.machine(), None
        own = [_variable(info, info.kind) for info in self.target.variables().values()]
        names = {v.name for v in own}
        builtin = [
            _variable(info, VariableKind.SIGNAL)
            for info in self.target.builtins().values()
            if info.name not in names
        ]
        self._variables = (*own, *builtin)
        self._names = [
            v.name
            for v in self._variables
            if v.kind != VariableKind.TABLE and v.length <= SHOWN_ELEMENTS
        ]

    # -- live

    def live(self, names: Sequence[str], sink: Sink) -> Callable[[], None]:
        """Subscribe to signals; return a function that ends it."""
        rate = self.target.info.rate_hz
        decimation = max(1, round(rate / LIVE_RATE))

        def take(block: LiveBlock) -> None:
            sink(block.tick + decimation * np.arange(len(block.t)), block.data, 1.0 / rate)

        view = self.target.live(
            names, decimation=decimation, interval=LIVE_INTERVAL_S, history=0.1, callback=take
        )
        return view.close

    # -- program

    def stop(self) -> str:
        """STOP; returns how it ended."""
        return stopped(self.target.stop())

    def start(self, ticks: int | None = None) -> None:
        """Start or continue the program. It goes on if this terminal dies."""
        self.target.start(ticks, attended=True)

    def pause(self) -> None:
        """Pause the program."""
        self.target.pause()

    def program(self) -> m.Program:
        """The loaded program as it was sent."""
        return self.target.program()

    def build(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> Build:
        """Compile, and load if that succeeded."""
        try:
            result = self.target.compile(dict(sources), flags)
        except CompileFailed as error:
            failed = getattr(error, "result", None)
            if failed is None:
                raise
            return Build(False, failed.seconds, failed.cached, failed.diagnostics)
        self.target.load(result.key)
        self._program = ""
        return Build(True, result.seconds, result.cached, result.diagnostics)

    # -- variables

    def write(self, values: Mapping[str, Assignable]) -> int:
        """Write asynchronously, then wait until the target says that it is in effect."""
        sequence = self.target.write(**values)
        applied: m.Applied = self.target.request("wait_applied", sequence=sequence, timeout=2.0)
        return applied.tick

    def update(self, values: Mapping[str, Assignable]) -> int:
        """Apply all values in one sample."""
        return self.target.update(None, **values)

    def fade(self, values: Mapping[str, Assignable]) -> int:
        """Move numbers gradually to their values while the program runs."""
        return self.target.fade(FADE_S, **values)

    def before(self, names: Iterable[str]) -> Before:
        """The present values of variables, to be restored after a run."""
        return Before(self.target, names, moves=True)

    def fill(self, name: str, rows: npt.NDArray[np.float64]) -> int:
        """Send a table."""
        return self.target.upload(name, rows)

    def rehearse(
        self,
        tables: Mapping[str, npt.NDArray[np.float64]],
        values: Mapping[str, Assignable],
        seconds: float,
        tell: Callable[[float], None],
    ) -> Rehearsal:
        """Try a run on a simulated twin of the machine; this one does not move."""
        return rehearse(self.target, tables, values, seconds, tell)

    def respond(self, asked: Swing, channels: Sequence[str], tell: Tell) -> FrequencyResponse:
        """Measure a frequency response."""
        from zendsp.experiment import frequency_response

        return frequency_response(self.target, **vars(asked), channels=channels, progress=tell)

    def sweep(self, asked: Tries, on_run: Callable[[Sweep], None], tell: Tell) -> Sweep:
        """Try values of parameters on the running program."""
        from zendsp.experiment import sweep
        from zendsp.experiment.sweep import tried_of

        return sweep(
            self.target, tried_of(asked.words.split()), asked.channels.split(),
            seconds=asked.seconds, settle=asked.settle, measures=asked.measures.split(),
            together=asked.together, on_run=on_run, progress=tell,
        )  # fmt: skip

    # -- drives

    def drive(self, action: DriveAction, **values: Any) -> str:
        """Ask the drives for an action, and wait for a homing."""
        if action == DriveAction.HOME:
            return self.target.home_and_wait()
        if action == DriveAction.ACKNOWLEDGE:
            return self.target.acknowledge(**values)
        said: m.Said = self.target.request("drive", action=action, **values)
        return said.text

    # -- acquisition

    def arm(self, shot: Shot) -> None:
        """Configure and start the recorder."""
        self.target.acquire_configure(shot.channels, shot.seconds, shot.decimation, _trigger(shot))
        self.target.acquire_start()

    def recorded(self) -> bool:
        """Whether the recorder has ended."""
        return self.target.acquire_status().state not in RECORDING

    def end_acquisition(self) -> None:
        """Stop the recorder; its rows stay."""
        self.target.acquire_stop()

    def load(self, note: str = "") -> Recording:
        """Load the rows that the recorder holds."""
        return self.target.acquire_load(note)

    def acquire(self, shot: Shot, note: str = "") -> Recording:
        """Record, wait until it is complete, and load the rows."""
        return self.target.acquire(
            shot.channels, shot.seconds, shot.decimation, _trigger(shot), note=note
        )

    def close(self) -> None:
        """End the connection. The target goes on, unless it was started here."""
        self.target.close()


def _trip(trip: m.Trip | None) -> TripView | None:
    if trip is None:
        return None
    return TripView(trip.reason, trip.tick, trip.text or trip.reason, trip.number, trip.cause)


def _variable(info: m.VariableInfo, kind: VariableKind) -> Variable:
    written = (VariableKind.PARAMETER, VariableKind.TABLE)
    kind = kind if kind in written else VariableKind.SIGNAL
    return Variable(
        info.name, info.type, info.length, kind, info.unit, info.minimum, info.maximum,
        plain(info.initial), info.description, info.columns,
    )


def _trigger(shot: Shot) -> Trigger | None:
    return (
        Trigger(source=shot.trigger, level=shot.level, edge=shot.edge, pre_s=shot.pre_s)
        if shot.trigger
        else None
    )


def open_port(name: str) -> LinkPort:
    """Connect to a target by name."""
    return LinkPort(connect(name))


def find_targets() -> list[tuple[str, str]]:
    """The targets that answer, as (name, description)."""
    found = []
    for target in discover():
        info = target.info
        words = (
            f"{info.machine}, {info.rate_hz:g} Hz, {info.clock} clock, {info.hostname}"
            if info
            else target.problem
        )
        found.append((target.name, words))
    return found


def start_machine(machine: str, clock: str = "real") -> tuple[str, LinkPort]:
    """Start a simulated machine in a process of its own; it ends with this terminal."""
    target = local(machine, clock=clock)
    return target.name, LinkPort(target, here=True)
