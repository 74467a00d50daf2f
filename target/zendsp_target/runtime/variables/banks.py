"""The two banks of a table: the loop reads one, and a download fills the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from zendsp_protocol.values import Value
from zendsp_target.runtime.variables.dictionary import Place
from zendsp_target.runtime.variables.values import FloatArray


class Banks:
    """The tables of one load; for one caller at a time.

    Parameters
    ----------
    control : cffi struct control
    memory : mmap
        Of the data file.
    """

    def __init__(self, control: Any, memory: Any) -> None:
        self._control = control
        self._memory = np.frombuffer(memory, dtype=np.uint8)
        self._newest: dict[int, int] = {}  # bank that a table's newest update names, by variable

    def rows(self, place: Place) -> Value:
        """The rows of a table that are in use. They are whole unless a bank is being filled
        meanwhile.
        """
        entry = place.entry
        word = int(self._control.variable[entry.index].table)
        rows, columns = min(word & 0xFFFFFFFF, entry.rows), entry.info.columns
        start = entry.banks[word >> 32 & 1]
        found = self._memory[start : start + rows * columns * 8].copy()
        return found.view("<f8").reshape(rows, columns)

    def fill(self, place: Place, rows: FloatArray) -> tuple[int, int]:
        """Write a table into the bank that the loop does not read; return the bank and the number
        of rows.
        """
        index = place.entry.index
        word = int(self._control.variable[index].table)
        known = word or index in self._newest
        bank = 1 - self._newest.get(index, word >> 32 & 1) if known else 0
        start = place.entry.banks[bank]
        self._memory[start : start + rows.nbytes] = rows.reshape(-1).view(np.uint8)
        self._newest[index] = bank
        return bank, rows.shape[0]

    def forget(self, index: int) -> None:
        """Free the bank of an update that was cancelled."""
        self._newest.pop(index, None)
