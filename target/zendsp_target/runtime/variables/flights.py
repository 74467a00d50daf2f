"""Updates under way, from their slot in shared memory until the loop has applied them, those who
wait for them are told, and the log has them.

The loop exchanges values when it applies a batch, so the slot then holds the old values exactly as
they were at that sample.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from zendsp_protocol.errors import NotYet, Refused, RunnerDied, TooSoon
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.memory.shm import SharedFile
from zendsp_target.runtime.variables.banks import Banks
from zendsp_target.runtime.variables.change_log import ChangeLog, Flight, cut_short
from zendsp_target.runtime.variables.plans import ENTRY

TOGETHER = 16  # updates that are taken back together; the supervisor takes back fewer
LAST_TICK = 2**64 - 1
_SLICE_NS = 20_000_000  # a wait looks this often whether the runner has died
# periods up to this are waited for awake: to fall asleep and wake up takes as long
_SHORT_NS = 100_000
_MAX_ACKS = 4096
_CANCELLED = -1  # in place of a sample
_GONE = "the runner is gone, so nothing can be written: load the program again"
_WORDED_AT_ONCE = 128  # lines of the log at each harvest: a fraction of a millisecond


class Flights:
    """The updates of one load that were committed.

    Parameters
    ----------
    control : cffi struct control
    data : SharedFile
    log : ChangeLog
    banks : Banks
    alive : callable
        Whether the runner still runs.
    handle : int
        The runner's pidfd; -1 where the kernel has none.
    sequence : int
        The last number of an update of the loads before: numbers are never given anew.

    Attributes
    ----------
    lock : RLock
        Held from the taking of a slot until its batch is entered.
    batches : list of cffi struct batch *
        The slots.
    room : int
        Bytes of the entries of one.
    free : list of int
        Slots that nobody uses.
    under_way : dict of int to Flight
        By number, oldest first.
    sequence : int
        Number of the last update.
    """

    def __init__(
        self,
        control: Any,
        data: SharedFile,
        log: ChangeLog,
        banks: Banks,
        alive: Callable[[], bool],
        handle: int = -1,
        sequence: int = 0,
    ) -> None:
        ffi, lib = layout()
        self._lib, self._control, self._log, self._banks = lib, control, log, banks
        self._alive, self._handle = alive, handle
        self._pointer = ffi.addressof(control)
        # kept here: user code with a wild pointer may overwrite what is shared
        offset, stride = int(control.batch_offset), int(control.batch_stride)
        self._starts = [offset + slot * stride for slot in range(lib.LAYOUT_BATCHES)]
        self.batches = [data.pointer("batch", start) for start in self._starts]
        self._states = [ffi.addressof(batch[0], "state") for batch in self.batches]
        self._newest = ffi.addressof(control, "newest")
        self._cancels = ffi.addressof(control, "cancels")
        self._entries_at: int = ffi.sizeof("batch")
        self.room = stride - self._entries_at
        period = int(control.period_ns)
        self._awake = 2 * period if period <= _SHORT_NS else 0
        self._view = memoryview(data.map)
        self._cancelled = lib.BATCH_CANCELLED
        self.lock = threading.RLock()
        self.free = list(range(lib.LAYOUT_BATCHES))[::-1]
        self.under_way: dict[int, Flight] = {}
        self._applied: dict[int, int] = {}
        self._before = self.sequence = sequence
        # by variable, its last since `take_written`; None: a fade that was cut short
        self._written: dict[int, Flight | None] = {}

    def variables(self) -> set[int]:
        """Indices of the variables that updates under way write."""
        return {
            place.entry.index for flight in self.under_way.values() for _, place in flight.places
        }

    def take_slot(self, tables: bool, late: bool) -> int:
        """Take a free slot; the caller holds the lock.

        Raises
        ------
        TooSoon
            Too many updates wait.
        RunnerDied
        """
        if self._handle < 0 and not self._alive():
            raise RunnerDied(_GONE)
        # the last download of a table may be in effect by now
        if tables or len(self.under_way) >= TOGETHER or not self.free:
            self.take_back()
        most = self._lib.LAYOUT_BATCHES
        if not self.free:
            raise TooSoon(f"{most} updates wait already: wait until some of them are applied")
        # the other half is for updates of the next sample: none of them is kept waiting by these
        if late and sum(flight.late for flight in self.under_way.values()) >= most // 2:
            raise TooSoon(
                f"{most // 2} updates wait for a later sample, or fade, already: wait until some of"
                " them are applied"
            )
        return self.free.pop()

    def enter(self, flight: Flight, done: bool) -> int:
        """Enter a batch that was handed to the loop, or that it will never apply because its runner
        has ended. Returns the batch's number; the caller holds the lock.
        """
        if not done:
            self.free.append(flight.slot)
            raise RunnerDied(_GONE)
        self.sequence += 1
        self.under_way[self.sequence] = flight
        return self.sequence

    def wait_applied(self, sequence: int, timeout: float) -> int:
        """Wait until a batch has taken effect and its values can be read; return its sample.

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
            flight, shown = self.under_way.get(sequence), 0
            if flight is not None:
                slice_ns = min(_SLICE_NS, int(left * 1e9))
                shown = self._lib.monitor_wait_shown(
                    self._pointer, self.batches[flight.slot], slice_ns, self._awake
                )
            with self.lock:
                tick = self._tick_of(sequence, bool(shown))
                waits = sequence in self.under_way
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
        """The sample at which a batch took effect, None where it has not yet; ``shown``: it surely
        has. The slot is not taken back here.
        """
        flight = self.under_way.get(sequence)
        if flight is None:
            return self._applied.get(sequence)
        if not shown and not self._in_effect(flight.slot):
            return None
        batch = self.batches[flight.slot]
        return _CANCELLED if batch.state == self._cancelled else int(batch.applied)

    def _in_effect(self, slot: int) -> bool:
        """Whether a batch was applied and its values can be read, or its runner has ended after
        applying it.
        """
        if self._lib.monitor_shown(self._pointer, self.batches[slot]):
            return True
        applied: int = self._lib.BATCH_APPLIED
        # in this order: a runner that has ended applies nothing more
        return not self._alive() and self._lib.monitor_load32(self._states[slot]) >= applied

    def harvest(self) -> None:
        """Take back the batches that were applied, and write their lines of the log."""
        with self.lock:
            self.take_back()
        self._log.settle(_WORDED_AT_ONCE)

    def take_written(self, shown: Callable[[], None]) -> dict[int, bytes | None]:
        """Return the variables that were written since the last call, with the bytes that were
        written; call ``shown`` while nothing is committed.

        None in place of the bytes: an array, an update that still waits, or a fade that was cut
        short.
        """
        with self.lock:
            self.take_back()
            shown()
            written, self._written = self._written, {}
            waiting = self.variables()
        found: dict[int, bytes | None] = {n: None for n, flight in written.items() if not flight}
        for flight in {id(flight): flight for flight in written.values() if flight}.values():
            entries = flight.entries()
            at = 0
            for _, place in flight.places:
                size = ENTRY.unpack_from(entries, at)[2]
                at += ENTRY.size
                if written[place.entry.index] is flight:
                    alone = place.entry.info.length == 1
                    found[place.entry.index] = entries[at : at + size] if alone else None
                at += size + -size % 8
        return found | dict.fromkeys(waiting)

    def take_back(self) -> None:
        """Take back the batches that were applied; the caller holds the lock."""
        # What the loop applies while this looks is left for the next time: else a later batch
        # could be seen, and logged, before an earlier one.
        done = self._applied_by(self._lib.monitor_load64(self._newest))
        if len(done) < len(self.under_way) and not self._alive():
            done = self._applied_by(LAST_TICK)  # those that no snapshot will ever show
        for sequence in done:
            flight = self.under_way.pop(sequence)
            slot = flight.slot
            batch = self.batches[slot]
            tick = int(batch.applied)
            if batch.state == self._cancelled:  # the bank of a table that it was to bring is free
                for _, place in flight.places:
                    self._banks.forget(place.entry.index)
                self._release(sequence, flight.slot, _CANCELLED)
                continue
            body = self._starts[slot] + self._entries_at
            old = bytes(self._view[body : body + flight.size])
            left = cut_short(flight, old)
            for number, (_, place) in enumerate(flight.places):
                if number in left:
                    self._written.setdefault(place.entry.index, None)
                else:
                    self._written[place.entry.index] = flight
            self._log.append(flight, tick, old)
            self._release(sequence, slot, tick)

    def _release(self, sequence: int, slot: int, tick: int) -> None:
        self.batches[slot].state = self._lib.BATCH_FREE
        self.free.append(slot)
        self._applied[sequence] = tick
        if len(self._applied) > _MAX_ACKS:
            del self._applied[next(iter(self._applied))]

    def cancel(self, whose: Callable[[str], bool]) -> None:
        """Cancel the updates of these authors that wait for a later sample; the loop gives their
        batches back.
        """
        with self.lock:
            flights = [f for f in self.under_way.values() if f.late and whose(f.author)]
            for flight in flights:
                self.batches[flight.slot].cancel = 1
            if flights:
                cancels = (int(self._control.cancels) + 1) & 0xFFFFFFFF
                self._lib.monitor_store32(self._cancels, cancels)

    def _applied_by(self, newest: int) -> list[int]:
        """Numbers of the batches that are applied and shown by snapshot ``newest``, in the order in
        which the loop applied them.
        """
        found = []
        for sequence, flight in self.under_way.items():
            batch = self.batches[flight.slot]
            if (
                self._lib.monitor_load32(self._states[flight.slot]) >= self._lib.BATCH_APPLIED
                and batch.shown <= newest
            ):
                found.append((batch.applied, batch.at_tick, sequence))
        return [sequence for *_, sequence in sorted(found)]
