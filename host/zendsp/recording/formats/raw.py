"""The contents of a file before its columns are interpreted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.names import FloatArray

MEMORY = Path("/proc/meminfo")
COMPLEX = "holds complex numbers: save its real part, real(x) in MATLAB"
Share = Callable[[float], None]  # takes the share of a file that is read, up to 1
SHARE = 0.5  # of the free memory that one file may take: what is made of it takes as much again


def upright(values: FloatArray) -> FloatArray:
    """The values with a row or column vector of MATLAB as one dimension, and a matrix that is wider
    than high turned to samples by rows.
    """
    if values.ndim == 2 and 1 in values.shape:
        return values.reshape(-1)
    if values.ndim == 2 and values.shape[1] > values.shape[0]:
        return np.ascontiguousarray(values.T)
    return values


@dataclass(frozen=True)
class Raw:
    """Named arrays as they are in the file.

    ``columns`` may still differ in length. ``metadata`` is the JSON text that zendsp writes beside
    its own data, empty for other files. ``refused`` names contents that are no numbers, with the
    reason. ``notes`` say what the reader did to the numbers.
    """

    columns: dict[str, FloatArray]
    units: dict[str, str] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)
    metadata: str = ""
    refused: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def sort(self, name: str, values: Any) -> None:
        """Keep an array as a column or a constant, or note why it is neither."""
        if values.dtype.kind == "c":
            self.refused[name] = COMPLEX
        elif values.dtype.kind not in "fiub":
            self.refused[name] = "holds text or other things than numbers"
        elif values.size == 0:
            self.refused[name] = "is empty"
        elif values.size == 1:
            self.constants[name] = float(values.reshape(-1)[0])
        elif values.ndim > 2:
            self.refused[name] = f"has {values.ndim} dimensions; at most 2 can be columns"
        else:
            self.columns[name] = np.asarray(values, dtype=np.float64)


def check_room(path: Path, size: int) -> None:
    """Refuse a file that claims to hold more than fits into memory; a few bytes can claim that.

    Parameters
    ----------
    path : Path
        For the message.
    size : int
        Of the arrays, bytes.

    Raises
    ------
    RecordingError
    """
    try:
        facts = dict(line.split(":", 1) for line in MEMORY.read_text().splitlines())
        free = int(facts["MemAvailable"].split()[0]) * 1024
    except (OSError, LookupError, ValueError):
        return
    if size > SHARE * free:
        raise RecordingError(
            f"{path}: says that it holds {size / 1e9:.1f} GB of numbers; this computer has"
            f" {free / 1e9:.1f} GB of memory free, and a file may take half of it. It is damaged,"
            " or needs to be cut into parts"
        )
