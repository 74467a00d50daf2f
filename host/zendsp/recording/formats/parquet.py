"""Parquet: one float64 column per element; units and metadata in the schema."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.raw import Raw

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

KEY = b"zendsp"
UNITS = b"zendsp_units"


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording``."""
    pyarrow = _pyarrow()

    units = dict(zip(recording.columns, recording.column_units, strict=True)) | {"t": "s"}
    names = ["t", *recording.columns]
    arrays = [recording.t, *(np.ascontiguousarray(column) for column in recording.data.T)]
    kept = {KEY: metadata.encode(), UNITS: json.dumps(units).encode()}
    table = pyarrow.Table.from_arrays(
        [pyarrow.array(a) for a in arrays], names=names
    ).replace_schema_metadata(kept)
    pyarrow.parquet.write_table(table, path, compression="zstd")


def read(path: Path) -> Raw:
    """Read any Parquet file; null becomes NaN, lists of equal length become vectors, durations
    become seconds, time stamps seconds since the first.
    """
    pyarrow = _pyarrow()

    try:
        table = pyarrow.parquet.ParquetFile(path).read()
        metadata = table.schema.metadata or {}
        units = json.loads(metadata.get(UNITS, b"{}"))
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise RecordingError(
            f"{path}: is not a readable Parquet file, or it is cut short ({error})"
        ) from error
    columns, refused, notes = {}, {}, []
    for name, column in zip(table.column_names, table.columns, strict=True):
        try:
            if pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type):
                columns[name] = np.array(column.to_pylist(), dtype=np.float64)
            elif pyarrow.types.is_boolean(column.type) or _is_number(column.type):
                columns[name] = _numbers(column.cast(pyarrow.float64()))
            elif pyarrow.types.is_duration(column.type):  # a timedelta of pandas
                ns = column.cast(pyarrow.duration("ns")).cast(pyarrow.int64())
                columns[name], units[name] = 1e-9 * _numbers(ns.cast(pyarrow.float64())), "s"
            elif pyarrow.types.is_timestamp(column.type) and len(column):
                stamps = column.cast(pyarrow.timestamp("ns", column.type.tz)).cast(pyarrow.int64())
                ns = np.array(stamps.to_pylist())
                columns[name], units[name] = (ns - ns[0]) * 1e-9, "s"
                notes.append(f"{name}: seconds since {np.datetime64(int(ns[0]), 'ns')}")
            else:
                refused[name] = f"holds {column.type}, not numbers"
        except (pyarrow.ArrowException, ValueError, TypeError) as error:
            refused[name] = f"cannot be read as numbers ({error})"
    return Raw(columns, units, {}, metadata.get(KEY, b"").decode(), refused, tuple(notes))


def _numbers(column: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The values of a column. (pyarrow's own to_numpy would import pandas, which takes half a
    second.)
    """
    if column.null_count or not len(column):
        return np.asarray(column.to_numpy())
    values = column.combine_chunks()
    end = values.offset + len(values)
    return np.frombuffer(values.buffers()[1], np.float64, end)[values.offset :]


def _is_number(kind: object) -> bool:
    pyarrow = _pyarrow()

    types = pyarrow.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _pyarrow() -> Any:
    need("pyarrow.parquet", "parquet", "a Parquet file", RecordingError)
    return need("pyarrow", "parquet", "a Parquet file", RecordingError)
