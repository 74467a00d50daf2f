"""Prepared readings and updates for names that come again: a host that tunes or watches asks for
the same ones thousands of times.

A plan holds what does not change while a program is loaded: where each value stands, its limits,
the bytes around it. Every update uses one. A reading for which there is no plan is decoded by
``dictionary``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from functools import partial
from struct import Struct
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.states import VariableKind
from zendsp_protocol.values import Value
from zendsp_target.api import Blank
from zendsp_target.runtime.memory.layout import layout, struct
from zendsp_target.runtime.variables.dictionary import SCALARS, Place, value_of

IN_MESSAGE = Struct(">d")
ENTRY = Struct("<iiii")  # batch_entry: variable, offset, size, left
_DOUBLE = SCALARS["double"].size
_TICK = Struct("<Q")
_TYPES = {"double": 1, "float": 2, "int32": 3, "bool": 4}  # TYPE_… of layout.h
_UNLIMITED = float("inf")


def set_part(part: Any, place: Place, rows: int | None = None) -> None:
    """Describe one variable of an update.

    Parameters
    ----------
    rows : int, optional
        Of a table: numbers of its rows, to be checked. Default: its bank and number of rows, as two
        int32.
    """
    _, lib = layout()
    entry, info = place.entry, place.entry.info
    part.entry.variable, part.entry.offset = entry.index, place.offset
    if info.kind == VariableKind.TABLE and rows is None:
        part.type, part.count, size, limits = lib.TYPE_INT32, 2, 4, (-_UNLIMITED, _UNLIMITED)
    else:
        part.type = _TYPES[info.type]
        size = entry.dtype.itemsize
        limits = (info.minimum, info.maximum)
        part.count = rows if rows is not None else 1 if place.scalar else info.length
    part.entry.size = part.count * size
    part.least, part.greatest = limits


class WritePlan:
    """An update of the same variables, with new numbers each time.

    Parameters
    ----------
    places : iterable of (name, Place)
    control : cffi struct control *
    handle : int
        The runner's pidfd, or -1.

    Attributes
    ----------
    tables : bool
        Whether tables are among them: of these the update holds bank and rows.
    scalar : bool
        Whether every one is a single number.
    fill : callable
        Takes the new numbers, one argument for each; one caller at a time.
    commit : callable
        Takes batch, slot, sequence, sample and samples of the fade, checks the numbers, fills the
        batch and commits it; what it returns stands at ``monitor_write``.
    """

    # Both are made once and stay in C: a monitor that wakes up for a request pays for every Python
    # function on the way several times over.
    fill: Callable[..., None]
    commit: Callable[[Any, int, int, int, int], int]

    def __init__(self, places: Iterable[tuple[str, Place]], control: Any, handle: int) -> None:
        self.places = tuple(places)
        ffi, lib = layout()
        parts = ffi.new("update_part[]", len(self.places))
        count = self.size = 0  # of the batch's entries, bytes
        for part, (_, place) in zip(parts, self.places, strict=True):
            set_part(part, place)
            count += part.count
            self.size += ENTRY.size + part.entry.size + -part.entry.size % _DOUBLE
        self.tables = any(place.entry.info.kind == VariableKind.TABLE for _, place in self.places)
        self.scalar = all(place.scalar for _, place in self.places)
        self._lib, self._ffi = lib, ffi
        self._given = bytearray(_DOUBLE * count)
        self._parts = parts
        self._plan = struct("update_plan", to=control, part=parts, parts=len(parts), pidfd=handle)
        self.fill = partial(Struct(f"<{count}d").pack_into, self._given, 0)
        self.commit = partial(
            lib.monitor_write, self._plan, ffi.from_buffer("double[]", self._given)
        )

    def put(self, numbers: Iterable[npt.NDArray[np.float64]]) -> None:
        """As ``fill``, where some variables are arrays; of a table, give its bank and number of
        rows.
        """
        self._given[:] = np.concatenate(list(numbers), dtype="<f8").tobytes()

    def given(self) -> Callable[[], bytes]:
        """Return a function that makes the batch's entries for the log, of the numbers that were
        filled in last.
        """
        return partial(self._entries, bytes(self._given))

    def _entries(self, numbers: bytes) -> bytes:
        entries = bytearray(self.size)
        numbers_at = self._ffi.from_buffer("double[]", numbers)
        entries_at = self._ffi.from_buffer("unsigned char[]", entries)
        self._lib.monitor_pack(self._parts, len(self._parts), numbers_at, entries_at)
        return bytes(entries)

    def again(
        self, ended: Any, request: Blank, reply: Blank
    ) -> Callable[[bytes, Any, int, int], int] | None:
        """Return a ``commit`` for requests that differ only in their doubles: it takes request,
        batch, slot and sequence, and fills the reply.
        """
        if len(request.values) != len(self.places) or not all(p.plain for _, p in self.places):
            return None
        ffi = self._ffi
        again = struct(
            "repeated_write",
            ended=ended,
            plan=self._plan,
            request=ffi.from_buffer("unsigned char[]", request.data),
            length=len(request.data),
            places=ffi.new("uint32_t[]", request.values),
            values=ffi.new("double[]", len(self.places)),
            reply=ffi.from_buffer("unsigned char[]", reply.data),
            sequence_at=reply.count,
        )
        return partial(self._lib.monitor_write_again, again)

    def entries_of(self, places: Iterable[int], request: bytes) -> bytes:
        """The batch's entries for the log, of a request that came again."""
        numbers = (SCALARS["double"].pack(*IN_MESSAGE.unpack_from(request, at)) for at in places)
        return self._entries(b"".join(numbers))


class ReadPlan:
    """A reading of the same variables, tables excepted.

    Parameters
    ----------
    places : iterable of (name, Place)
    """

    def __init__(self, places: Iterable[tuple[str, Place]]) -> None:
        found = tuple((name, place, place.entry.offset + place.offset) for name, place in places)
        ends = [
            at + (place.entry.dtype.itemsize if place.scalar else place.entry.size)
            for _, place, at in found
        ]
        self.first = min(at for _, _, at in found)
        self.size = max(ends) - self.first
        start = _TICK.size - self.first
        self._fields = tuple(
            (
                name,
                SCALARS[place.entry.info.type].unpack_from if place.scalar else None,
                place.entry,
                start + at,
            )
            for name, place, at in found
        )
        ffi, self._lib = layout()
        self._memory = bytearray(_TICK.size + self.size)
        buffer = ffi.from_buffer(self._memory)
        self._tick, self._values = ffi.cast("uint64_t *", buffer), buffer + _TICK.size
        self._lock = threading.Lock()

    def again(
        self, ended: Any, control: Any, data: Any, slots_at: int, stride: int, reply: Blank
    ) -> Callable[[], int] | None:
        """Return a function that fills a reply with the newest sample; None where a variable is no
        double.

        Parameters
        ----------
        ended : cffi uint32_t *
        control, data : cffi pointers
            They hold the memory, also of a program that is gone.
        slots_at, stride : int
            Of the snapshots within data, bytes.

        Returns
        -------
        callable or None
            Returns 0 where nothing is told.
        """
        if any(
            unpack is None or entry.info.type != "double" for _, unpack, entry, _ in self._fields
        ):
            return None
        ffi, lib = layout()
        places = [
            x
            for (*_, at), to in zip(self._fields, reply.values, strict=True)
            for x in (at - _TICK.size, to)
        ]
        again = struct(
            "repeated_read",
            ended=ended,
            of=control,
            data=data,
            slots_at=slots_at,
            stride=stride,
            bytes=self.size,
            values=ffi.new("unsigned char[]", self.size),
            places=ffi.new("uint32_t[]", places),
            count=len(self._fields),
            tick_at=reply.count,
            reply=ffi.from_buffer("unsigned char[]", reply.data),
            **{"from": self.first},
        )
        return partial(lib.monitor_read_again, again)

    def read(self, newest: Any, slots: Any, stride: int) -> tuple[int, dict[str, Value]] | None:
        """The tick and the values of the newest sample; None while there is none.

        Parameters
        ----------
        stride : int
            Bytes from one snapshot to the next.
        """
        memory = self._memory
        with self._lock:
            if not self._lib.monitor_snapshot(
                newest, slots, stride, self.first, self.size, self._values, self._tick
            ):
                return None
            found: dict[str, Value] = {
                name: (
                    unpack(memory, at)[0]
                    if unpack is not None
                    else value_of(entry, False, memory, at)
                )
                for name, unpack, entry, at in self._fields
            }
            return _TICK.unpack_from(memory)[0], found
