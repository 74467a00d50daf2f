"""Acquisition streams: each is a file of rows that the loop fills in constant time and that is read
here without disturbing the loop.

A stream's file outlives the runner: what was acquired before a crash, a stop or a new load stays
loadable until the stream is configured again.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.chunks import KERNEL
from zendsp_protocol.errors import AcquisitionError, TooLarge, VariableError
from zendsp_protocol.kept import About, Kept, first_row
from zendsp_protocol.messages import AcquireStatus, Held
from zendsp_protocol.states import RecorderState, VariableKind
from zendsp_protocol.texts import units_of
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime.memory.layout import layout, set_text
from zendsp_target.runtime.memory.shm import SharedFile
from zendsp_target.runtime.variables.dictionary import Dictionary

LONGEST_S = 1e9  # of a recording: 30 years; memory allows far less
MOST_DECIMATION = (1 << 32) - 1  # samples a row: a word of the stream's head
_EDGES = {"rising": 1, "falling": 2, "both": 3}
_STATES = dict(enumerate(RecorderState))  # STREAM_… of layout.h
# bytes of a stream: its pages are made present at once, which takes about a second for so many
_LARGEST = 2_000_000_000
# the service thread of the runner maps a small stream in milliseconds, 1 GB in half a second; a
# loaded machine may take longer
_ANSWER_S = 5.0
_PAGES_PER_S = 100e6  # bytes made present in a second, at the least


@dataclass
class Stream:
    """One configured stream."""

    file: SharedFile
    head: Any
    config: AcquireConfig
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rows: int  # of a shot, or promised to be held by a ring
    pre: int  # rows before the trigger
    capacity: int  # rows held
    offset: int  # of row 0 in the file, bytes
    reader: Path  # for hosts of this user
    begun: int  # number of its rows: of no other stream, and another one at each further start
    started: bool = False
    lost: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


@dataclass(frozen=True)
class _Plan:
    sources: tuple[tuple[int, int], ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    trigger: tuple[int, int] | None
    rows: int
    pre: int


def _expand(
    dictionary: Dictionary, names: tuple[str, ...], most: int
) -> tuple[list[tuple[int, int]], list[str], list[str]]:
    """Channels of the names: an array stands for all of its elements. Of more than ``most``
    channels the last are left out.
    """
    sources: list[tuple[int, int]] = []
    labels: list[str] = []
    units: list[str] = []
    problems: list[str] = []
    for name in names:
        try:
            place = dictionary.place(name, len(problems))
        except VariableError as error:
            problems.append(str(error))
            continue
        info = place.entry.info
        if info.kind == VariableKind.TABLE:
            problems.append(f"{name}: is a table; record the variable that follows it")
            continue
        if len(sources) > most:  # too many already: a name a thousand times takes memory, too
            continue
        whole = place.element is None and info.length > 1
        elements = range(info.length) if whole else [place.element or 0]
        each = units_of(info.unit, info.length)
        for element in elements:
            sources.append((place.entry.index, element))
            labels.append(f"{name}[{element}]" if whole else name)
            units.append(each[element])
    if problems:
        raise AcquisitionError("\n".join(problems))
    return sources, labels, units


def _plan(dictionary: Dictionary, config: AcquireConfig, rate_hz: float) -> _Plan:
    _, lib = layout()
    sources, labels, units = _expand(dictionary, config.channels, lib.LAYOUT_CHANNELS)
    if not 1 <= len(sources) <= lib.LAYOUT_CHANNELS:
        number = f"more than {lib.LAYOUT_CHANNELS}" if sources else "no"
        raise AcquisitionError(f"{number} channels: give 1 … {lib.LAYOUT_CHANNELS}")
    if not 1 <= config.decimation <= MOST_DECIMATION:
        raise AcquisitionError(
            f"decimation {config.decimation}: give 1 to {MOST_DECIMATION} samples a row"
        )
    if not abs(config.seconds) <= LONGEST_S:  # NaN too
        raise AcquisitionError(f"{config.seconds:g} s: give a finite time, {LONGEST_S:g} s at most")
    rows = round(config.seconds * rate_hz / config.decimation)
    if rows < 1:
        raise AcquisitionError(
            f"{config.seconds:g} s hold no row at {rate_hz / config.decimation:g} rows a second:"
            " acquire longer"
        )
    trigger, pre = None, 0
    if config.trigger is not None:
        found, names, _ = _expand(dictionary, (config.trigger.source,), 1)
        if len(found) != 1:
            raise AcquisitionError(
                f"trigger source {config.trigger.source} has {len(found)} elements: name one, such"
                f" as {names[0]}"
            )
        if config.trigger.edge not in _EDGES:
            raise AcquisitionError(
                f"trigger edge {config.trigger.edge!r}: give rising, falling or both"
            )
        if not np.isfinite(config.trigger.level) or not 0.0 <= config.trigger.pre_s <= LONGEST_S:
            raise AcquisitionError(
                f"trigger: level {config.trigger.level:g} must be a finite number, and pre_s"
                f" {config.trigger.pre_s:g} s 0 … {LONGEST_S:g} s"
            )
        trigger = found[0]
        pre = round(config.trigger.pre_s * rate_hz / config.decimation)
        if pre >= rows and not config.continuous:
            raise AcquisitionError(
                f"pre-trigger of {config.trigger.pre_s:g} s fills the whole {config.seconds:g} s:"
                " make it shorter"
            )
    return _Plan(tuple(sources), tuple(labels), tuple(units), trigger, rows, pre)


def create(
    path: Path,
    dictionary: Dictionary,
    config: AcquireConfig,
    rate_hz: float,
    free_bytes: int,
    begun: int,
) -> Stream:
    """Make the file of a stream and return the stream.

    Parameters
    ----------
    begun : int
        Number of its rows.
    free_bytes : int
        Of the shared memory and of the computer's.

    Raises
    ------
    AcquisitionError
        Unknown channel, or nothing to store.
    TooLarge
        More than fits into memory.
    """
    ffi, lib = layout()
    plan = _plan(dictionary, config, rate_hz)
    # a margin, so that a reader at the oldest promised row is not overtaken while it copies
    capacity = plan.rows + max(64, plan.rows // 8 if config.continuous else 0)
    head_bytes = (ffi.sizeof("stream_head") + 4095) & ~4095
    size = head_bytes + capacity * len(plan.sources) * 8
    allowed = min(free_bytes // 2, _LARGEST)  # the rest of the computer needs memory too
    if size > allowed:
        raise TooLarge(
            f"{len(plan.sources)} channels for {config.seconds:g} s need {size / 1e6:.3g} MB of"
            f" shared memory, {allowed / 1e6:.3g} MB are free for it here: shorten it, raise the"
            " decimation, record fewer channels, or make room ('df -h /dev/shm')"
        )
    file = SharedFile(path, size)
    head = file.pointer("stream_head")
    head.magic = lib.LAYOUT_MAGIC
    head.version = lib.LAYOUT_VERSION
    head.bytes = size
    head.rows = head_bytes
    head.channels, head.decimation, head.capacity = len(plan.sources), config.decimation, capacity
    head.wanted, head.pre = 0 if config.continuous else plan.rows, plan.pre
    head.fired = -1
    if plan.trigger is not None and config.trigger is not None:
        head.edge, head.level = _EDGES[config.trigger.edge], config.trigger.level
        head.trigger.variable, head.trigger.element = plan.trigger
    for i, (variable, element) in enumerate(plan.sources):
        head.channel[i].variable, head.channel[i].element = variable, element
    return Stream(
        file, head, config, plan.channels, plan.units, plan.rows, plan.pre, capacity, head_bytes,
        file.reader(), begun,
    )


def attach(stream: Stream, control: Any, number: int, alive: Callable[[], bool]) -> None:
    """Hand a stream to the runner and wait until the loop has it.

    Raises
    ------
    AcquisitionError
        The runner cannot map it, or does not answer.
    """
    ffi, lib = layout()
    slot = control.stream[number]
    set_text(slot.path, str(stream.file.path))
    before = int(slot.requested)
    generation = before + 2 if before % 2 else before + 1
    lib.monitor_store32(ffi.addressof(slot, "requested"), generation)
    mapped = ffi.addressof(slot, "mapped")
    limit = _ANSWER_S + int(stream.head.bytes) / _PAGES_PER_S
    if not _until(lambda: lib.monitor_load32(mapped) == generation, alive, limit):
        raise AcquisitionError(
            "the runner did not take the acquisition: see status for its state, then load the"
            " program again"
        )
    if slot.failed:
        failed = int(slot.failed)
        lacks = failed in (errno.ENOMEM, errno.EAGAIN, errno.EFBIG, errno.ENOSPC)
        raise AcquisitionError(
            f"the runner cannot map the acquisition buffer ({os.strerror(failed)}):"
            f" {'make it smaller' if lacks else 'load the program again'}"
        )


def request(stream: Stream, word: str, alive: Callable[[], bool]) -> None:
    """Arm, disarm or force a stream, and wait until the loop has done it."""
    ffi, lib = layout()
    with stream.lock:
        address = ffi.addressof(stream.head[0], word)
        value = (lib.monitor_load32(address) + 1) & 0xFFFFFFFF
        if word == "arm":
            stream.lost = 0
        lib.monitor_store32(address, value)
        state = ffi.addressof(stream.head[0], "state")
        answered = ffi.addressof(stream.head[0], "answered")
        done = {
            "arm": lambda: lib.monitor_load32(answered) == value,
            "disarm": lambda: lib.monitor_load32(state) in (lib.STREAM_IDLE, lib.STREAM_DONE),
            "force": lambda: lib.monitor_load32(state) != lib.STREAM_ARMED,
        }
        if not _until(done[word], alive):
            raise AcquisitionError(
                "the loop does not take the acquisition: no program runs (load and start one)"
            )


def _until(done: Callable[[], bool], alive: Callable[[], bool], limit: float = _ANSWER_S) -> bool:
    end = time.monotonic() + limit
    while not done():
        if not alive() or time.monotonic() > end:
            return done()
        time.sleep(0.0002)
    return True


def note_of(stream: Stream, about: About) -> Kept:
    """The note to leave beside the rows, from which they can be salvaged if this process is killed.
    """
    ffi, _ = layout()
    at = {
        word: ffi.offsetof("stream_head", word)
        for word in ("count", "first_tick", "fired", "missed", "gaps")
    }
    return Kept(
        about=about, file=stream.file.path.name, rows_at=stream.offset, capacity=stream.capacity,
        columns=stream.channels, units=stream.units, decimation=stream.config.decimation,
        rows=stream.rows, pre=stream.pre, ring=stream.config.continuous,
        triggered=stream.config.trigger is not None, count_at=at["count"],
        start_at=at["first_tick"], fired_at=at["fired"], missed_at=at["missed"],
        gaps_at=at["gaps"], gaps_held=len(stream.head.gap),
    )


def status(stream: Stream, alive: bool) -> AcquireStatus:
    """The state of a stream and its counts of rows.

    Parameters
    ----------
    alive : bool
        Whether the loop that fills it still runs; a stream without its loop is done.
    """
    ffi, lib = layout()
    head = stream.head
    state = _STATES.get(lib.monitor_load32(ffi.addressof(head[0], "state")), RecorderState.DONE)
    count, fired = int(lib.monitor_load64(ffi.addressof(head[0], "count"))), int(head.fired)
    if not alive and state in (RecorderState.ARMED, RecorderState.RUNNING):
        state = RecorderState.DONE
    ring = stream.config.continuous
    first = first_row(
        count, fired, stream.rows, stream.pre, ring, stream.config.trigger is not None
    )
    return AcquireStatus(
        state=state, channels=stream.channels, units=stream.units,
        decimation=stream.config.decimation, first=first, count=count,
        wanted=0 if ring else stream.rows, lost=stream.lost + int(head.missed),
        gaps=_gaps(head, first), start_tick=int(head.first_tick), trigger_row=fired,
        begun=stream.begun,
    )


def _gaps(head: Any, first: int) -> tuple[tuple[int, int], ...]:
    """Where rows are missing, each as the row after the gap and the number of missing rows; of the
    gaps up to row ``first`` only the last.
    """
    ffi, lib = layout()
    count, held = int(lib.monitor_load64(ffi.addressof(head[0], "gaps"))), len(head.gap)
    newest = (head.gap[n % held] for n in range(max(0, count - held), count))
    gaps = [(int(gap.row), int(gap.missed)) for gap in newest]
    before = sum(row <= first for row, _ in gaps)
    return tuple(gaps[max(0, before - 1) :])


def held(stream: Stream, alive: bool) -> Held:
    """The file in which the rows of a stream are, and which rows it holds.

    Parameters
    ----------
    alive : bool
        Whether the loop that fills it still runs.
    """
    file, now = os.stat(stream.reader), status(stream, alive)
    return Held(
        kernel=Path(KERNEL).read_text().strip(), path=str(stream.reader), device=file.st_dev,
        inode=file.st_ino, offset=stream.offset, columns=len(stream.channels),
        capacity=stream.capacity, first=now.first, count=now.count,
    )


def read(
    stream: Stream,
    first: int,
    count: int,
    into: npt.NDArray[np.float64] | None = None,
    fold: bytearray | None = None,
) -> npt.NDArray[np.float64]:
    """Return a copy of rows.

    Parameters
    ----------
    first : int
        Index of the first row.
    count : int
        At most so many; fewer where fewer are written.
    into : ndarray, shape (count or more, channels), optional
        Memory to use again and again; fresh pages cost more than filling them.
    fold : bytearray, 4096 bytes, optional
        Takes up the bytes of the rows by exclusive or, for their checksum (see
        `zendsp_protocol.chunks.folded_crc`).

    Returns
    -------
    ndarray, shape (rows, channels)

    Raises
    ------
    AcquisitionError
        The rows were overwritten before they were read; they are counted as lost.
    """
    ffi, lib = layout()
    head, capacity = stream.head, stream.capacity
    count_word = ffi.addressof(head[0], "count")
    written = int(lib.monitor_load64(count_word))
    if first < 0 or count < 0:
        raise AcquisitionError(f"rows {first} … {first + count - 1}: neither may be negative")
    count = min(count, max(0, written - first), capacity)
    if count == 0:
        return np.empty((0, len(stream.channels)))
    rows = np.empty((count, len(stream.channels))) if into is None else into[:count]
    if rows.shape != (count, len(stream.channels)) or not rows.flags.c_contiguous:
        raise AcquisitionError(
            f"memory of shape {rows.shape} does not hold {count} rows of {len(stream.channels)}"
            " channels"
        )
    source = stream.file.pointer("double", stream.offset)
    taken = ffi.NULL if fold is None else ffi.from_buffer("uint64_t[]", fold)
    to = ffi.from_buffer("double[]", rows)
    gone = int(
        lib.monitor_rows(
            count_word, source, capacity, len(stream.channels), first, count, to, taken
        )
    )
    # a stream at rest is not being written: its last row is whole
    if gone and lib.monitor_load32(ffi.addressof(head[0], "state")) in (
        lib.STREAM_DONE, lib.STREAM_IDLE,
    ):
        gone = min(count, max(0, written - capacity - first))
    if gone:
        stream.lost += gone
        raise AcquisitionError(
            f"rows {first} … {first + gone - 1} are overwritten: the oldest row held is"
            f" {first + gone}; read more often, or acquire with a longer ring"
        )
    return rows
