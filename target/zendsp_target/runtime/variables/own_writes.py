"""Parameters that the program itself sets: values that a host writes to them do not last, and their
limits do not hold.

They are found from outside the loop, which copies all values in any case.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from zendsp_protocol.states import VariableKind
from zendsp_target.runtime.variables.dictionary import Dictionary, Entry, value_of

_ELEMENTS = 64  # larger arrays are not looked at
_TOLD = 8  # sentences at most: they travel with every status


class OwnWrites:
    """Finds the parameters that changed between two snapshots though no host wrote them.

    Parameters
    ----------
    values : ndarray of uint8
        As UserInit left them, laid out as a snapshot.
    """

    def __init__(self, dictionary: Dictionary, values: npt.NDArray[np.uint8]) -> None:
        self._entries = [
            entry
            for entry in dictionary.entries.values()
            if entry.info.kind == VariableKind.PARAMETER and entry.info.length <= _ELEMENTS
        ]
        self._last = [_bytes(entry, values) for entry in self._entries]
        self._found: dict[str, str] = {}

    def told(self) -> tuple[str, ...]:
        """A sentence for each such parameter."""
        return tuple(self._found.values())

    def look(self, values: npt.NDArray[np.uint8], written: Mapping[int, bytes | None]) -> None:
        """Compare a snapshot with the one before.

        Parameters
        ----------
        values : ndarray of uint8
        written : mapping of int to bytes or None
            Variables that were written from outside since, or may have been, and to what.
        """
        for number, entry in enumerate(self._entries):
            now, before = _bytes(entry, values), self._last[number]
            self._last[number] = now
            given = written.get(entry.index, before)
            if given is not None and now != given:
                self._tell(entry, now)

    def _tell(self, entry: Entry, now: bytes) -> None:
        info = entry.info
        value = value_of(entry, info.length == 1, now, 0)
        numbers = np.asarray(value, np.float64)
        # NaN is within nothing
        past = not bool(np.all((numbers >= info.minimum) & (numbers <= info.maximum)))
        told = self._found.get(info.name)
        if (told is None and len(self._found) < _TOLD) or (told and past and "limits" not in told):
            self._found[info.name] = f"{info.name}: the program itself sets it" + (
                f", past its limits of {info.minimum:g} and {info.maximum:g}"
                f" ({np.array2string(numbers, precision=6, threshold=4)})"
                if past
                else ", so that what a host writes may not last"
            )


def _bytes(entry: Entry, values: npt.NDArray[np.uint8]) -> bytes:
    return values[entry.offset : entry.offset + entry.size].tobytes()
