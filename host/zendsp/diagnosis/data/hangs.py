"""A sensor that hangs: one reading row after row while the joint moves on, then a jump."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.columns import cutting
from zendsp.diagnosis.data.signals import Signals
from zendsp_protocol.texts import counted, enumerated

Array = npt.NDArray[np.float64]

# Chosen, not measured: they only word a refusal, which is caused by a jump (checks.py).
HUNG_ROWS = 5  # least rows of one reading
SPEED_ROWS = 3  # before them, to measure the speed
STOPS_COUNTS = 2.0  # counts a row: a joint this fast does not stop in the next row
STOPS_USUAL = 3.0  # times the usual change of speed from row to row: nor does a joint this fast
USUAL = 0.98  # quantile used as usual
JUMPED = 3.0  # times that speed, and as many counts: a larger jump shows that the joint moved on
JUMPED_COUNTS = 6.0


@dataclass(frozen=True)
class Hang:
    """Rows of one reading: the first of them, from 0, how many, and the jump after the last."""

    first: int
    rows: int
    jump: float


def hangs(y: Array, resolution: float) -> list[Hang]:
    """The hangs of a position: it stops from one row to the next and catches up in a jump.

    Of two glued runs, the first one slows down before it ends.
    """
    new = np.flatnonzero(np.diff(y) != 0) + 1
    first, end = np.r_[0, new], np.r_[new, len(y)]
    within = (end - first >= HUNG_ROWS) & (first >= SPEED_ROWS) & (end < len(y))
    first, end = first[within], end[within]
    speed = np.abs(y[first] - y[first - SPEED_ROWS]) / SPEED_ROWS
    jump = y[np.minimum(end, len(y) - 1)] - y[first]
    changes = float(np.quantile(np.abs(np.diff(y, 2)), USUAL))
    moved = speed > max(STOPS_COUNTS * resolution, STOPS_USUAL * max(changes - resolution, 0.0))
    on = np.abs(jump) > np.maximum(JUMPED * speed, JUMPED_COUNTS * resolution)
    return [
        Hang(int(k), int(n), float(by))
        for k, n, by in zip(
            first[moved & on], (end - first)[moved & on], jump[moved & on], strict=True
        )
    ]


@dataclass(frozen=True)
class Hung:
    """The hangs of one position of a recording."""

    where: str  # recording and joint, as a refusal names them
    signals: Signals
    hangs: tuple[Hang, ...]


def hung(found: Sequence[Hung], least: float) -> str:
    """A sentence on sensors that hung: where, for how long, and the commands that cut all of it
    out, one for each recording. Parts shorter than ``least`` seconds are dropped too.
    """
    said = "; ".join(f"{h.where}: {_stood(h)}" for h in found)
    ranges: dict[str, list[str]] = {}
    for h in found:
        ranges.setdefault(h.signals.name, []).extend(_ranges(h))
    cut = enumerated(
        cutting(name, "--without", ",".join(each), "-o", f"{Path(name).stem}-part.csv")
        for name, each in ranges.items()
    )
    return (
        f"{said}: the sensor hung, or was not read. Take these rows out: {cut}"
        f" make{'s' * (len(ranges) == 1)} a file of each part between them; give those that last"
        f" {least:g} s and more"
    )


def _stood(h: Hung) -> str:
    t = h.signals.time - h.signals.time[0]
    each = [
        f"for {counted(hang.rows, 'row')} from row {hang.first + 1}"
        f" (t = {_seconds(float(t[hang.first]))} s) and jumped by {hang.jump:.4g}"
        for hang in h.hangs
    ]
    return f"the position stood still, while the joint moved, {', '.join(each)}"


def _ranges(h: Hung) -> list[str]:
    """The time ranges to leave out; they begin half a row after the first row, whose reading was
    true.
    """
    t = h.signals.time - h.signals.time[0]
    half = 0.5 * (t[1:] + t[:-1])
    return [
        f"{_seconds(float(half[hang.first]))}:{_seconds(float(half[hang.first + hang.rows - 1]))}"
        for hang in h.hangs
    ]


def _seconds(time: float) -> str:
    """Seconds in words, to a tenth of a microsecond, which is finer than any row."""
    return f"{time:.7f}".rstrip("0").rstrip(".")
