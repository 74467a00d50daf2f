"""Saves and loads recordings; in every format the metadata are one JSON text."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats import Raw
from zendsp.recording.formats.raw import upright
from zendsp.recording.names import gather_vectors, listing
from zendsp.recording.notes import Extra
from zendsp.recording.own import CHECK, FORM, bad_description, checked, checksum
from zendsp.recording.roles import Role, role_of
from zendsp.recording.samples import ParameterChange, Samples
from zendsp.recording.table import READERS, read_raw
from zendsp.recording.units import in_si

Kind = TypeVar("Kind", bound=Samples)

WRITERS = (".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4")
FIELDS = (
    "sample_time", "start_tick", "decimation", "trigger_row", "lost", "timing", "parameters",
    "sources", "compiler", "flags", "machine", "target", "versions", "created", "note", "extra",
)
TIMES = ("t", "time", "Time", "T")


def save(recording: Samples, path: Path) -> Path:
    """See `Recording.save`."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    writer = _writer(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writer(recording, metadata(recording), temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):  # nothing is there where the folder is none
            temporary.unlink(missing_ok=True)
    return path


def save_anyhow(recording: Samples, path: Path) -> tuple[Path, str]:
    """Save a recording, which cannot be made again; in another folder where it cannot be saved in
    the given one.

    Parameters
    ----------
    path : path
        Where it is meant to be.

    Returns
    -------
    path
        Where it is.
    str
        What was the matter and where it is instead, for people; empty where it is at `path`.

    Raises
    ------
    RecordingError
        It cannot be written anywhere.
    """
    try:
        return save(recording, path), ""
    except RecordingError as error:
        elsewhere = rescue(recording, path.name)
        if elsewhere is None:
            raise
        return elsewhere, f"{error}; it is in {elsewhere} instead"


def rescue(recording: Samples, name: str) -> Path | None:
    """Save a recording in a new folder for temporary files; return its path, None where that failed
    too.
    """
    with suppress(RecordingError, OSError):
        return save(recording, Path(tempfile.mkdtemp(prefix="zendsp-")) / name)
    return None


def check_suffix(path: str | Path) -> None:
    """Refuse a file name under which no recording can be saved, before there is one.

    Raises
    ------
    RecordingError
        Its suffix is none of :data:`WRITERS`, or what writes it is not installed.
    """
    path = Path(path).expanduser()
    _writer(path)
    if path.suffix.lower() == ".parquet":
        need("pyarrow", "parquet", f"{path}: a Parquet file", RecordingError)


def _writer(path: Path) -> Callable[[Samples, str, Path], None]:
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise RecordingError(
            f"{path}: unknown kind of file {suffix or path.name!r}; choose"
            f" {', '.join(WRITERS[:-1])} or {WRITERS[-1]}"
        )
    write: Callable[[Samples, str, Path], None] = import_module(
        f"zendsp.recording.formats.{READERS[suffix]}"
    ).write
    return write


def metadata(recording: Samples) -> str:
    """All but the samples as JSON, in ASCII and on one line."""
    body: dict[str, Any] = {"form": FORM, "channels": [asdict(c) for c in recording.channels]}
    body |= {name: getattr(recording, name) for name in FIELDS}
    body["log"] = [asdict(change) for change in recording.log]
    body["source_hash"] = recording.source_hash
    text = json.dumps(body, default=_plain)
    body = json.loads(text)
    body[CHECK] = checksum(text, recording.t, recording.data)
    return json.dumps(body)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a recording cannot keep a {type(value).__name__}")


def load(path: Path, kind: type[Kind], time: str | None = None) -> Kind:
    """See `Recording.load`. ``time`` is the column of time in a file of another program."""
    return load_said(path, kind, time)[0]


def load_said(
    path: Path, kind: type[Kind], time: str | None = None
) -> tuple[Kind, tuple[str, ...]]:
    """The same, and what was done to the columns on the way, and which were left out."""
    raw = read_raw(path)
    if raw.metadata:
        return _own(path, raw, kind), ()  # its notes are of when it was made
    foreign = _foreign(path, raw, kind, time)
    return foreign, tuple(foreign.extra["notes"])


def _own(path: Path, raw: Raw, kind: type[Kind]) -> Kind:
    body, channels, t, data = checked(path, raw)
    try:
        log = tuple(ParameterChange(**change) for change in body["log"])
        fields = {name: body[name] for name in FIELDS}
        fields["flags"] = tuple(fields["flags"])
        return kind(t, data, channels, log=log, **fields)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise bad_description(path, error) from error


def _foreign(path: Path, raw: Raw, kind: type[Kind], asked: str | None) -> Kind:
    columns, units, notes = in_si({n: upright(v) for n, v in raw.columns.items()}, raw.units)
    columns, units = gather_vectors(columns, units)
    times = (
        n
        for n in (*TIMES, *columns)
        if n in columns and (n in TIMES or role_of(n, units[n]) is Role.TIME)
    )
    time = asked or next(times, None)
    if time is None or time not in columns:
        noted = "".join(f" ({note})" for note in raw.notes)
        raise RecordingError(
            f"{path}: has no time column ({asked or ' or '.join(TIMES[:2])}); it has"
            f" {listing(list(columns))}{noted}. Use zendsp.recording.read_table for a table"
            " without a time base"
        )
    t = columns.pop(time)
    units.pop(time, None)
    if len(t) == 0:
        raise RecordingError(f"{path}: has column names but no rows")
    left_out = [
        f"{name}: left out, it {why}" for name, why in raw.refused.items()
        if not any(note.startswith(f"{name}: ") for note in raw.notes)  # its reader has said so
    ]  # fmt: skip
    said = [*raw.notes, *left_out, *notes]
    extra = Extra(constants=raw.constants, notes=said, time_column=time)
    return kind.from_columns(columns, t=t, units=units, extra=extra)
