"""Writes rows as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from zendsp.errors import RecordingError
from zendsp.whole_file import writing


def write_rows(
    path: str | Path, what: str, header: Sequence[str], rows: Iterable[Mapping[str, object]]
) -> Path:
    """Write rows as CSV.

    Parameters
    ----------
    path : path
        Ends in ``.csv``.
    what : str
        Of the message, where it cannot be: "a sweep".
    header : sequence of str
        Names of the columns, in their order.
    rows : iterable of mapping
        Values by column.

    Raises
    ------
    RecordingError
        The name ends otherwise, or the file cannot be written.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() != ".csv":
        raise RecordingError(f"{path}: {what} is written as .csv")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, header, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return path
