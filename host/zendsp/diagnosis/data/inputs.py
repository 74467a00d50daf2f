"""What a user gives to a diagnosis, in all the kinds it may have: a model, and recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zendsp.diagnosis.data.columns import IN_MEMORY
from zendsp.diagnosis.data.reading import Source
from zendsp.errors import ModelError, RecordingError
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.files.questions import still_open
from zendsp.physics.model import Model
from zendsp.recording import Recording, Table
from zendsp.recording.table import Frame

Given = Model | str | Path | dict[str, Any]


def model_of(model: Given) -> tuple[Model, tuple[str, ...]]:
    """A given model, and a note where questions are open in its file."""
    if isinstance(model, Model):
        return model, ()
    if isinstance(model, str | Path):
        asked = still_open(model)
        return load_model(model), (asked,) if asked else ()
    if not isinstance(model, dict):
        kind = type(model).__name__
        raise ModelError(
            f"model: {kind} is no model: give the path of a model file, a Model or a dict"
        )
    return parse_model(model), ()


Recorded = Source | Frame | Mapping[str, Any]


def sources_of(given: Recorded | Sequence[Recorded] | None) -> list[Source]:
    """The given recordings, each checked for its kind."""
    if given is None:
        return []
    table = isinstance(given, Mapping) or hasattr(given, "columns")  # it would list its columns
    one = table or isinstance(given, str | Path) or not isinstance(given, Iterable)
    sources: list[Any] = [given] if one else list(given)  # type: ignore[arg-type]
    return [_source(each) for each in sources]


def _source(given: Any) -> Source:
    if isinstance(given, str | Path | Recording | Table):
        return given
    if isinstance(given, Mapping) or (hasattr(given, "columns") and hasattr(given, "__getitem__")):
        return Table.from_columns(given, IN_MEMORY)
    raise RecordingError(
        f"recording: {type(given).__name__} is no recording: give the path of a file, a DataFrame,"
        ' or zendsp.Recording.from_columns({"q": q, "u": u}, t=t)'
    )
