"""The variables that the running code declares: names, types, limits, and where each value stands
in a snapshot.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import VariableError, nearest
from zendsp_protocol.messages import VariableInfo
from zendsp_protocol.states import VariableKind
from zendsp_protocol.texts import joint_units, on_one_line
from zendsp_protocol.values import Value
from zendsp_target.runtime.memory.layout import text_of

SCALARS = {
    "double": struct.Struct("<d"),
    "float": struct.Struct("<f"),
    "int32": struct.Struct("<i"),
    "bool": struct.Struct("?"),
}
_TYPES: dict[int, tuple[str, np.dtype[Any]]] = {
    1: ("double", np.dtype("<f8")), 2: ("float", np.dtype("<f4")), 3: ("int32", np.dtype("<i4")),
    4: ("bool", np.dtype("?")),
}
_KINDS = dict(enumerate(VariableKind, 1))  # KIND_… of layout.h, in its order
HINTS = 10  # of one request: to compare a name with a thousand others takes 20 ms
_ELEMENT = re.compile(r"^(?P<name>.+?)\[(?P<index>[0-9]{1,9})(?:, ?(?P<column>[0-9]{1,9}))?\]$")


@dataclass(frozen=True)
class Entry:
    """One variable: what the host is told (`info`), and where the variable is."""

    info: VariableInfo
    index: int  # in the runner's dictionary
    dtype: np.dtype[Any]
    offset: int  # within a snapshot, bytes; -1 for a table
    size: int  # bytes; 0 for a table
    banks: tuple[int, int]  # of a table: offsets in the data file

    @property
    def rows(self) -> int:
        """Capacity of a table; rows of a matrix."""
        return self.info.length // self.info.columns

    @property
    def matrix(self) -> bool:
        """Whether its values have rows and columns, and it is no table."""
        return self.info.columns > 1 and self.info.kind != VariableKind.TABLE

    @property
    def words(self) -> str:
        """The number of its elements."""
        if self.matrix:
            return f"{self.rows} rows of {self.info.columns}"
        return f"{self.info.length} elements"


@dataclass(frozen=True)
class Place:
    """A variable, or one element of it."""

    entry: Entry
    element: int | None = None
    offset: int = 0  # bytes into the variable
    scalar: bool = field(init=False)  # one number, rather than an array or a table
    # a double that the host may write: what is written a hundred times a second
    plain: bool = field(init=False)

    def __post_init__(self) -> None:
        info = self.entry.info
        scalar = self.element is not None or (info.length == 1 and info.kind != VariableKind.TABLE)
        object.__setattr__(self, "scalar", scalar)
        object.__setattr__(
            self, "plain", scalar and info.type == "double" and info.kind == VariableKind.PARAMETER
        )


def value_of(entry: Entry, scalar: bool, raw: memoryview | bytes | bytearray, offset: int) -> Value:
    """The value at an offset: a Python number, or a copy of an array.

    Parameters
    ----------
    scalar : bool
        One element rather than the whole array.
    raw : bytes-like
    offset : int
        Bytes.
    """
    if scalar:
        number: Value = SCALARS[entry.info.type].unpack_from(raw, offset)[0]
        return number
    info = entry.info
    array = np.frombuffer(raw, dtype=entry.dtype, count=info.length, offset=offset).copy()
    return array.reshape(-1, info.columns) if entry.matrix else array


class Dictionary:
    """All variables of one load, by name.

    Parameters
    ----------
    initial : ndarray of uint8
        Values as UserInit left them, laid out as a snapshot.
    """

    def __init__(self, control: Any, initial: npt.NDArray[np.uint8]) -> None:
        self.entries: dict[str, Entry] = {}
        info = control.info
        self._joints = tuple(text_of(info.joint[j].unit) for j in range(info.joints))
        for index in range(control.variables):
            entry = self._entry(control.variable[index], index, initial)
            self.entries[entry.info.name] = entry
        self._places: dict[str, Place] = {
            name: Place(entry) for name, entry in self.entries.items()
        }

    def _entry(self, raw: Any, index: int, initial: npt.NDArray[np.uint8]) -> Entry:
        type_name, dtype = _TYPES[raw.type]
        kind = _KINDS[raw.kind]
        table = kind == VariableKind.TABLE
        start: Value
        if table:
            start = np.zeros((0, raw.columns))
        else:
            array = initial[raw.snapshot : raw.snapshot + raw.size].view(dtype)
            start = array.copy() if raw.length > 1 else array[0].item()
            if raw.columns > 1:
                start = array.reshape(-1, raw.columns).copy()
        unit = on_one_line(text_of(raw.unit))
        info = VariableInfo(
            name=text_of(raw.name),
            type=type_name,
            length=raw.length * (raw.columns if table else 1),
            kind=kind,
            unit=joint_units(unit, self._joints, 0 if table else raw.length),
            minimum=raw.minimum,
            maximum=raw.maximum,
            initial=start,
            description=on_one_line(text_of(raw.text)),
            address=raw.address,
            columns=raw.columns,
        )
        return Entry(info, index, dtype, raw.snapshot, raw.size, (raw.bank[0], raw.bank[1]))

    def infos(self, *kinds: VariableKind) -> tuple[VariableInfo, ...]:
        """Variables of the given kinds, in the order of declaration."""
        return tuple(entry.info for entry in self.entries.values() if entry.info.kind in kinds)

    def place(self, name: str, others: int = 0) -> Place:
        """The variable (``"Kp"``) or element (``"q[0]"``; of a matrix ``"K[1,2]"``, or one index
        that counts row after row) of a name.

        Parameters
        ----------
        others : int
            Names of the same request that are wrong: what the first of them may have meant is told.

        Raises
        ------
        VariableError
            No such name, or no such element.
        """
        found = self._places.get(name)
        if found is not None:
            return found
        match = _ELEMENT.match(name)
        entry = self.entries.get(match["name"]) if match else None
        if match is None or entry is None:
            meant = f"; {self._nearest(name)}" if others < HINTS else ""
            raise VariableError(f"{name}: no such variable{meant}")
        index, column = int(match["index"]), match["column"]
        known = index < entry.info.length
        if column is not None:
            columns = entry.info.columns
            known = entry.matrix and index < entry.rows and int(column) < columns
            index = index * columns + int(column)
        if entry.info.kind == VariableKind.TABLE or not known:
            what = (
                "is a table, which is read and written whole"
                if entry.info.kind == VariableKind.TABLE
                else f"has {entry.words}"
            )
            raise VariableError(f"{name}: {entry.info.name} {what}")
        self._places[name] = Place(entry, index, index * entry.dtype.itemsize)
        return self._places[name]

    def _nearest(self, name: str) -> str:
        names = [n for n, e in self.entries.items() if e.info.kind != VariableKind.SETTING]
        close = nearest(name, names, 3, 0.5)
        meant = f"did you mean {' or '.join(close)}? The" if close else "the"
        counts = [
            (kind, sum(e.info.kind == kind for e in self.entries.values()))
            for kind in (VariableKind.PARAMETER, VariableKind.SIGNAL, VariableKind.TABLE)
        ]
        declared = (
            ", ".join(f"{n} {kind}{'' if n == 1 else 's'}" for kind, n in counts if n) or "none"
        )
        return f"{meant} program declares {declared}: 'zendsp info' or variables() lists them"


def decode(places: Mapping[str, Place], values: npt.NDArray[np.uint8]) -> dict[str, Value]:
    """Values of variables from one snapshot.

    Parameters
    ----------
    places : mapping of name to Place
        No tables.
    values : ndarray of uint8, shape (snapshot bytes,)

    Returns
    -------
    dict of name to value
        Scalars as Python numbers, arrays as copies.
    """
    raw = values.tobytes()
    return {
        name: value_of(place.entry, place.scalar, raw, place.entry.offset + place.offset)
        for name, place in places.items()
    }
