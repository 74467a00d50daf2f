"""Plays tables in the loaded program, records, and restores the program."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import numpy.typing as npt

from zendsp.errors import Incomplete, TooSoon, ZendspError
from zendsp.here.uninterrupted import uninterrupted
from zendsp.link import Target
from zendsp.link.outside import positions
from zendsp.link.put_back import Before, kept
from zendsp.recording import Recording
from zendsp_protocol.states import Clock, ProgramState, VariableKind
from zendsp_protocol.values import Assignable

Floats = npt.NDArray[np.float64]
LEAD_S = 0.5  # from the request to the sample in which everything switches over
SLOWEST = 2e6  # bytes a second that a link carries at the least
REST_S = 1.0  # for a machine to come to rest under its control law
SLACK_S = 1.0  # of the ring on the real clock, before the switch-over and after the end


class Player:
    """Plays tables and records.

    On the real clock a running program goes on, and all tables switch over in one sample. Otherwise
    the program starts with the recording and is paused at the end. What was set is restored however
    the playing ends; a program that ran then goes on as before. If it ends early, also by Ctrl-C,
    the machine first comes to rest where it is, and a program that would go on with a motion of its
    own is paused.

    Parameters
    ----------
    tables : mapping of str to ndarray
        Rows, in the order in which they are sent; the first column belongs to joint 1. Names that
        the program lacks are left out, here and of the values.
    values : mapping of str to value
        Parameters of the program.
    seconds : float
        From the switch-over to the last row that is needed.
    note : str
        Of the recording.
    progress : callable, optional
        Called with the fraction done.
    """

    def __init__(
        self,
        target: Target,
        tables: Mapping[str, Floats],
        values: Mapping[str, Assignable],
        channels: Sequence[str],
        seconds: float,
        note: str = "",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        infos = target.variables()
        self.tables = {name: rows for name, rows in tables.items() if name in infos}
        self.values = {
            name: value
            for name, value in values.items()
            if name in infos
            and infos[name].kind == VariableKind.PARAMETER
            and (infos[name].type == "bool") == isinstance(value, bool)
        }
        self._target, self._channels, self._seconds = target, channels, seconds
        self._note, self._progress = note, progress
        self._begin = 0  # the sample in which all switches over

    def play(self) -> tuple[Recording, int]:
        """Return the recording, and the sample in which the tables switched over."""
        target = self._target
        running = target.status().state == ProgramState.RUNNING
        real = target.info.clock == Clock.REAL
        with kept(target, [*self.values, *self.tables], moves=True) as before:
            try:
                found = self._while_it_runs() if real and running else self._from_the_start()
            except BaseException:  # Ctrl-C too: nobody waits for what the machine goes on doing
                with uninterrupted():
                    with suppress(ZendspError):
                        self._come_to_rest(before, real, running)
                    with suppress(ZendspError):
                        target.acquire_stop()
                raise
            if running and before.follows:  # a later start stays there too
                for name, rows in self.tables.items():
                    self._replace(name, rows[-1:])
        if running and not real:
            target.start()
        return found

    def _come_to_rest(self, before: Before, real: bool, running: bool) -> None:
        """Hold the machine where it is. Pause it once it stands, unless the program ran before and
        followed its table.
        """
        target = self._target
        if not target.alive:
            return
        deadline = time.monotonic() + self._lead
        while (status := target.status()).state == ProgramState.RUNNING:
            if status.tick > self._begin or time.monotonic() > deadline:
                break
            time.sleep(0.02)  # what was sent for that sample would undo what is put back before
        else:
            return
        here = np.atleast_1d(np.asarray(position(target), dtype=np.float64))
        for name in self.tables:
            self._replace(name, np.tile(here if name == "ref" else 0.0 * here, (2, 1)))
        goes_on = running and before.follows
        if real and not goes_on:
            time.sleep(REST_S)
        if not goes_on:
            target.pause()

    def _replace(self, name: str, rows: Floats) -> None:
        """Send a table once the one before it is in effect."""
        deadline = time.monotonic() + self._lead
        while True:
            try:
                self._target.upload(name, rows)
                return
            except TooSoon:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)  # until the target's clock has come so far

    @property
    def _lead(self) -> float:
        """The time until all tables have been sent and can switch over, s; doubled for a busy
        target.
        """
        return 2.0 * (LEAD_S + sum(rows.nbytes for rows in self.tables.values()) / SLOWEST)

    def _from_the_start(self) -> tuple[Recording, int]:
        """Start the program together with the recording, whose first row is then the first sample.
        """
        target = self._target
        if target.status().state == ProgramState.RUNNING:
            target.pause()
        for name, rows in self.tables.items():
            target.upload(name, rows)
        target.variables.update_alone(self.values)
        recording = target.acquire(
            self._channels, self._seconds, start=True, note=self._note, progress=self._progress,
            pauses=False,
        )
        return recording, recording.start_tick

    def _while_it_runs(self) -> tuple[Recording, int]:
        """Switch the tables over while the recorder runs, and keep the rows from that sample on."""
        target, length, rate = self._target, self._seconds, self._target.info.rate_hz
        self._begin = begin = target.status().tick + round(0.5 * self._lead * rate)
        target.update(at_tick=begin, **self.values)  # all in one sample, so that nothing jumps
        for name, rows in self.tables.items():
            self._begin = begin = max(begin, target.upload(name, rows, at_tick=begin))
        target.acquire_configure(self._channels, length + SLACK_S, continuous=True)
        target.acquire_start()
        end = begin + round((length + 0.1) * rate)
        while (status := target.status()).tick < end and status.state == ProgramState.RUNNING:
            if self._progress is not None:
                self._progress(max(0.0, min(1.0, 1.0 - (end - status.tick) / (length * rate))))
            time.sleep(0.02)  # until the target's clock has come so far
        if target.acquire_status().replaced:
            raise Incomplete("another program was loaded before the motion was played to its end")
        return target.acquire_finish(note=self._note), begin


def position(target: Target) -> Assignable:
    """The position that the machine is to hold: the program's reference, or the encoders' before it
    has run.
    """
    status = target.status()
    if status.tick > 0 and "q" in target.variables():
        return target["q"]
    return positions(status, target.machine().joints)
