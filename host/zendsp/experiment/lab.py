"""The place where experiments are made: a target, local or remote, a folder that keeps every
recording, and reports of progress.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError, Refused, Unmeasured, ZendspError
from zendsp.experiment.coarse import cutoff_for
from zendsp.experiment.early_end import (
    LOST_S,
    Fetched,
    ending,
    keep_early,
    not_waiting,
    watching,
)
from zendsp.experiment.names import result_file
from zendsp.experiment.registry import EXPERIMENTS
from zendsp.experiment.result import Result
from zendsp.experiment.watch import Held, Seen, cause, check, guarded, look
from zendsp.here.stopped import ended
from zendsp.here.uninterrupted import uninterrupted
from zendsp.link import Target
from zendsp.link.outside import positions
from zendsp.link.put_back import GONE, Loaded, kept
from zendsp.recording import Recording
from zendsp.recording.files import save_anyhow
from zendsp.reference import Reference
from zendsp_protocol.messages import MachineInfo
from zendsp_protocol.states import Clock, DriveState, HostLost, ProgramState

Say = Callable[[str], None]
Array = npt.NDArray[np.float64]
IDLE = {"idle.c": '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'}
HOLDS = "joint_pd.c"  # without a reference it holds every joint where it stands
RESTS = 1  # phase of push.c: later ones are of the push itself
STILL = 0.01  # rad, m, and of its range: a joint that has moved by less stands where it stood
ENDING = 20  # rows of a recording, that tell what holds the joints at its end
BRAKE_S = 1.0  # under the loop's eye, before the program is taken away


class Lab:
    """Opens targets and keeps their recordings.

    Parameters
    ----------
    folder : path
        Made where it does not exist.
    target : Target, optional
        The machine, already connected. Default: a simulated one is started here for each
        experiment, on the fast clock.
    say : callable, optional
        Told what begins, a line at a time.
    seed : int
        Of what an experiment draws (start positions), and of the noise of a machine that is started
        here.
    model : path, optional
        Model file of the machine, for the experiments that need one.

    Examples
    --------
    >>> Lab("experiments").target is None
    True
    """

    def __init__(
        self,
        folder: str | Path,
        target: Target | None = None,
        say: Say | None = None,
        seed: int = 1,
        model: str | Path | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.seed = seed
        self.random = np.random.default_rng(seed)
        self.target = target
        self.model = Path(model) if model is not None else None
        self.say: Say = say or (lambda text: None)
        self.left = ""  # what the latest experiment left that ended early, in words

    def machine_of(self, name: str) -> str:
        """Name of the machine on which an experiment is made here: the target's, else the one that
        is started for it.
        """
        if self.target is not None:
            return self.target.info.machine
        return EXPERIMENTS[name].shipped

    def shipped(self, name: str) -> str:
        """Name of the shipped machine on which an experiment is made here; "" where it is another,
        which may be a MuJoCo model of that name.
        """
        if self.target is not None and told(self.target).model:
            return ""
        return self.machine_of(name)

    @contextmanager
    def bench(
        self, name: str, result: Result | None = None, **options: Any
    ) -> Iterator[Bench]:
        """A machine to experiment with. At the end of the block it stands still, and the program
        that was loaded before is loaded again but not started.

        Parameters
        ----------
        name : str
            Of the experiment: its folder, and what it needs of the target.
        result : Result, optional
            What the experiment fills. Where it ends early, what is in it by then is written as
            ``result_ended.toml``, and `left` says so.
        **options
            Settings of a simulated machine that is started here; a target that is given must have
            them already.

        Raises
        ------
        Refused
            The target that was given lacks what the experiment needs, or its drives are not enabled
            where the explicit sequence is in use.
        """
        folder, experiment = self.folder / name, EXPERIMENTS[name]
        if self.target is not None:
            drives = self.target.drive_status()
            if drives.explicit and drives.state not in (DriveState.ENABLED, DriveState.RUNNING):
                raise Refused(
                    f"experiment {name} moves the machine, and its drives are {drives.state}: power"
                    " them on, home, enable (zendsp load pd.c && zendsp drive on && zendsp drive"
                    " home && zendsp drive enable), then begin again"
                )
            machine = told(self.target)
            if lacks := experiment.lacking(machine, self.model is not None):
                raise Refused(f"experiment {name} {lacks}")
            folder.mkdir(parents=True, exist_ok=True)
            bench = Bench(self.target, folder, self.say, machine, drives.explicit)
            bench.host_lost = drives.host_lost
            yield from self._guard(bench, result)
            return
        from zendsp.link import local

        folder.mkdir(parents=True, exist_ok=True)
        arguments = [
            part
            for key, value in {"seed": self.seed, **options}.items()
            for part in ("--machine-option", f"{key}={value}")
        ]
        target = local(experiment.shipped, clock="fast", options=arguments)
        try:
            yield from self._guard(Bench(target, folder, self.say), result)
        finally:
            target.close()

    def _guard(self, bench: Bench, result: Result | None) -> Iterator[Bench]:
        with loading(bench.target):
            try:
                with not_waiting(bench.target):
                    yield bench
            except BaseException as error:  # Ctrl-C as well: the machine stands before it ends
                with uninterrupted():
                    with contextlib.suppress(ZendspError):
                        _stop(bench.target)
                    self.left = keep_early(result, bench, error)
                raise


@contextmanager
def loading(target: Target) -> Iterator[None]:
    """A block that loads programs. At its end the one that was loaded before is loaded again."""
    before = Loaded(target)
    held = target.drive_status().commander == target.link.author
    target.take_command()  # refused, nothing is touched: another's machine is not stopped
    try:
        yield
    finally:
        with uninterrupted():
            why = before.put_back()
        if why and not target.link.given_up:
            warnings.warn(why, stacklevel=2)
        if not held:
            with contextlib.suppress(ZendspError):
                target.release_command()


def told(target: Target) -> MachineInfo:
    """What a machine says of itself. Its joints are known while a program is loaded: where none is,
    one that does nothing is loaded for it.
    """
    if target.status().state not in GONE:
        return target.machine()
    with loading(target):
        target.download(IDLE)
        return target.machine()


class Bench:
    """One machine on one target, for the duration of an experiment."""

    def __init__(
        self,
        target: Target,
        folder: Path,
        say: Say,
        machine: MachineInfo | None = None,
        enabled: bool = False,
    ) -> None:
        self.target, self.folder, self.say = target, folder, say
        self._machine = machine
        self._enabled = enabled  # by somebody: again after each load, which switches them off
        self.recordings: list[str] = []
        self.part: tuple[Path, Recording] | None = None  # of one that was cut off, and its file
        self.host_lost = HostLost.STOP  # what the target does without this host
        self.loaded: object = None
        self.seen: dict[int, Seen] = {}  # of each joint in the latest recording
        self.inertias = np.zeros(0)  # of each joint, as the machine declares them
        # where recordings ended at rest, rad (m), and the torque that held every joint, N m (N)
        self.rests: list[tuple[Array, Array]] = []
        self.takes_over: Callable[[], None] | None = None  # holds it where it is, by a stiff loop

    @property
    def machine(self) -> MachineInfo:
        """What the machine declares."""
        if self._machine is None:
            self._machine = told(self.target)
        return self._machine

    @property
    def where(self) -> str:
        """Target, machine and clock in words, for the result."""
        info = self.target.info
        return (
            f"{info.machine}"
            f" ({'simulated' if info.clock == Clock.FAST else 'target ' + self.target.name},"
            f" {info.clock} clock)"
        )

    def record(
        self,
        name: str,
        program: str | Mapping[str, str],
        channels: Sequence[str],
        *,
        seconds: float | None = None,
        reference: Reference | None = None,
        before: float = 1.0,
        after: float = 0.3,
        decimation: int = 1,
        flags: Sequence[str] = (),
        done: Callable[[Target], bool] | None = None,
        **values: Any,
    ) -> Recording:
        """Load a program, set its parameters, run it, and return the recording, which is kept as
        ``name.npz``.

        Parameters
        ----------
        name : str
            Of the recording.
        program : str or mapping
            As for ``Target.compile``.
        seconds : float, optional
            Default: approach, reference, and ``after``.
        reference : Reference, optional
            Goes into the tables ref and ref_tau.
        before, after : float
            Time to the first row of the reference, and after its last, s.
        flags : sequence of str
            For the compiler.
        done : callable, optional
            Asked again and again on the real clock: whether what is to be recorded is over.
            ``AFTER_S`` later the recording ends, before its time. (On the fast clock nobody waits,
            and the result is the same each time.)
        **values
            Parameters of the program.

        Raises
        ------
        Refused
            A limit tripped; the message says which, and the recording is kept as
            ``name_ended.npz``. So is one that Ctrl-C ends, or a program that crashes. Or a drive
            was at its limit, or a joint that was to be held gave way too far.
        """
        self.say(name)
        target = self.target
        if target.status().state in (ProgramState.RUNNING, ProgramState.PAUSED):
            target.pause()
        target.download(program, flags)
        if self.takes_over is not None and self.held_here() is None:
            self.takes_over()
            target.download(program, flags)
        self._make_ready(name)
        if reference is not None:
            values.setdefault("approach_time", before)
            values.setdefault("row_rate", round(1.0 / reference.sample_time))
            seconds = seconds if seconds is not None else before + reference.duration + after
            for table, rows in reference.tables().items():
                target.upload(table, rows)
        if program == HOLDS:
            channels = [*channels, "blocked"]
            done = done or _blocked
            J = np.atleast_1d(np.asarray(values.get("J", target["J"]), dtype=np.float64))
            band = float(values.get("bandwidth", target["bandwidth"]))
            quiet = cutoff_for(self.machine.joints, J, band)
            values = {"stalls": True, "learns": True, "cutoff": quiet, **values}
        here = self.held_here()
        if here is not None and "taken" in values:  # push.c
            values |= {"carried": here.tolist(), "taken": True}
        elif here is not None and program == HOLDS and (reference is None or reference.tau is None):
            values = {"carried": here.tolist()} | values
        if values:
            target.write(**values)
        if seconds is None:
            raise ZendspError(f"recording {name}: give seconds, or a reference")
        fetched, held = Fetched(target), Held.by(reference, values)
        try:
            with guarded(target, name, held), kept(target, [], moves=True), not_waiting(target):
                recording = target.acquire(
                    channels, seconds=seconds, decimation=decimation, start=True, note=name,
                    pauses=False, progress=watching(fetched, ending(target, done)),
                    patience=LOST_S,
                )
                if target.status().state == ProgramState.RUNNING:
                    target.pause()
                trip = target.status().trip  # it may trip in the last samples that are wanted
                if trip is not None and trip.reason:
                    raise Refused(f"{name}: {ended(trip)}")
        except BaseException as error:
            with uninterrupted(), contextlib.suppress(ZendspError):
                _stop(target)  # first of all
            with uninterrupted(), contextlib.suppress(ZendspError):
                self._keep_part(name, str(error) or type(error).__name__, fetched)
            if isinstance(error, Refused) and (why := self._cause(name, held)):
                raise Refused(f"{error}. {why}") from error
            raise
        self._keep(recording, name)
        if self.takes_over is not None and {"q", "tau"} <= set(recording.names):
            self.remember(recording)
        if program == HOLDS and reference is None:
            held = Held(dict(enumerate(np.atleast_1d(recording["q"][0]).tolist(), start=1)), ())
        self._watch(recording, name, reference, held)
        return recording

    def remember(self, recording: Recording) -> None:
        """Keep what holds the machine where a recording ended, if it is at rest there."""
        n = len(self.machine.joints)
        q, tau = (recording[x].reshape(len(recording), n)[-ENDING:] for x in ("q", "tau"))
        if (np.ptp(q, axis=0) <= self._still()).all():
            self.rests.append((q.mean(axis=0), tau.mean(axis=0)))

    def _still(self) -> Array:
        """What each joint moves by at most where it stands, rad (m)."""
        return np.array(
            [min(STILL, STILL * (j.position_max - j.position_min)) for j in self.machine.joints]
        )

    def held_here(self) -> Array | None:
        """The torque that held every joint where the machine stands now, N m (N): a program that
        begins with it lets no weight sink. None where no recording has ended here.
        """
        here = np.array(positions(self.target.status(), self.machine.joints), dtype=np.float64)
        there = [rest for rest in self.rests if (np.abs(here - rest[0]) <= self._still()).all()]
        return there[-1][1] if there else None

    def _watch(
        self, recording: Recording, name: str, reference: Reference | None, held: Held
    ) -> None:
        """Look at every joint, and refuse what is no measurement."""
        if not self.inertias.size and "J" in recording.parameters:
            self.inertias = np.atleast_1d(np.asarray(recording.parameters["J"], dtype=np.float64))
        if (not held.places and not held.moving) or "q" not in recording.names:
            return
        limits = self.target.limits()
        self._refuse_blocked(recording, name)
        self.seen = look(recording, reference, held, limits.torque_max)
        check(name, self.seen, self.machine.joints, held, limits)

    def _refuse_blocked(self, recording: Recording, name: str) -> None:
        """Leave out a joint that something held up: others may still be measured."""
        if "blocked" not in recording.names or not (numbers := recording["blocked"]).any():
            return
        row = int(np.argmax(numbers > 0))
        j = int(numbers[row])
        own = self.machine.joints[j - 1]
        q, tau = (float(np.atleast_2d(recording[x].T)[j - 1, row]) for x in ("q", "tau"))
        force = "N m" if own.unit == "rad" else "N"
        pushed = "phase" in recording.names and row > 0 and recording["phase"][row - 1] > RESTS
        came = (
            f"under the {tau:.3g} {force} that it had moved by" if pushed
            else f"while its command came to {tau:.3g} {force}, more than it had moved by"
        )
        raise Unmeasured(
            f"{name}: something holds joint {j} ({own.name}) up at {q:.3g} {own.unit}, within its"
            f" range of {own.position_min:.3g} to {own.position_max:.3g}: it stands there {came}."
            " It was held there at once. Take away what it touches, or let the machine declare the"
            " range that it has"
        )

    def _make_ready(self, name: str) -> None:
        """Home the machine where the load has forgotten the homing, and enable drives that were
        enabled before the load.
        """
        if not self.target.status().homed:
            self.say(f"{name}: homing the machine")
            self.target.home_if_needed()
        if self._enabled:
            self.target.enable()

    def _keep(self, recording: Recording, name: str) -> None:
        place, wrong = save_anyhow(recording, self.folder / f"{name}.npz")
        if wrong:
            raise RecordingError(wrong)
        self.recordings.append(place.name)

    def _keep_part(self, name: str, why: str, fetched: Fetched) -> None:
        """Keep the rows that were recorded before a run ended early, if any; where the target is
        gone those that were fetched by then.
        """
        note = f"{name}, ended early: {why}"
        recording = fetched.recording(note)
        with contextlib.suppress(ZendspError):
            if self.target.status().tick > 0:
                self.target.acquire_stop()
                recording = self.target.acquire_load(note, patience=LOST_S)
        if recording is not None:
            place, _ = save_anyhow(recording, self.folder / f"{name}_ended.npz")
            self.part = place, recording

    def _cause(self, name: str, held: Held) -> str:
        """Why the joint that tripped did so, by what was recorded."""
        if not self.target.alive:
            return ""
        part = self.part
        own = part is not None and part[0].name == f"{name}_ended.npz"
        rec = part[1] if part is not None and own else None
        return cause(self.target.status().trip, rec, self.machine.joints, held)


def _blocked(target: Target) -> bool:
    """Whether joint_pd.c holds the machine because a joint is blocked."""
    return int(np.asarray(target["blocked"])) > 0


def _stop(target: Target) -> None:
    """STOP a machine that runs, and let it brake."""
    if target.status().state != ProgramState.RUNNING:
        return
    target.stop()
    if target.info.clock == Clock.REAL:
        time.sleep(BRAKE_S)


def own_program(name: str) -> dict[str, str]:
    """Source of a program of the experiments, with what control programs share."""
    file = resources.files("zendsp.experiment").joinpath("programs", name)
    shared = resources.files("zendsp_isr").joinpath("programs")
    beside = {x: shared.joinpath(x).read_text(encoding="utf-8") for x in ("motion.h", "blocked.h")}
    return {name: file.read_text(encoding="utf-8"), **beside}


def push_program() -> dict[str, str]:
    """Source of the program that pushes a joint with a torque."""
    return own_program("push.c")


def playing(recording: Recording, samples: int) -> slice:
    """Rows of a recording during which the reference was played (needs the channel play_time)."""
    first = int(np.argmax(recording["play_time"] >= -1e-9))
    return slice(first, first + samples)


def needed(lab: Lab, name: str, make: Callable[[Lab], Result]) -> Result:
    """The result of another experiment on the same machine, read from this folder or made now."""
    file = result_file(lab.folder, name)
    if file.exists():
        result = Result.load(file)
        if result.machine == lab.machine_of(name):
            return result
        lab.say(f"{file} is of {result.machine}: {name} is made first")
    result = make(lab)
    result.save(lab.folder / name / "result.toml")
    return result
