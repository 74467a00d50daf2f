"""Files that zendsp has written: their description, and numbers that are checked by a checksum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats import Raw
from zendsp.recording.names import FloatArray, element_names
from zendsp.recording.samples import Channel
from zendsp_protocol import written

CHECK = "checksum"
FORM = 1  # version of the layout below; readers refuse what is newer


def checked(
    path: Path, raw: Raw
) -> tuple[dict[str, Any], tuple[Channel, ...], FloatArray, FloatArray]:
    """Description, channels, times and rows of a file of zendsp.

    Raises
    ------
    RecordingError
        Its numbers do not match its checksum, its description is damaged, or newer than this.
    """
    try:
        body = written.json(raw.metadata)
        expected = body.pop(CHECK, None)
        form = body["form"]
        if form > FORM:
            raise RecordingError(
                f"{path}: was written by a newer zendsp (layout {form}, this one reads {FORM});"
                " upgrade"
            )
        channels = tuple(Channel(**channel) for channel in body["channels"])
        available = raw.columns | {name: np.array([value]) for name, value in raw.constants.items()}
        data = _matrix(path, available, channels)
        t = available["t"].reshape(-1)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise bad_description(path, error) from error
    # files of zendsp 0.1.0 have none
    if expected is not None and checksum(json.dumps(body), t, data) != expected:
        raise RecordingError(
            f"{path}: is damaged, or was changed after it was saved: its numbers do not match"
            " its checksum. Take another copy"
        )
    return body, channels, t, data


def bad_description(path: Path, error: Exception) -> RecordingError:
    """The error for a description that zendsp would not have written."""
    return RecordingError(f"{path}: its description is damaged ({type(error).__name__}: {error})")


def checksum(text: str, t: FloatArray, data: FloatArray) -> str:
    """SHA-256 of the description and of every number. It is the same in all formats, and so is not
    that of the file's bytes.
    """
    digest = hashlib.sha256(text.encode())
    for array in (t, data):
        values = np.array(array, dtype="<f8", order="C")
        values[np.isnan(values)] = np.nan  # text keeps that it is none, not which
        digest.update(values.data)
    return digest.hexdigest()


def _matrix(
    path: Path, columns: Mapping[str, FloatArray], channels: tuple[Channel, ...]
) -> FloatArray:
    blocks = []
    for channel in channels:
        names = (
            [channel.name]
            if channel.name in columns
            else element_names(channel.name, channel.width)
        )
        missing = [name for name in names if name not in columns]
        if missing:
            raise RecordingError(
                f"{path}: lacks the column {missing[0]!r} that its description names"
            )
        blocks += [
            columns[name].reshape(-1, channel.width if len(names) == 1 else 1) for name in names
        ]
    rows = len(columns["t"].reshape(-1))
    return np.hstack(blocks) if blocks else np.empty((rows, 0))
