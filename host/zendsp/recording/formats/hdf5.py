"""HDF5 of any origin: every one- or two-dimensional set of numbers is a column; units stand in its
attributes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zendsp.recording.formats.raw import Raw
from zendsp.recording.names import FloatArray

UNITS = ("units", "unit", "Units", "Unit")


def read(path: Path) -> Raw:
    """Read a file; groups become parts of names: ``/run/q`` is ``run.q``, or ``q`` where no other
    group has one.
    """
    import h5py

    columns: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    constants: dict[str, float] = {}
    refused: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        unit = next((_text(item.attrs[key]) for key in UNITS if key in item.attrs), "")
        values = item[()]
        if isinstance(values, np.ndarray) and values.dtype.names:  # a table of PyTables or pandas
            for field in values.dtype.names:
                _sort(f"{name}/{field}", values[field], "", columns, units, constants, refused)
        else:
            _sort(name, np.asarray(values), unit, columns, units, constants, refused)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    short = _short(list(columns))
    return Raw(
        {short[n]: v for n, v in columns.items()},
        {short[n]: u for n, u in units.items()},
        {n.replace("/", "."): v for n, v in constants.items()},
        "",
        {n.replace("/", "."): why for n, why in refused.items()},
    )


def _sort(
    name: str, values: Any, unit: str, columns: dict[str, FloatArray], units: dict[str, str],
    constants: dict[str, float], refused: dict[str, str],
) -> None:  # fmt: skip
    if values.dtype.kind not in "fiub":
        refused[name] = "holds text or other things than numbers"
    elif values.size == 0:
        refused[name] = "is empty"
    elif values.size == 1:
        constants[name] = float(values.reshape(-1)[0])
    elif values.ndim > 2:
        refused[name] = f"has {values.ndim} dimensions; at most 2 can be columns"
    else:
        columns[name], units[name] = np.asarray(values, dtype=np.float64), unit


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
