"""Synchronous updates: any number of variables, applied whole at the start of one sample, and the
log of what changed.

A batch is filled in shared memory and then published by one release store: a monitor that dies
while filling it has published nothing. The loop exchanges values when it applies a batch, so the
old ones come back exactly as they were at that sample.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from zendsp_protocol.errors import NotYet, Refused, RunnerDied, VariableError
from zendsp_protocol.values import Value
from zendsp_target.api import Blank
from zendsp_target.bounded import keep
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.memory.shm import SharedFile
from zendsp_target.runtime.variables.change_log import ChangeLog, Flight
from zendsp_target.runtime.variables.dictionary import Dictionary, Place
from zendsp_target.runtime.variables.plans import ENTRY, WritePlan
from zendsp_target.runtime.variables.values import FloatArray, check_kind, numbers_of

_SLICE_NS = 20_000_000  # waits come up for air so often, to see a runner that died
# periods up to this one are waited for awake: falling asleep and waking take as long
_SHORT_NS = 100_000
_TOGETHER = 16  # so many updates are taken back together; fewer, when the supervisor comes by
_MAX_ACKS = 4096
_LAST_TICK = 2**64 - 1
_CANCELLED = -1  # in place of a sample
_GONE = "the runner is gone, so nothing can be written: load the program again"
_NUMBERS = frozenset((float, int))
_WORDED_AT_ONCE = 128  # lines of the log at each harvest: a fraction of a millisecond


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
    sequence : int
        The last number of an update of the loads before: numbers are never given anew.
    """

    def __init__(
        self,
        control: Any,
        data: SharedFile,
        dictionary: Dictionary,
        log: ChangeLog,
        alive: Callable[[], bool],
        handle: int = -1,
        sequence: int = 0,
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
        self._newest = ffi.addressof(control, "newest")
        self._cancels = ffi.addressof(control, "cancels")
        self._entries_at: int = ffi.sizeof("batch")
        self._room = stride - self._entries_at
        period = int(control.period_ns)
        self._awake = 2 * period if period <= _SHORT_NS else 0
        self._view = memoryview(data.map)
        self._cancelled = lib.BATCH_CANCELLED
        self._dictionary, self._log, self._alive, self._handle = dictionary, log, alive, handle
        self._lock = threading.RLock()
        # by names: of the program's variables, and of the runtime's settings
        self._plans: tuple[dict[tuple[str, ...], WritePlan], ...] = ({}, {})
        self._free = list(range(lib.LAYOUT_BATCHES))[::-1]
        self._flights: dict[int, Flight] = {}
        self._applied: dict[int, int] = {}
        self._before = self._sequence = sequence
        self._written: dict[int, Flight] = {}  # by variable, its last since `take_written`
        self._bank: dict[int, int] = {}  # bank that a table's newest update names, by variable

    # -- write

    def write(
        self,
        values: Mapping[str, object],
        author: str,
        at_tick: int | None = None,
        fade: int = 0,
        *,
        settings: bool = False,
    ) -> int:
        """Check everything, then commit it as one batch.

        Parameters
        ----------
        values : mapping of name to value
        author : str
        at_tick : int or None
            First sample at which it may act; None: the next one.
        fade : int
            Samples over which numbers go from their old to their new values, slowly at first;
            whole numbers, flags and tables switch at the end. What is written later ends it.
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
        _require_sample(at_tick)
        if not values:
            raise Refused("an update needs at least one variable")
        plan = self._plan(values, settings)
        if fade and 2 * plan.size > self._room:
            raise Refused(
                f"fading {plan.size} bytes in needs twice as many, {self._room} fit: fade fewer"
                " variables at once"
            )
        given = tuple(values.values())
        # What has to be looked at one by one is so before others are kept waiting; single numbers
        # are judged as they are committed.
        numbers = (
            None
            if plan.scalar and _NUMBERS.issuperset(map(type, given))
            else self._numbers(values, settings)
        )
        late = at_tick is not None or fade > 0
        with self._lock:
            slot = self._take_slot(plan.tables, late)
            try:
                if numbers is None:
                    plan.fill(*given)
                else:
                    plan.put(self._banked(plan, numbers) if plan.tables else numbers)
                number = self._sequence + 1
                done = plan.commit(self._batches[slot], slot, number, at_tick or 0, fade)
                if done < 0:
                    raise VariableError(
                        "; ".join(
                            f"{name}: {value!r} does not fit" for name, value in values.items()
                        )
                    )
            except BaseException as error:
                self._free.append(slot)
                if isinstance(error, VariableError | OverflowError):
                    self._numbers(values, settings)  # has the words
                raise
            flight = Flight(
                slot, plan.places, plan.size, plan.given(), author, time.time(), fade, late
            )
            return self._committed(flight, done == 1)

    def _plan(self, values: Mapping[str, object], settings: bool) -> WritePlan:
        """What is ready for these names, or is made so."""
        names = tuple(values)
        plan = self._plans[settings].get(names)
        if plan is None:
            self._numbers(values, settings)  # says all that is wrong, not only with the names
            plan = WritePlan(
                [(name, self._dictionary.place(name)) for name in names],
                self._pointer,
                self._handle,
            )
            if plan.size > self._room:
                raise Refused(
                    f"the update takes {plan.size} bytes, {self._room} fit: write whole arrays in"
                    " place of their elements"
                )
            keep(self._plans[settings], names, plan)
        return plan

    def _numbers(self, values: Mapping[str, object], settings: bool) -> list[FloatArray]:
        """The numbers of every variable, or one line for each that is wrong."""
        found: list[FloatArray] = []
        problems: list[str] = []
        for name, value in values.items():
            try:
                place = self._dictionary.place(name)
                check_kind(name, place, settings)
                found.append(numbers_of(name, place, value))
            except VariableError as error:
                problems.append(str(error))
        if problems:
            raise VariableError("\n".join(problems))
        return found

    def check(self, values: Mapping[str, object], at_tick: int | None = None) -> None:
        """Raise what `write` would raise for these values; nothing is written."""
        _require_sample(at_tick)
        self._numbers(values, False)

    def repeat(
        self,
        ended: Any,
        names: Sequence[str],
        author: str,
        request: Blank,
        reply: Blank | None,
    ) -> Callable[[bytes], int] | None:
        """Make what commits doubles again, out of the bytes of a request; see
        `RuntimeApi.repeat_write`.
        """
        plan = self._plans[False].get(tuple(names))
        commit = None if plan is None or self._handle < 0 else plan.again(ended, request, reply)
        if plan is None or commit is None:
            return None
        entries = partial(plan.entries_of, request.values)
        lock = self._lock
        batches = self._batches
        free = self._free
        flights = self._flights
        now = time.time

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
                flights[sequence] = Flight(
                    slot, plan.places, plan.size, partial(entries, request), author, now()
                )
                self._sequence = sequence
                return sequence

        return write

    def _take_slot(self, tables: bool, late: bool) -> int:
        if self._handle < 0 and not self._alive():
            raise RunnerDied(_GONE)
        # the last download of a table may be in effect by now
        if tables or len(self._flights) >= _TOGETHER or not self._free:
            self._harvest()
        most = self._lib.LAYOUT_BATCHES
        if not self._free:
            raise Refused(f"{most} updates wait already: wait until some of them are applied")
        # the other half is for updates of the next sample: none of them is kept waiting by these
        if late and sum(flight.late for flight in self._flights.values()) >= most // 2:
            raise Refused(
                f"{most // 2} updates wait for a later sample, or fade, already: wait until some of"
                " them are applied"
            )
        return self._free.pop()

    def _banked(self, plan: WritePlan, numbers: list[FloatArray]) -> list[FloatArray]:
        """Put the rows of tables into their banks; what the batch holds is bank and number of rows.
        """
        waiting = {
            place.entry.index for flight in self._flights.values() for _, place in flight.places
        }
        for name, place in plan.places:  # all of them before the first bank is touched
            if place.entry.info.kind == "table" and place.entry.index in waiting:
                raise Refused(
                    f"{name}: its last download is not in effect yet; wait for it, then write again"
                )
        return [
            (
                np.array(self._fill_bank(place, rows), np.float64)
                if place.entry.info.kind == "table"
                else rows
            )
            for (_, place), rows in zip(plan.places, numbers, strict=True)
        ]

    def table(self, place: Place) -> Value:
        """Rows of a table as they stand. They are whole: nobody fills a bank meanwhile."""
        entry = place.entry
        with self._lock:
            word = int(self._control.variable[entry.index].table)
            rows, columns = min(word & 0xFFFFFFFF, entry.rows), entry.info.columns
            start = entry.banks[word >> 32 & 1]
            found = self._memory[start : start + rows * columns * 8].copy()
        return found.view("<f8").reshape(rows, columns)

    def _fill_bank(self, place: Place, rows: FloatArray) -> tuple[int, int]:
        """Write a table into the bank that the loop does not read; returns the bank and the rows.
        """
        index = place.entry.index
        current = self._bank.get(index, int(self._control.variable[index].table) >> 32 & 1)
        bank = 1 - current if int(self._control.variable[index].table) or index in self._bank else 0
        start = place.entry.banks[bank]
        self._memory[start : start + rows.nbytes] = rows.reshape(-1).view(np.uint8)
        self._bank[index] = bank
        return bank, rows.shape[0]

    def _committed(self, flight: Flight, done: bool) -> int:
        """Enter a batch that the loop has now; or that it cannot have, its runner being gone."""
        if not done:
            self._free.append(flight.slot)
            raise RunnerDied(_GONE)
        self._sequence += 1
        self._flights[self._sequence] = flight
        return self._sequence

    @property
    def sequence(self) -> int:
        """Number of the last update."""
        return self._sequence

    # -- acknowledge

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Sleep until a batch has taken effect, and whoever reads from here on gets its values.

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
            The runner ended before, or another program was loaded.
        NotYet
            Its sample has not come within the timeout.
        Refused
            No such update, or it was cancelled.
        """
        if sequence <= self._before:
            raise RunnerDied(
                f"update {sequence}: its program is no longer loaded; the log has it if it took"
                " effect"
            )
        end = time.monotonic() + timeout
        left = max(0.0, timeout)
        while True:
            flight, shown = self._flights.get(sequence), 0
            if flight is not None:
                slice_ns = min(_SLICE_NS, int(left * 1e9))
                shown = self._lib.monitor_wait_shown(
                    self._pointer, self._batches[flight.slot], slice_ns, self._awake
                )
            with self._lock:
                tick = self._tick_of(sequence, bool(shown))
                waits = sequence in self._flights
            if tick == _CANCELLED:
                raise Refused(
                    f"update {sequence} was not applied, and will not be: before its sample came,"
                    " a STOP or trip was acknowledged, its host was lost, or another took the right"
                    " to command"
                )
            if tick is not None:
                return tick
            if not waits:
                raise Refused(f"update {sequence}: unknown, or acknowledged too long ago")
            if not self._alive():
                raise RunnerDied(f"the runner ended before update {sequence} took effect")
            left = end - time.monotonic()
            if left <= 0.0:
                raise NotYet(
                    f"update {sequence} did not take effect within {timeout:g} s: it waits for its"
                    " sample (is the loop running?)"
                )

    def _tick_of(self, sequence: int, shown: bool) -> int | None:
        """The sample at which a batch took effect, which is known where it is `shown`; it is left
        to be taken back by whoever has time.
        """
        flight = self._flights.get(sequence)
        if flight is None:
            return self._applied.get(sequence)
        if not shown and not self._in_effect(flight.slot):
            return None
        batch = self._batches[flight.slot]
        return _CANCELLED if batch.state == self._cancelled else int(batch.applied)

    def _in_effect(self, slot: int) -> bool:
        """A batch was applied, and its values can be read; or are the last ones that a runner took.
        """
        if self._lib.monitor_shown(self._pointer, self._batches[slot]):
            return True
        applied: int = self._lib.BATCH_APPLIED
        # in this order: what a runner that is gone has not applied, it never will
        return not self._alive() and self._lib.monitor_load32(self._states[slot]) >= applied

    def harvest(self) -> None:
        """Take back the batches that were applied, and write the log."""
        with self._lock:
            self._harvest()
        self._log.settle(_WORDED_AT_ONCE)

    def take_written(self, shown: Callable[[], None]) -> dict[int, bytes | None]:
        """Call ``shown`` while nothing is committed; returns the variables that were written since
        the last call, and of single numbers what was. None: of an array, or about to be.
        """
        with self._lock:
            self._harvest()
            shown()
            written, self._written = self._written, {}
            waiting = [place for flight in self._flights.values() for _, place in flight.places]
        found: dict[int, bytes | None] = {}
        for flight in {id(flight): flight for flight in written.values()}.values():
            entries = flight.entries()
            at = 0
            for _, place in flight.places:
                size = ENTRY.unpack_from(entries, at)[2]
                at += ENTRY.size
                if written[place.entry.index] is flight:
                    alone = place.entry.info.length == 1
                    found[place.entry.index] = entries[at : at + size] if alone else None
                at += size + -size % 8
        return found | {place.entry.index: None for place in waiting}

    def _harvest(self) -> None:
        # What the loop applies while this looks is left for the next time: else a later batch
        # could be seen, and logged, before an earlier one.
        done = self._applied_by(self._lib.monitor_load64(self._newest))
        if len(done) < len(self._flights) and not self._alive():
            done = self._applied_by(_LAST_TICK)  # those that no snapshot shows, nor ever will
        for sequence in done:
            flight = self._flights.pop(sequence)
            slot = flight.slot
            batch = self._batches[slot]
            tick = int(batch.applied)
            if batch.state == self._cancelled:  # the bank of a table that it was to bring is free
                for _, place in flight.places:
                    self._bank.pop(place.entry.index, None)
                self._release(sequence, flight.slot, _CANCELLED)
                continue
            body = self._starts[slot] + self._entries_at
            self._written.update((place.entry.index, flight) for _, place in flight.places)
            self._log.append(flight, tick, bytes(self._view[body : body + flight.size]))
            self._release(sequence, slot, tick)

    def _release(self, sequence: int, slot: int, tick: int) -> None:
        self._batches[slot].state = self._lib.BATCH_FREE
        self._free.append(slot)
        self._applied[sequence] = tick
        if len(self._applied) > _MAX_ACKS:
            del self._applied[next(iter(self._applied))]

    def cancel(self, whose: Callable[[str], bool]) -> None:
        """Have updates of these authors that wait for a later sample wait no more: the loop gives
        them back.
        """
        with self._lock:
            flights = [f for f in self._flights.values() if f.late and whose(f.author)]
            for flight in flights:
                self._batches[flight.slot].cancel = 1
            if flights:
                cancels = (int(self._control.cancels) + 1) & 0xFFFFFFFF
                self._lib.monitor_store32(self._cancels, cancels)

    def _applied_by(self, newest: int) -> list[int]:
        """Numbers of the batches that are applied and that snapshot ``newest`` shows, in the order
        in which the loop applied them.
        """
        found = []
        for sequence, flight in self._flights.items():
            batch = self._batches[flight.slot]
            if (
                self._lib.monitor_load32(self._states[flight.slot]) >= self._lib.BATCH_APPLIED
                and batch.shown <= newest
            ):
                found.append((batch.applied, batch.at_tick, sequence))
        return [sequence for *_, sequence in sorted(found)]


def _require_sample(at_tick: int | None) -> None:
    if at_tick is not None and not 0 <= at_tick <= _LAST_TICK:
        raise Refused(
            f"at_tick {at_tick} is no sample: give one from 0 on, or leave it out for the next"
        )
