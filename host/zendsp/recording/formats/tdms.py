"""TDMS of LabVIEW: channels with the unit and the clock that their properties state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.clocks import Series, on_one_clock
from zendsp.recording.formats.raw import Raw
from zendsp.recording.names import FloatArray
from zendsp.recording.roles import Role, role_of
from zendsp.recording.units import in_si


def read(path: Path) -> Raw:
    """Read a file. Channels without a clock of their own belong to the time channel of their group.
    """
    nptdms = need("nptdms", "files", "a TDMS file", RecordingError)
    found: list[Series] = []
    refused: dict[str, str] = {}
    with nptdms.TdmsFile.read(path) as file:
        if file.file_status.incomplete_final_segment:
            raise RecordingError(f"{path}: is cut short: its last segment is not complete")
        for group in file.groups():
            found += _group(path, group, refused)
    return on_one_clock(path, found, refused, prefix=False)


def _group(path: Path, group: Any, refused: dict[str, str]) -> list[Series]:
    clocked: dict[tuple[Any, ...], Series] = {}
    plain: dict[str, Any] = {}
    units: dict[str, str] = {}
    for channel in group.channels():
        values = np.asarray(channel[:])
        units[channel.name] = str(channel.properties.get("unit_string", ""))
        if values.dtype.kind == "M":  # a time stamp each row
            if len(values):
                plain[channel.name] = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
                units[channel.name] = "s"
        elif values.dtype.kind not in "fiub":
            refused[channel.name] = "holds no numbers"
        elif (step := channel.properties.get("wf_increment")) and len(values):
            start = float(channel.properties.get("wf_start_offset", 0.0))
            key = (len(values), float(step), start)
            if key not in clocked:
                name = group.name if not clocked else f"{group.name}_{len(clocked)}"
                t: FloatArray = start + np.arange(len(values), dtype=np.float64) * float(step)
                clocked[key] = Series(name, t, {}, units)
            clocked[key].columns[channel.name] = values.astype(np.float64)
        elif len(values):
            plain[channel.name] = values.astype(np.float64)
    series = list(clocked.values())
    clock = next((n for n in plain if role_of(n, units[n]) is Role.TIME), None)
    if clock is not None:
        t = in_si({clock: plain.pop(clock)}, units)[0][clock]
        for name in [n for n in plain if len(plain[n]) != len(t)]:
            refused[name] = (
                f"has {len(plain.pop(name))} rows where the time channel {clock!r} has {len(t)}"
            )
        series.append(Series(group.name, t, plain, units))
    elif plain and not series:
        raise RecordingError(
            f"{path}: the channels of group {group.name!r} have no clock (property wf_increment, or"
            " a channel named time)"
        )
    else:
        refused |= dict.fromkeys(plain, "has no clock")
    return series
