"""Plain tables of numbers from files that anyone may have written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats import Raw
from zendsp.recording.names import FloatArray, gather_vectors, listing, pick, split_unit

SUFFIXES = (".csv", ".txt", ".csv.gz", ".mat", ".npz", ".parquet")


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length, as a file gives them.

    Attributes
    ----------
    columns : mapping of name to ndarray, shape (N,) or (N, m), float64
        Gaps in the file are NaN.
    units : mapping of name to str
        Empty where the file states none.
    constants : mapping of name to float
        Numbers that stand beside the columns (a MAT file's ``kp``, ``dt``, …).
    path : Path
        Where it came from.
    """

    columns: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    path: Path = Path()

    def __getitem__(self, name: str) -> FloatArray:
        """Return a column; ``"q[1]"`` is one column of a vector, ``"q1 [rad]"`` is ``"q1"``.

        Raises
        ------
        RecordingError
            No such column; the message names the file and lists the columns there are.
        """
        values = pick(self.columns, name)
        if values is None:
            values = pick(self.columns, split_unit(name)[0])
        if values is None:
            raise RecordingError(f"{self.path}: has no column {name!r}; it has {listing(list(self.columns))}")
        return values

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (
            pick(self.columns, name) is not None or pick(self.columns, split_unit(name)[0]) is not None
        )

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def read_table(path: str | Path, columns: Sequence[str] | None = None) -> Table:
    """Read a table of numbers: ``.csv``, ``.mat`` (v5, v7.3), ``.npz`` or ``.parquet``, zendsp's own or foreign.

    Parameters
    ----------
    path : path
        Any of :data:`SUFFIXES`.
    columns : sequence of str, optional
        Read and check these only; the others may then be of any length or kind.

    Returns
    -------
    Table
        Vectors may come as columns ``q[0], q[1]`` or as one array; both become one ``(N, m)`` column ``q``.

    Raises
    ------
    RecordingError
        Naming the file, the column, and what was expected: missing or damaged file, no numbers, unequal lengths.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> file = pathlib.Path(tempfile.mkdtemp(), "run.csv")
    >>> _ = file.write_text("t [s],q [rad]\\n0,1\\n0.1,2\\n")
    >>> table = read_table(file)
    >>> table["q"], table.units["q"]
    (array([1., 2.]), 'rad')
    """
    path = Path(path)
    return _checked(path, read_raw(path), columns)


def read_raw(path: Path) -> Raw:
    """Read a file by its suffix, without deciding what it means."""
    suffix = "".join(path.suffixes[-2:]).lower() if path.suffix == ".gz" else path.suffix.lower()
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; give a file ({', '.join(SUFFIXES)})")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: is empty (0 bytes)")
    if suffix in (".csv", ".txt", ".csv.gz"):
        from zendsp.recording.formats import csv as reader
    elif suffix == ".mat":
        from zendsp.recording.formats import mat as reader  # type: ignore[no-redef]
    elif suffix == ".npz":
        from zendsp.recording.formats import npz as reader  # type: ignore[no-redef]
    elif suffix == ".parquet":
        from zendsp.recording.formats import parquet as reader  # type: ignore[no-redef]
    else:
        raise RecordingError(
            f"{path}: unknown kind of file {suffix or path.name!r}; expected {', '.join(SUFFIXES)}"
        )
    return reader.read(path)


def _checked(path: Path, raw: Raw, wanted: Sequence[str] | None) -> Table:
    if wanted is not None:
        for name in wanted:
            bare = split_unit(name)[0]
            if bare in raw.refused:
                raise RecordingError(f"{path}: column {name!r} {raw.refused[bare]}")
    columns = {name: _upright(values) for name, values in raw.columns.items()}
    joined, units = gather_vectors(columns, raw.units) if _equal(columns) else (columns, dict(raw.units))
    table = Table(joined, units, raw.constants, path)
    if wanted is not None:
        chosen = {name: table[name] for name in wanted}
        return Table(_same_length(path, chosen), {n: _unit(units, n) for n in chosen}, raw.constants, path)
    if not joined:
        why = "; ".join(f"{name} {reason}" for name, reason in list(raw.refused.items())[:3])
        raise RecordingError(f"{path}: holds no column of numbers{f' ({why})' if why else ''}")
    return Table(_same_length(path, joined), units, raw.constants, path)


def _unit(units: Mapping[str, str], name: str) -> str:
    return units.get(name) or units.get(split_unit(name)[0]) or units.get(name.partition("[")[0], "")


def _upright(values: FloatArray) -> FloatArray:
    """Turn a row or column vector of MATLAB into one dimension, and a wide matrix on its side into samples by rows."""
    if values.ndim == 2 and 1 in values.shape:
        return values.reshape(-1)
    if values.ndim == 2 and values.shape[1] > values.shape[0]:
        return np.ascontiguousarray(values.T)
    return values


def _equal(columns: Mapping[str, FloatArray]) -> bool:
    return len({len(values) for values in columns.values()}) <= 1


def _same_length(path: Path, columns: Mapping[str, FloatArray]) -> Mapping[str, FloatArray]:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        longest = max(lengths, key=lambda name: lengths[name])
        other = next(name for name in lengths if lengths[name] != lengths[longest])
        raise RecordingError(
            f"{path}: columns differ in length: {longest!r} has {lengths[longest]} rows, {other!r} has {lengths[other]}; "
            "every column needs one value per sample"
        )
    return columns
