"""Synchronous updates: any number of variables, applied whole at the start of one sample, and the log of what changed.

A batch is filled in shared memory and then published by one release store: a monitor that dies while filling it has published
nothing. The loop exchanges values when it applies a batch, so the old ones come back exactly as they were at that sample.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import NotYet, Refused, RunnerDied, VariableError
from zendsp_target.api import Blank
from zendsp_target.change_log import ChangeLog, Flight
from zendsp_target.dictionary import Dictionary, Place
from zendsp_target.layout import layout
from zendsp_target.plans import ENTRY, WritePlan, keep
from zendsp_target.shm import SharedFile
from zendsp_target.values import encode, encode_table

_HEAD = struct.Struct("<IQQ")  # batch: entries, sequence, at_tick
_HEAD_AT = 4  # behind its state
_SLICE_NS = 20_000_000  # waits come up for air so often, to see a runner that died
_SHORT_NS = 100_000  # periods up to this one are waited for awake: falling asleep and waking take as long
_TOGETHER = 16  # so many updates are taken back together; fewer, when the supervisor comes by
_MAX_ACKS = 4096
_LAST_TICK = 2**64 - 1
_GONE = "the runner is gone, so nothing can be written: load the program again"
_NUMBERS = frozenset((float, int))
_WORDED_AT_ONCE = 128  # lines of the log at each harvest: a fraction of a millisecond


class _Piece(NamedTuple):
    name: str
    place: Place
    data: bytes


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
    handle : int
        The runner's pidfd, which tells the same within the commit; -1 where the kernel has none.
    """

    def __init__(
        self, control: Any, data: SharedFile, dictionary: Dictionary, log: ChangeLog, alive: Callable[[], bool], handle: int = -1
    ) -> None:
        ffi, lib = layout()
        self._lib, self._control, self._data = lib, control, data
        self._pointer = ffi.addressof(control)
        self._memory = np.frombuffer(data.map, dtype=np.uint8)
        # kept here: user code with a wild pointer may overwrite what is shared
        offset, stride = int(control.batch_offset), int(control.batch_stride)
        self._starts = [offset + slot * stride for slot in range(lib.LAYOUT_BATCHES)]
        self._batches = [data.pointer("batch", start) for start in self._starts]
        self._states = [ffi.addressof(batch[0], "state") for batch in self._batches]
        self._entries_at: int = ffi.sizeof("batch")
        self._room = stride - self._entries_at
        period = int(control.period_ns)
        self._awake = 2 * period if period <= _SHORT_NS else 0
        self._view = memoryview(data.map)
        self._dictionary, self._log, self._alive, self._handle = dictionary, log, alive, handle
        self._lock = threading.RLock()
        self._plans: dict[tuple[str, ...], WritePlan] = {}
        self._free = list(range(lib.LAYOUT_BATCHES))[::-1]
        self._flights: dict[int, Flight] = {}
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
        if at_tick is not None and not 0 <= at_tick <= _LAST_TICK:
            raise Refused(f"at_tick {at_tick} is no sample: give one from 0 on, or leave it out for the next")
        names = tuple(values)
        plan = self._plans.get(names)
        if plan is not None and not settings and (
            sequence := self._write_planned(plan, tuple(values.values()), author, at_tick or 0)
        ):
            return sequence
        if not values:
            raise Refused("an update needs at least one variable")
        pieces, tables = self._checked(values, settings)
        if plan is None and not tables and all(piece.place.plain for piece in pieces):
            plan = WritePlan([(piece.name, piece.place) for piece in pieces], self._pointer, self._handle)
            if plan.size <= self._room:
                keep(self._plans, names, plan)
        with self._lock:
            if tables:
                self._harvest()  # the last download of a table may be in effect by now
            slot = self._take_slot()
            try:
                for name, place, rows in tables:
                    pieces.append(self._fill_bank(name, place, rows))
                body = self._body(pieces)
                start = self._starts[slot]
                _HEAD.pack_into(self._view, start + _HEAD_AT, len(pieces), self._sequence + 1, at_tick or 0)
                first = start + self._entries_at
                self._view[first : first + len(body)] = body
            except BaseException:
                self._free.append(slot)
                raise
            places = tuple((piece.name, piece.place) for piece in pieces)
            flight = Flight(slot, places, len(body), lambda: body, author, time.time())
            done = self._lib.monitor_commit(self._pointer, self._batches[slot], slot, self._handle)
            return self._committed(flight, done == 1)

    def _write_planned(self, plan: WritePlan, numbers: tuple[Any, ...], author: str, at_tick: int) -> int:
        """The sequence number, or 0 where something is wrong: then the long way says what."""
        if not _NUMBERS.issuperset(map(type, numbers)):
            return 0
        with self._lock:
            try:
                plan.fill(*numbers)
            except OverflowError:
                return 0
            slot = self._take_slot()
            done = plan.commit(self._batches[slot], slot, self._sequence + 1, at_tick)
            if done < 0:
                self._free.append(slot)
                return 0
            flight = Flight(slot, plan.places, plan.size, partial(plan.entries, numbers), author, time.time())
            return self._committed(flight, done == 1)

    def check(self, values: Mapping[str, object]) -> None:
        """Raise what `write` would raise for these values; nothing is written."""
        self._checked(values, False)

    def repeat(self, ended: Any, name: str, author: str, value_at: int, reply: Blank) -> Callable[[bytes], int] | None:
        """Make what commits one value again, out of the bytes of a request; see `RuntimeApi.repeat_write`."""
        plan = self._plans.get((name,))
        if plan is None or self._handle < 0:
            return None
        commit, entries = plan.again(ended, value_at, reply), partial(plan.entries_of, value_at)
        lock, batches, free, flights, now = self._lock, self._batches, self._free, self._flights, time.time

        def write(request: bytes) -> int:
            with lock:
                if len(flights) >= _TOGETHER or not free:
                    self._harvest()
                if not free:
                    return 0
                slot, sequence = free.pop(), self._sequence + 1
                if commit(request, batches[slot], slot, sequence) != 1:
                    free.append(slot)
                    return 0
                flights[sequence] = Flight(slot, plan.places, plan.size, partial(entries, request), author, now())
                self._sequence = sequence
                return sequence

        return write

    def _checked(
        self, values: Mapping[str, object], settings: bool
    ) -> tuple[list[_Piece], list[tuple[str, Place, npt.NDArray[np.float64]]]]:
        pieces: list[_Piece] = []
        tables: list[tuple[str, Place, npt.NDArray[np.float64]]] = []
        problems: list[str] = []
        for name, value in values.items():
            try:
                place = self._dictionary.place(name)
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
        if self._handle < 0 and not self._alive():
            raise RunnerDied(_GONE)
        if len(self._flights) >= _TOGETHER or not self._free:
            self._harvest()
        if not self._free:
            raise Refused(f"{self._lib.LAYOUT_BATCHES} updates wait already: wait until some of them are applied")
        return self._free.pop()

    def _fill_bank(self, name: str, place: Place, rows: npt.NDArray[np.float64]) -> _Piece:
        """Write a table into the bank that the loop does not read; the batch then only names the bank."""
        index = place.entry.index
        if any(place.entry.index == index for flight in self._flights.values() for _, place in flight.places):
            raise Refused(f"{name}: its last download is not in effect yet; wait for it, then write again")
        current = self._bank.get(index, int(self._control.variable[index].table) >> 32 & 1)
        bank = 1 - current if int(self._control.variable[index].table) or index in self._bank else 0
        start = place.entry.banks[bank]
        self._memory[start : start + rows.nbytes] = rows.reshape(-1).view(np.uint8)
        self._bank[index] = bank
        return _Piece(name, place, np.array([bank, rows.shape[0]], dtype="<i4").tobytes())

    def _body(self, pieces: list[_Piece]) -> bytes:
        """Entries of a batch."""
        body = bytearray()
        for piece in pieces:
            size = len(piece.data)
            body += ENTRY.pack(piece.place.entry.index, piece.place.offset, size, 0)
            body += piece.data if size % 8 == 0 else piece.data + bytes(-size % 8)
        if len(body) > self._room:
            raise Refused(f"the update takes {len(body)} bytes, {self._room} fit: write whole arrays in place of their elements")
        return bytes(body)

    def _committed(self, flight: Flight, done: bool) -> int:
        """Enter a batch that the loop has now; or that it cannot have, its runner being gone."""
        if not done:
            self._free.append(flight.slot)
            raise RunnerDied(_GONE)
        self._sequence += 1
        self._flights[self._sequence] = flight
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
        NotYet
            Its sample has not come within the timeout.
        Refused
            No such update.
        """
        end = time.monotonic() + timeout
        left = max(0.0, timeout)
        while True:
            flight = self._flights.get(sequence)
            if flight is not None:
                slice_ns = min(_SLICE_NS, int(left * 1e9))
                self._lib.monitor_wait_applied(self._batches[flight.slot], slice_ns, self._awake)
            with self._lock:
                tick = self._tick_of(sequence)
                waits = sequence in self._flights
            if tick is not None:
                return tick
            if not waits:
                raise Refused(f"update {sequence}: unknown, or acknowledged too long ago")
            if not self._alive():
                raise RunnerDied(f"the runner ended before update {sequence} took effect")
            left = end - time.monotonic()
            if left <= 0.0:
                raise NotYet(f"update {sequence} did not take effect within {timeout:g} s: it waits for its sample (is the loop running?)")

    def _tick_of(self, sequence: int) -> int | None:
        """The sample at which a batch took effect; it is left to be taken back by whoever has time."""
        flight = self._flights.get(sequence)
        if flight is None:
            return self._applied.get(sequence)
        if self._lib.monitor_load32(self._states[flight.slot]) != self._lib.BATCH_APPLIED:
            return None
        return int(self._batches[flight.slot].applied)

    def harvest(self) -> None:
        """Take back the batches that were applied, and write the log."""
        with self._lock:
            self._harvest()
        self._log.settle(_WORDED_AT_ONCE)

    def _harvest(self) -> None:
        load, applied = self._lib.monitor_load32, self._lib.BATCH_APPLIED
        for sequence, flight in list(self._flights.items()):
            slot = flight.slot
            if load(self._states[slot]) != applied:
                continue
            batch = self._batches[slot]
            tick = int(batch.applied)
            body = self._starts[slot] + self._entries_at
            self._log.append(flight, tick, bytes(self._view[body : body + flight.size]))
            batch.state = self._lib.BATCH_FREE
            del self._flights[sequence]
            self._free.append(slot)
            self._applied[sequence] = tick
            if len(self._applied) > _MAX_ACKS:
                del self._applied[next(iter(self._applied))]
