"""Synchronous updates: any number of variables, applied whole at the start of one sample, and the log of what changed.

A batch is filled in shared memory and then published by one release store: a monitor that dies while filling it has published
nothing. The loop exchanges values when it applies a batch, so the old ones come back exactly as they were at that sample.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import Refused, RunnerDied, VariableError
from zendsp_target.api import Change, Value
from zendsp_target.dictionary import SCALARS, Dictionary, Place, value_of
from zendsp_target.layout import layout
from zendsp_target.shm import SharedFile
from zendsp_target.values import encode, encode_table

_ENTRY = struct.Struct("<iiii")  # batch_entry: variable, offset, size, reserved
_DOUBLE = SCALARS["double"]
_LARGEST = float(np.finfo(np.float64).max)
_SLICE_NS = 20_000_000  # waits come up for air so often, to see a runner that died
_MAX_LOG = 100_000  # lines kept; older ones are dropped
_MAX_ACKS = 4096


class _Piece(NamedTuple):
    name: str
    place: Place
    data: bytes


@dataclass(frozen=True)
class _Flight:
    """A batch that was committed and not yet harvested."""

    slot: int
    pieces: tuple[_Piece, ...]
    author: str
    host_time: float
    bytes: int


class ChangeLog:
    """Every change of a parameter, in the order in which it was harvested; shared by all loads of a target.

    A batch is kept as bytes when it comes back and put into words later: whoever waits for the acknowledgement does not wait for
    that.
    """

    def __init__(self) -> None:
        self._lines: deque[Change] = deque(maxlen=_MAX_LOG)
        self._raw: deque[tuple[_Flight, int, bytes]] = deque()
        self._dropped = 0
        self._lock = threading.Lock()

    def append(self, flight: _Flight, tick: int, old: bytes) -> None:
        """Add a batch that took effect at a sample, with the old values in the form of a batch."""
        self._raw.append((flight, tick, old))

    def settle(self) -> None:
        """Put what has come in into words."""
        with self._lock:
            while self._raw:
                flight, tick, old = self._raw.popleft()
                for change in _changes(flight, tick, old):
                    self._dropped += len(self._lines) == _MAX_LOG
                    self._lines.append(change)

    def since(self, number: int) -> tuple[Change, ...]:
        """Lines from number `number` on (0: all that are kept)."""
        self.settle()
        with self._lock:
            return tuple(islice(self._lines, max(0, number - self._dropped), None))


def _changes(flight: _Flight, tick: int, old: bytes) -> list[Change]:
    found: list[Change] = []
    at = 0
    for piece in flight.pieces:
        at += _ENTRY.size
        before, after = _shown(piece.place, old, at), _shown(piece.place, piece.data, 0)
        found.append(Change(tick, flight.host_time, piece.name, before, after, flight.author))
        at += len(piece.data) + -len(piece.data) % 8
    return found


class Updates:
    """The writing side of one load.

    Parameters
    ----------
    control : cffi struct control
    data : SharedFile
    dictionary : Dictionary
    log : ChangeLog
    alive : callable
        Whether the runner still runs.
    """

    def __init__(
        self, control: Any, data: SharedFile, dictionary: Dictionary, log: ChangeLog, alive: Callable[[], bool]
    ) -> None:
        ffi, lib = layout()
        self._ffi, self._lib, self._control, self._data = ffi, lib, control, data
        self._memory = np.frombuffer(data.map, dtype=np.uint8)
        # kept here: user code with a wild pointer may overwrite what is shared
        self._offset, self._stride = int(control.batch_offset), int(control.batch_stride)
        self._view = memoryview(data.map)
        self._dictionary, self._log, self._alive = dictionary, log, alive
        self._lock = threading.RLock()
        self._free = list(range(lib.LAYOUT_BATCHES))[::-1]
        self._flights: dict[int, _Flight] = {}
        self._applied: dict[int, int] = {}
        self._sequence = 0
        self._bank: dict[int, int] = {}  # bank that a table's newest update names, by variable

    # ---- write ------------------------------------------------------------------------------------------------------------

    def write(self, values: Mapping[str, object], author: str, at_tick: int | None, settings: bool = False) -> int:
        """Check everything, then commit it as one batch.

        Parameters
        ----------
        values : mapping of name to value
        author : str
        at_tick : int or None
            First sample at which it may act; None: the next one.
        settings : bool
            The names are the runtime's own settings rather than the program's variables.

        Returns
        -------
        int
            Sequence number for `wait_applied`.

        Raises
        ------
        VariableError
            One line for each variable that is wrong; nothing was applied.
        Refused
            Nothing to write, or too many updates wait.
        """
        if not values:
            raise Refused("an update needs at least one variable")
        pieces, tables = self._checked(values, settings)
        with self._lock:
            slot = self._take_slot()
            try:
                for name, place, rows in tables:
                    pieces.append(self._fill_bank(name, place, rows))
                return self._commit(slot, pieces, author, at_tick)
            except BaseException:
                self._free.append(slot)
                raise

    def _checked(
        self, values: Mapping[str, object], settings: bool
    ) -> tuple[list[_Piece], list[tuple[str, Place, npt.NDArray[np.float64]]]]:
        pieces: list[_Piece] = []
        tables: list[tuple[str, Place, npt.NDArray[np.float64]]] = []
        problems: list[str] = []
        for name, value in values.items():
            try:
                place = self._dictionary.place(name)
                if place.plain and type(value) is float and not settings and _inside(place, value):
                    pieces.append(_Piece(name, place, _DOUBLE.pack(value)))
                    continue
                if (place.entry.info.kind == "setting") != settings:
                    raise VariableError(f"{name}: is a setting of the runtime; use set_limits, set_ramp or set_overrun")
                if place.entry.info.kind == "table":
                    tables.append((name, place, encode_table(name, place, value)))
                else:
                    pieces.append(_Piece(name, place, encode(name, place, value)))
            except VariableError as error:
                problems.append(str(error))
        if problems:
            raise VariableError("\n".join(problems))
        return pieces, tables

    def _take_slot(self) -> int:
        self._harvest()
        if not self._alive():
            raise RunnerDied("the runner is gone, so nothing can be written: load the program again")
        if not self._free:
            raise Refused(f"{self._lib.LAYOUT_BATCHES} updates wait already: wait until some of them are applied")
        return self._free.pop()

    def _fill_bank(self, name: str, place: Place, rows: npt.NDArray[np.float64]) -> _Piece:
        """Write a table into the bank that the loop does not read; the batch then only names the bank."""
        index = place.entry.index
        if any(piece.place.entry.index == index for flight in self._flights.values() for piece in flight.pieces):
            raise Refused(f"{name}: its last download is not in effect yet; wait for it, then write again")
        current = self._bank.get(index, int(self._control.variable[index].table) >> 32 & 1)
        bank = 1 - current if int(self._control.variable[index].table) or index in self._bank else 0
        start = place.entry.banks[bank]
        self._memory[start : start + rows.nbytes] = rows.reshape(-1).view(np.uint8)
        self._bank[index] = bank
        return _Piece(name, place, np.array([bank, rows.shape[0]], dtype="<i4").tobytes())

    def _commit(self, slot: int, pieces: list[_Piece], author: str, at_tick: int | None) -> int:
        control = self._control
        start = self._offset + slot * self._stride
        body = bytearray()
        for piece in pieces:
            size = len(piece.data)
            body += _ENTRY.pack(piece.place.entry.index, piece.place.offset, size, 0)
            body += piece.data if size % 8 == 0 else piece.data + bytes(-size % 8)
        room = self._stride - self._ffi.sizeof("batch")
        if len(body) > room:
            raise Refused(f"the update takes {len(body)} bytes, {room} fit: write whole arrays in place of their elements")
        batch = self._data.pointer("batch", start)
        self._sequence += 1
        batch.entries, batch.sequence, batch.at_tick = len(pieces), self._sequence, at_tick or 0
        first = start + self._ffi.sizeof("batch")
        self._view[first : first + len(body)] = body
        self._flights[self._sequence] = _Flight(slot, tuple(pieces), author, time.time(), len(body))
        self._lib.monitor_commit(self._ffi.addressof(control), batch, slot)
        return self._sequence

    # ---- acknowledge ------------------------------------------------------------------------------------------------------

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Sleep until a batch has taken effect.

        Parameters
        ----------
        sequence : int
            From `write`.
        timeout : float
            s.

        Returns
        -------
        int
            The sample at whose start it took effect.

        Raises
        ------
        RunnerDied
            The runner ended before.
        Refused
            Not within the timeout, or no such update.
        """
        end = time.monotonic() + timeout
        while True:
            with self._lock:
                self._harvest()
                if sequence in self._applied:
                    return self._applied[sequence]
                flight = self._flights.get(sequence)
            if flight is None:
                raise Refused(f"update {sequence}: unknown, or acknowledged too long ago")
            if not self._alive():
                raise RunnerDied(f"the runner ended before update {sequence} took effect")
            left = end - time.monotonic()
            if left <= 0.0:
                raise Refused(f"update {sequence} did not take effect within {timeout:g} s: it waits for its sample (is the loop running?)")
            start = self._offset + flight.slot * self._stride
            self._lib.monitor_wait_applied(self._data.pointer("batch", start), min(_SLICE_NS, int(left * 1e9)))

    def harvest(self) -> None:
        """Take back the batches that were applied, and write the log."""
        with self._lock:
            self._harvest()
        self._log.settle()

    def _harvest(self) -> None:
        for sequence in list(self._flights):
            flight = self._flights[sequence]
            start = self._offset + flight.slot * self._stride
            batch = self._data.pointer("batch", start)
            if self._lib.monitor_load32(self._ffi.addressof(batch[0], "state")) != self._lib.BATCH_APPLIED:
                continue
            tick = int(batch.applied)
            body = start + self._ffi.sizeof("batch")
            self._log.append(flight, tick, bytes(self._view[body : body + flight.bytes]))
            batch.state = self._lib.BATCH_FREE
            del self._flights[sequence]
            self._free.append(flight.slot)
            self._applied[sequence] = tick
            if len(self._applied) > _MAX_ACKS:
                del self._applied[next(iter(self._applied))]


def _inside(place: Place, value: float) -> bool:
    """Plainly right: finite and within limits. All else goes the long way, which finds the words for what is wrong."""
    info = place.entry.info
    return info.minimum <= value <= info.maximum and -_LARGEST <= value <= _LARGEST


def _shown(place: Place, data: memoryview | bytes, offset: int) -> Value:
    """A value for the log; a table is logged by its number of rows."""
    if place.entry.info.kind == "table":
        rows: int = SCALARS["int32"].unpack_from(data, offset + 4)[0]
        return rows
    return value_of(place.entry, place.scalar, data, offset)
