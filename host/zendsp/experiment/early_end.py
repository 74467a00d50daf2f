"""What is kept of an experiment that ends early: the rows that the host had fetched while they were
recorded, and the result as far as it came; and what ends a recording before its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from zendsp.errors import AcquisitionError, LinkError, ZendspError
from zendsp.experiment.names import ENDED
from zendsp.experiment.result import Result
from zendsp.link import Target
from zendsp.link.left_moving import DOES
from zendsp.link.metadata import ticks_of
from zendsp.recording import Recording
from zendsp_protocol.messages import AcquireStatus
from zendsp_protocol.states import Clock, HostLost
from zendsp_protocol.texts import counted

FETCH_S = 0.5  # between two looks: no more of a recording ends with its target
AFTER_S = 0.5  # that is still recorded when all is done
LOST_S = 3.0  # that a link may be lost; a target stops what a lost host moves after 1 s


class Bench(Protocol):
    """What is asked of the bench of an experiment that ends early."""

    target: Target
    folder: Path
    recordings: list[str]
    part: tuple[Path, Recording] | None  # of one that was cut off, and its file
    host_lost: HostLost  # what the target does without this host

    @property
    def where(self) -> str:
        """Target, machine and clock in words."""
        ...


class Fetched:
    """The rows of a recording that the host has while the target still records it.

    Parameters
    ----------
    target : Target
    """

    def __init__(self, target: Target) -> None:
        self._target = target
        self._next = time.monotonic() + FETCH_S
        self._begun: Recording | None = None
        self._number = 0  # of the recording
        self._status: AcquireStatus | None = None
        self._rows: list[np.typing.NDArray[np.float64]] = []

    def look(self) -> None:
        """Fetch what is new; to be called again and again."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + FETCH_S
        with suppress(AcquisitionError):  # no row yet, or a ring that has overwritten some
            if self._begun is None:
                self._number = self._target.acquire_status().begun
                self._begun = self._target.acquire_load(patience=LOST_S)
            status = self._target.acquire_status()
            have = len(self._begun) + sum(map(len, self._rows))
            if status.count > have:
                self._rows.append(
                    self._target.load_rows(
                        have, status.count - have, len(status.channels), patience=LOST_S,
                        begun=self._number,
                    )
                )
            self._status = status

    def recording(self, note: str) -> Recording | None:
        """What was fetched; None where that is nothing."""
        if self._begun is None or self._status is None:
            return None
        data = np.concatenate([self._begun.data, *self._rows])
        start, every = self._begun.start_tick, self._begun.decimation
        ticks = ticks_of(0, len(data), start, every, self._status.gaps)
        t = np.asarray(ticks * (self._begun.sample_time / every), dtype=np.float64)
        return replace(self._begun, t=t, data=data, lost=self._status.lost, note=note)


@contextmanager
def not_waiting(target: Target) -> Iterator[None]:
    """A block after which, where it fails and the target is lost, nothing waits for it any more:
    what puts things back would else wait its time for each of them.
    """
    try:
        yield
    except BaseException:
        target.link.give_up()
        raise


def keep_early(result: Result | None, bench: Bench, error: BaseException) -> str:
    """Write the result of an experiment as far as it came, and return what is kept, and where.

    Parameters
    ----------
    result : Result, optional
        With what was measured before.
    error : BaseException
        That ended the experiment.
    """
    said = ["ended early"]
    if result is not None and result.values:
        result.recordings, result.target = bench.recordings, bench.where
        why = str(error) or type(error).__name__
        result.warnings.append(f"It ended early, and more was to be measured: {why}")
        with suppress(ZendspError):  # a full disk: what ended the experiment is told
            file = result.save(bench.folder / ENDED)
            said.append(f"{counted(len(result.values), 'number')} measured before: {file}")
    if bench.recordings:
        said.append(f"{counted(len(bench.recordings), 'recording')}: {bench.folder}")
    if bench.part is not None:
        file, part = bench.part
        seconds = len(part) * part.sample_time
        said.append(f"{seconds:.3g} s of the one that was cut off: {file}")
    return "; ".join(said) + (_of_the_lost(bench) if isinstance(error, LinkError) else "")


def _of_the_lost(bench: Bench) -> str:
    """A sentence on a target that is lost, and has not said that it ends."""
    link, policy = bench.target.link, bench.host_lost
    if link.over or not link.given_up:
        return ""
    return (
        f". If the target lives, it has lost this host, and does what is set for that ({policy}:"
        f" {DOES[policy]}). It holds its recording until it makes another (zendsp acquire --last -t"
        f" {bench.target.name} -o FILE), and the program that was loaded before is not loaded again"
    )


def forget_early(folder: Path) -> None:
    """Remove the result of an earlier attempt that ended early: there is a whole one."""
    (folder / ENDED).unlink(missing_ok=True)


def watching(
    fetched: Fetched, also: Callable[[float], None] | None
) -> Callable[[float], None]:
    """What is called while a recording runs: it fetches rows, and may end the recording."""

    def look(fraction: float) -> None:
        fetched.look()
        if also is not None:
            also(fraction)

    return look


def ending(
    target: Target, done: Callable[[Target], bool] | None
) -> Callable[[float], None] | None:
    """What ends a recording on the real clock ``AFTER_S`` after it is done; called while it runs.
    """
    if done is None or target.info.clock != Clock.REAL:
        return None
    since: list[float] = []

    def look(fraction: float) -> None:
        if not since and done(target):
            since.append(time.monotonic())
        if since and time.monotonic() - since[0] > AFTER_S:
            target.acquire_stop()

    return look
