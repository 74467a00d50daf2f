"""MDF of ASAM (``.mf4``, ``.mdf``): channels with units, each group with its clock."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import installed, need
from zendsp.recording.formats.apart import read_apart
from zendsp.recording.formats.clocks import Series, on_one_clock
from zendsp.recording.formats.raw import Raw

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

ATTACHED = "zendsp.json"  # the metadata of a recording

MARK = "zendsp"  # comment of the group of a recording


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording`` as MDF 4.10: one group of doubles, the metadata attached."""
    asammdf = library()
    signals = [
        asammdf.Signal(np.ascontiguousarray(values), recording.t, unit=unit, name=name)
        for name, unit, values in zip(
            recording.columns, recording.column_units, recording.data.T, strict=True
        )
    ]
    buffer = io.BytesIO()
    with asammdf.MDF(version="4.10") as file:
        file.append(signals, comment=MARK, common_timebase=True)
        file.attach(metadata.encode(), file_name=ATTACHED, mime="application/json")
        file.save(buffer)
    path.write_bytes(buffer.getvalue())


def read(path: Path) -> Raw:
    """Read a file of version 2 to 4; conversions to physical values are applied."""
    if not installed("asammdf"):  # loading it takes a second: that is for who reads
        library()
    return read_apart(__name__, path)  # its native code reads where a damaged file says, and dies


def parse(path: Path) -> Raw:
    """The same as `read`, within this process."""
    asammdf = library()
    with asammdf.MDF(path) as file:
        attached = _attached(file)
        found: list[Series] = []
        refused: dict[str, str] = {}
        for index, group in enumerate(file.groups):
            found += _group(file, index, group, refused)
        if not attached and any(
            group.channel_group.comment == MARK
            for group in file.groups
            if hasattr(group.channel_group, "comment")
        ):
            raise RecordingError(
                f"{path}: is damaged: it was written by zendsp, and its description is gone. Take"
                " another copy"
            )
        if not attached:
            return on_one_clock(path, found, refused, prefix=False)
    (own,) = found
    return Raw({"t": own.t, **own.columns}, {"t": "s", **own.units}, {}, attached)


def _attached(file: Any) -> str:
    if not file.version.startswith("4"):
        return ""
    for index, block in enumerate(file.attachments):
        if Path(str(block.file_name)).name == ATTACHED:
            data = file.extract_attachment(index)[0]
            return data if isinstance(data, str) else bytes(data).decode()
    return ""


def _group(file: Any, index: int, group: Any, refused: dict[str, str]) -> list[Series]:
    """The channels of a group; NaN where a sample is marked invalid."""
    master = file.masters_db.get(index)
    columns, units = {}, {}
    t = None
    for number, channel in enumerate(group.channels):
        if number == master:
            continue
        if master is None:
            refused[channel.name] = "belongs to a group without a clock"
            continue
        signal = file.get(group=index, index=number, ignore_invalidation_bits=True)
        if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
            refused[channel.name] = "holds no plain numbers"
            continue
        values = signal.samples.astype(np.float64)
        if signal.invalidation_bits is not None:
            values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
        t = signal.timestamps
        columns[channel.name], units[channel.name] = values, str(signal.unit or "")
    name = (
        str(group.channel_group.acq_name or f"group{index}")
        if hasattr(group.channel_group, "acq_name")
        else f"group{index}"
    )
    return [] if t is None else [Series(name, np.asarray(t, dtype=np.float64), columns, units)]


def library() -> Any:
    """The library asammdf; where it is missing, an error that says what to install."""
    return need("asammdf", "files", "an MDF file", RecordingError)
