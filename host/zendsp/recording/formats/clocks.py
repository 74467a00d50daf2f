"""Puts series that have clocks of their own on one clock: that of the positions. The other series
are held at their newest value.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.raw import Raw
from zendsp.recording.names import FloatArray
from zendsp.recording.roles import Role, role_of
from zendsp_protocol.texts import counted

# of the rows of the clock: a series with so many bounds the time that is read; others are held over
# it
WEIGHTY = 0.1


@dataclass(frozen=True)
class Series:
    """Columns that were sampled together.

    ``t`` is in s on a clock that all series of a file share; each column is ``(N,)``.
    """

    name: str
    t: FloatArray
    columns: dict[str, FloatArray]
    units: dict[str, str] = field(default_factory=dict)


def on_one_clock(
    path: Path, found: list[Series], refused: dict[str, str] | None = None, *, prefix: bool
) -> Raw:
    """One table of all series.

    Its rows are those of the series with positions, or of the longest where none has any. For the
    other series each row takes the newest value, as a machine holds its command. Rows before the
    first or after the last value of any series but short ones are left out.

    Parameters
    ----------
    path : Path
        Named in errors.
    refused : dict
        What is in the file but is no number, and why.
    prefix : bool
        Whether columns are named ``series.column`` even where the column's own name would do.
    """
    found = [s for s in found if len(s.t) > 1 and s.columns]
    refused = refused or {}
    if not found:
        why = "; ".join(f"{name} {reason}" for name, reason in list(refused.items())[:3])
        raise RecordingError(
            f"{path}: holds no series of numbers over time{f' ({why})' if why else ''}"
        )
    names = _names(found, prefix)
    master = max(found, key=lambda s: (_positions(s), len(s.t)))
    heavy = [s for s in found if len(s.t) >= WEIGHTY * len(master.t)]
    first = max(float(s.t[0]) for s in heavy)
    last = min(float(s.t[-1]) + 2 * float(np.median(np.diff(s.t))) for s in heavy)
    kept = (master.t >= first) & (master.t <= last)
    t = master.t[kept]
    if len(t) < 2:
        raise RecordingError(f"{path}: its series do not overlap in time: " + ", ".join(
            f"{s.name} from {s.t[0]:.6g} to {s.t[-1]:.6g} s" for s in heavy[:4]
        ))  # fmt: skip
    columns: dict[str, FloatArray] = {"t": t - t[0]}
    units = {"t": "s"}
    for series in found:
        row = np.searchsorted(series.t, t, side="right") - 1
        for name, values in series.columns.items():
            whole = names[series.name, name]
            columns[whole] = (
                values[kept]
                if series is master
                else np.where(row >= 0, values[np.maximum(row, 0)], np.nan)
            )
            units[whole] = series.units.get(name, "")
    notes: list[str] = []
    if len(found) > 1:
        others = ", ".join(s.name for s in found if s is not master)
        notes.append(
            f"{path.name}: rows are those of {master.name}; the newest value is held of {others}"
        )
    if (left := len(master.t) - len(t)) > 0:
        rows = counted(left, "row")
        notes.append(f"{path.name}: {rows} left out in which not everything was recorded")
    return Raw(columns, units, {}, "", refused, tuple(notes))


def _positions(series: Series) -> int:
    return sum(
        role_of(name, series.units.get(name, "")) is Role.POSITION for name in series.columns
    )


def _names(found: list[Series], prefix: bool) -> dict[tuple[str, str], str]:
    """Names of the columns: their own where no other series has it, else with the name of the
    series before it.
    """
    every = [name for s in found for name in s.columns]
    names = {}
    for s in found:
        for name in s.columns:
            alone = not prefix and every.count(name) == 1 and name != "t"
            names[s.name, name] = name if alone else re.sub(r"^/+", "", f"{s.name}.{name}")
    return names
