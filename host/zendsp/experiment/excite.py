"""Swings one joint about where it stands, from the tables of the loaded program."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, Refused, ZendspError
from zendsp.link import Target, rehearse
from zendsp.link.variables import plain
from zendsp.recording import Recording
from zendsp_protocol.messages import VariableInfo
from zendsp_protocol.states import ProgramState
from zendsp_protocol.values import Assignable

Floats = npt.NDArray[np.float64]
APPROACH_S = 0.5  # from where the machine stands into the first row
FADE = 0.5  # of a period: in within the first, out after the last
LEAD_S = 0.5  # from the request to the sample in which everything switches over
SLOWEST = 2e6  # bytes a second that a link carries at the least
REST_S = 1.0  # for a machine to come to rest under its control law
SLACK_S = 1.0  # of the ring on the real clock, before the switch-over and after the end


def play(
    target: Target,
    make: Callable[[Floats], Floats],
    *,
    joint: int,
    quantity: str,
    seconds: float,
    times: int,
    channels: list[str],
    rehearsed: bool,
    progress: Callable[[float], None] | None = None,
) -> tuple[Recording, int]:
    """Play a period some times and record it.

    At the end the machine holds the last row, where it stood before. The program keeps use_table,
    row_rate and approach_time as they were played: another value would move the reference along
    the table. Whatever ends it early, Ctrl-C too, the machine is then held where it is.

    Parameters
    ----------
    target : Target
    make : callable
        Values of a period at times, s; periodic.
    joint : int
        From 1.
    quantity : {"position", "torque"}
    seconds : float
        Length of the period, a multiple of the sample time.
    times : int
        How often.
    channels : list of str
    rehearsed : bool
        Try it on a simulated twin first, where the clock is real.
    progress : callable, optional

    Returns
    -------
    recording : Recording
        Every sample.
    first : int
        Its row at which the first period begins.
    """
    status = target.status()
    if status.trip is not None:
        raise Refused(f"{status.trip.text}: acknowledge it first")
    tables, row_rate = _tables(target, make, joint, quantity, seconds, times)
    wanted = {"use_table": True, "row_rate": row_rate, "approach_time": APPROACH_S}
    length = APPROACH_S + seconds * times + FADE * seconds
    real = target.info.clock == "real"
    if rehearsed and real:
        found = rehearse(target, tables, wanted, length, _sign_of_life(progress))
        if found.simulated and not found.good:
            raise Refused(f"not played, the twin was stopped: {found.text}; take less amplitude")
    running = target.status().state == ProgramState.RUNNING
    swing = _Swing(target, tables, wanted, channels, length, progress)
    try:
        recording, begin = swing.while_it_runs() if real and running else swing.from_the_start()
    except BaseException as error:  # Ctrl-C too: nobody waits for what the machine goes on doing
        with suppress(ZendspError):
            swing.come_to_rest(real, running)
        if isinstance(error, ZendspError):
            _refuse_trip(target)  # that it tripped says more than that rows are missing
        raise
    if running and not real:
        target.start()
    _refuse_trip(target)
    rate = target.info.rate_hz
    return recording, begin + round(APPROACH_S * rate) - recording.start_tick


def _sign_of_life(progress: Callable[[float], None] | None) -> Callable[[float], None] | None:
    """What a rehearsal tells: nothing is done yet, but it can be interrupted."""
    if progress is None:
        return None
    tell = progress
    return lambda _: tell(0.0)


def _refuse_trip(target: Target) -> None:
    trip = target.status().trip if target.alive else None
    if trip is not None:
        if trip.reason == "stop":
            raise Refused(trip.text)
        raise Refused(f"the machine stopped itself: {trip.text}; take less amplitude")


def _tables(
    target: Target,
    make: Callable[[Floats], Floats],
    joint: int,
    quantity: str,
    seconds: float,
    times: int,
) -> tuple[dict[str, Floats], int]:
    """The rows of every table, in the order in which they are sent, and how many there are a
    second.
    """
    infos = target.variables()
    needed = ["ref", "use_table", "row_rate", "approach_time"]
    needed += ["ref_tau"] if quantity == "torque" else []
    lacking = [name for name in needed if name not in infos]
    if lacking:
        raise Refused(
            f"the loaded program lacks {', '.join(lacking)}: load one that plays tables, for"
            " example joint_pd.c (docs/references.md, 'How a program plays it')"
        )
    if "playing" in infos and target["playing"]:
        raise Refused("a reference is being played: wait for its end")
    here = np.atleast_1d(np.asarray(_position(target, infos), dtype=np.float64))
    if not 1 <= joint <= len(here):
        raise Refused(f"joint {joint}: the machine has {len(here)}, counted from 1")
    rate = target.info.rate_hz
    room = infos["ref"].length // len(here)
    step = int(np.ceil((seconds * (times + FADE) * rate + 1) / room))  # samples a row
    while round(seconds * rate) % step or round(rate) % step:
        step += 1
        if step > rate:
            raise AcquisitionError(
                f"{times} periods of {seconds:g} s do not fit into the {room} rows of the table"
                " ref: raise f_min, or take fewer periods"
            )
    period = round(seconds * rate) // step
    t = np.arange(int(period * (times + FADE)) + 1) / period  # periods
    rows = len(t)
    swing = _fade(t, times) * make(t * seconds)
    motion, torque = np.tile(here, (rows, 1)), np.zeros((rows, len(here)))
    (motion if quantity == "position" else torque)[:, joint - 1] += swing
    tables = {"ref_tau": torque} if "ref_tau" in infos else {}
    return {**tables, "ref": motion}, round(rate / step)


def _fade(t: Floats, times: int) -> Floats:
    """From 0 to 1 within the first periods, and back to 0 after the last; smooth."""
    share = np.clip(np.minimum(t, times + FADE - t) / FADE, 0.0, 1.0)
    return np.asarray(share**3 * (10.0 + share * (6.0 * share - 15.0)))


def _position(target: Target, infos: Mapping[str, VariableInfo]) -> Assignable:
    """Where the machine is to stand: by the program, or by the encoders before it has run."""
    status = target.status()
    if status.tick > 0 and "q" in infos:
        return target["q"]
    counts = np.ravel(np.asarray(plain(status.io.get("enc", ()))))
    joints = target.machine().joints
    return [(c - j.zero_counts) / j.counts_per_unit for c, j in zip(counts, joints, strict=False)]


@dataclass(frozen=True)
class _Swing:
    """What is played and recorded: tables, the program's parameters, channels, length in s."""

    target: Target
    tables: dict[str, Floats]
    values: Mapping[str, Assignable]
    channels: list[str]
    length: float
    progress: Callable[[float], None] | None

    def come_to_rest(self, real: bool, running: bool) -> None:
        """Hold the machine where it is; pause it when it stands, where it was paused before."""
        target = self.target
        if not target.alive or target.status().state != ProgramState.RUNNING:
            return
        here = np.atleast_1d(np.asarray(_position(target, dict(target.variables()))))
        for name in self.tables:
            self._replace(name, np.tile(here if name == "ref" else 0.0 * here, (2, 1)))
        if real and not running:
            time.sleep(REST_S)
        if not running:
            target.pause()

    def _replace(self, name: str, rows: Floats) -> None:
        """Send a table as soon as the one before it is in effect."""
        deadline = time.monotonic() + 2.0 * LEAD_S + self.size / SLOWEST
        while True:
            try:
                self.target.upload(name, rows)
                return
            except Refused:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)  # until the target's clock has come so far

    @property
    def size(self) -> int:
        """Bytes of all tables."""
        return sum(rows.nbytes for rows in self.tables.values())

    def from_the_start(self) -> tuple[Recording, int]:
        """Start the program together with the recording: the first row is the first sample."""
        target = self.target
        if target.status().state == ProgramState.RUNNING:
            target.pause()
        for name, rows in self.tables.items():
            target.upload(name, rows)
        target.write(**self.values)
        recording = target.acquire(
            self.channels, self.length, start=True, progress=self.progress
        )
        return recording, recording.start_tick

    def while_it_runs(self) -> tuple[Recording, int]:
        """Switch the table over while the recorder runs, and keep the rows from there on."""
        target, length, rate = self.target, self.length, self.target.info.rate_hz
        begin = target.status().tick + round((LEAD_S + self.size / SLOWEST) * rate)
        target.update(at_tick=begin, **self.values)  # all in one sample, so that nothing jumps
        for name, rows in self.tables.items():
            begin = max(begin, target.upload(name, rows, at_tick=begin))
        target.acquire_configure(self.channels, length + SLACK_S, continuous=True)
        target.acquire_start()
        end = begin + round((length + 0.1) * rate)
        while (status := target.status()).tick < end and status.state == ProgramState.RUNNING:
            if self.progress is not None:
                self.progress(max(0.0, min(1.0, 1.0 - (end - status.tick) / (length * rate))))
            time.sleep(0.02)  # until the target's clock has come so far
        return target.acquire_finish(), begin
