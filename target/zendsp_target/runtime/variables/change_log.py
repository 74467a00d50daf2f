"""The log of changes: every change of a parameter, with its sample, the old and the new value, and
its author.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from itertools import islice

import msgspec

from zendsp_protocol.messages import Change
from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Value
from zendsp_target.runtime.variables.dictionary import SCALARS, Place, value_of
from zendsp_target.runtime.variables.plans import ENTRY

_MAX_LOG = 100_000  # lines kept; older ones are dropped
_MOST_BYTES = 64 << 20  # of their values: of long arrays, so many lines would fill the memory


class Flight(msgspec.Struct, frozen=True):
    """A batch that was committed and whose old values are not yet fetched. It is a struct of
    msgspec, since one is made at each write.
    """

    slot: int
    places: tuple[tuple[str, Place], ...]  # one for each entry
    size: int  # of the entries, bytes
    entries: Callable[[], bytes]  # as they were written
    author: str
    host_time: float
    fade: int = 0  # samples
    late: bool = False  # it may wait for longer than until the next sample


class ChangeLog:
    """Every change of a parameter, in the order of the samples; all loads of a target share it.

    A batch is kept as bytes when it comes back from the loop. Its lines are written a few at a
    time, and all that remain when somebody asks for the log: otherwise hundreds of updates a
    second, of many variables each, would keep the interpreter from answering requests.
    """

    def __init__(self) -> None:
        self._lines: deque[Change] = deque()
        self._costs: deque[int] = deque()  # bytes of the values of each line
        self._held = 0  # bytes of all of them
        self._raw: deque[tuple[Flight, int, bytes, int]] = deque()
        self._came = self._worded = 0  # lines, in all
        self._bytes_came = self._bytes_worded = 0
        self._lock = threading.Lock()

    def append(self, flight: Flight, tick: int, old: bytes) -> None:
        """Add a batch that took effect at sample ``tick``, with the old values in the form of a
        batch. For one caller at a time.
        """
        count = len(flight.places) - len(cut_short(flight, old))
        self._raw.append((flight, tick, old, count))
        self._came += count
        self._bytes_came += 2 * flight.size

    def settle(self, most: int = _MAX_LOG) -> None:
        """Write the lines of the batches that came in: about ``most`` of them."""
        with self._lock:
            done = 0
            while self._raw and done < most:
                flight, tick, old, count = self._raw.popleft()
                self._worded += count
                self._bytes_worded += 2 * flight.size
                waiting = self._bytes_came - self._bytes_worded
                # newer ones fill the log without it
                if self._came - self._worded >= _MAX_LOG or waiting >= _MOST_BYTES:
                    self._lines.clear()
                    self._costs.clear()
                    self._held = 0
                    continue
                self._lines.extend(_changes(flight, tick, old))
                self._costs.extend([2 * flight.size // max(1, count)] * count)
                self._held += 2 * flight.size // max(1, count) * count
                while len(self._lines) > _MAX_LOG or self._held > _MOST_BYTES:
                    self._lines.popleft()
                    self._held -= self._costs.popleft()
                done += count

    def since(self, number: int) -> tuple[Change, ...]:
        """The lines from number `number` on; 0: all that are kept."""
        self.settle(2 * _MAX_LOG)
        with self._lock:
            dropped = self._worded - len(self._lines)
            return tuple(islice(self._lines, min(max(0, number - dropped), len(self._lines)), None))


def cut_short(flight: Flight, old: bytes) -> set[int]:
    """Numbers of the entries of a batch whose fade was ended by a later update: they never reached
    their values.
    """
    if not flight.fade:
        return set()
    at, new, found = 0, flight.entries(), set[int]()
    for number in range(len(flight.places)):
        if ENTRY.unpack_from(old, at)[3]:
            found.add(number)
        size = ENTRY.unpack_from(new, at)[2]
        at += ENTRY.size + size + -size % 8
    return found


def _changes(flight: Flight, tick: int, old: bytes) -> list[Change]:
    found: list[Change] = []
    at = 0
    new, left = flight.entries(), cut_short(flight, old)
    for number, (name, place) in enumerate(flight.places):
        size = ENTRY.unpack_from(new, at)[2]
        at += ENTRY.size
        before, after = _shown(place, old, at), _shown(place, new, at)
        if number not in left:
            found.append(
                Change(tick, flight.host_time, name, before, after, flight.author, flight.fade)
            )
        at += size + -size % 8
    return found


def _shown(place: Place, data: bytes, offset: int) -> Value:
    """A value as the log shows it; of a table, its number of rows."""
    if place.entry.info.kind == VariableKind.TABLE:
        rows: int = SCALARS["int32"].unpack_from(data, offset + 4)[0]
        return rows
    return value_of(place.entry, place.scalar, data, offset)
