"""HDF5 from any program: every one- or two-dimensional dataset of numbers is a column; units are in
its attributes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.raw import Raw, check_room

UNITS = ("units", "unit", "Units", "Unit")
ELSEWHERE = "stands in another file"


def read(path: Path) -> Raw:
    """Read a file; groups become parts of names: ``/run/q`` is ``run.q``, or ``q`` where no other
    group has one.
    """
    h5py = need("h5py", "hdf5", "an HDF5 file", RecordingError)
    found = Raw({})
    total = 0

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            found.refused.update(
                {f"{name}/{n}".lstrip("/"): ELSEWHERE for n in item if leads_out(h5py, item, n)}
            )
            return
        if name in found.refused:
            return
        nonlocal total
        total += item.nbytes
        check_room(path, total)
        unit = next((_text(item.attrs[key]) for key in UNITS if key in item.attrs), "")
        values = item[()]
        if isinstance(values, np.ndarray) and values.dtype.names:  # a table of PyTables or pandas
            for field in values.dtype.names:
                found.sort(f"{name}/{field}", values[field])
        else:
            found.sort(name, np.asarray(values))
            found.units[name] = unit

    with h5py.File(path, "r") as file:
        visit("", file)
        file.visititems(visit)
    short = _short(list(found.columns))
    return Raw(
        {short[n]: v for n, v in found.columns.items()},
        {short[n]: found.units.get(n, "") for n in found.columns},
        {n.replace("/", "."): v for n, v in found.constants.items()},
        "",
        {n.replace("/", "."): why for n, why in found.refused.items()},
    )


def leads_out(h5py: Any, group: Any, name: str) -> bool:
    """Whether a name links to another file, which could be any file of the user who reads it."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        return isinstance(link, h5py.ExternalLink)
    item = group[name]
    return isinstance(item, h5py.Dataset) and bool(item.external or item.is_virtual)


def _text(value: Any) -> str:
    value = np.asarray(value).reshape(-1)
    first = value[0] if len(value) else ""
    return first.decode(errors="replace") if isinstance(first, bytes) else str(first)


def _short(names: list[str]) -> dict[str, str]:
    last = [name.rpartition("/")[2] for name in names]
    return {
        name: own if last.count(own) == 1 else name.replace("/", ".")
        for name, own in zip(names, last, strict=True)
    }
