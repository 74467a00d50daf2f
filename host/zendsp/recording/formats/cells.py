"""The cells of a table of text as numbers: with decimal points or commas, dates and times of day,
vectors in brackets, cells for a number that is not there; and the fault in a cell that is none.
"""

from __future__ import annotations

import csv
import io
import re
import shlex
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.raw import Raw, Share
from zendsp.recording.names import FloatArray
from zendsp.recording.units import to_si
from zendsp_protocol.texts import counted

READ = 1 << 24  # characters that become numbers at a time
BETWEEN_DIGITS = re.compile(r"\d,\d")
NO_THOUSANDS = re.compile(r"(?<![\d.])0\.|\.(?!\d{3}(\D|$))")  # 0.500, 1.5
# a cell that may hold a number, with points and commas for either, or numbers in brackets
NUMBER = r"[+-]?(?:\d+|\d{1,3}(?:\.\d{3})+|\d{1,3}(?:,\d{3})+)?(?:[.,]\d*)?(?:[eE][+-]?\d+)?"
NUMERIC = re.compile(rf'[\s"]*(?:{NUMBER}|[\[(][-+\d.,eE\s]*[\])])[\s"]*')
# 01.02.2026, perhaps with 12:00:00: with points the day is first; 01/02/2026 may be both
DAY_FIRST = re.compile(r"(?<![\d.])(\d{1,2})\.(\d{1,2})\.(\d{4})(?![\d.])")
EITHER_FIRST = re.compile(r"\d{1,2}[/.-]\d{1,2}[/.-]\d{2,4}\b")
VECTOR = re.compile(r"[\[(](.*)[\])]")
ISO = "2026-02-01 12:00:00.5"
DAY_S = 86400.0
# cells that stand for a number that is not there, as pandas, Python, spreadsheets and MATLAB say it
NOTHING = ("", "NA", "N/A", "n/a", "#N/A", "<NA>", "null", "NULL", "None")
SHOWN = 40  # characters of a line in a message
SEEN = 1 << 12  # characters from the first comma on that tell what it is


def numbers(
    path: Path, rows: str, raw: Raw, delimiter: str, first_line: int, tell: Share | None
) -> Raw:
    """The columns of the file whose names are the keys of ``raw.units``."""
    names = list(raw.units)
    decimal = _decimal(rows, delimiter)
    if not rows.strip():
        raise RecordingError(f"{path}: has column names but no rows")
    text = _pointed(_year_first(rows), delimiter) if decimal == "," else rows
    try:
        table = _table(text, delimiter, tell)
        if table.shape[1] != len(names):
            raise ValueError(
                f"{counted(table.shape[1], 'column')} where the header names {len(names)}"
            )
    except ValueError as error:  # empty cells, words for NaN, dates and text are read one by one
        rows = _year_first(rows)
        text = text if decimal == "," else rows
        try:
            return _with_words(text, raw, delimiter)
        except ValueError:
            raise _first_fault(path, rows, names, delimiter, decimal, first_line, error) from error
    columns = {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(names)}
    return replace(raw, columns=columns)


def _year_first(rows: str) -> str:
    """The rows with dates as ISO 8601 has them."""
    return DAY_FIRST.sub(lambda d: f"{d[3]}-{int(d[2]):02}-{int(d[1]):02}", rows)


def _table(text: str, delimiter: str, tell: Share | None) -> FloatArray:
    """The numbers of all lines, read in pieces of whole lines; ValueError where any is none."""
    pieces, at = [], 0
    piece = len(text) if '"' in text else READ  # a quoted cell may hold a line's end
    while at < len(text):
        end = text.find("\n", at + piece) + 1 or len(text)
        if lines := text[at:end].strip("\n"):
            pieces.append(
                np.loadtxt(
                    io.StringIO(lines), delimiter=delimiter, comments=None, quotechar='"', ndmin=2
                )
            )
        at = end
        if tell is not None and len(text) > READ:
            tell(at / len(text))
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _decimal(rows: str, delimiter: str) -> str:
    """The decimal separator: a comma between digits where it parts no columns, then with no points
    but those between thousands (1.234,5); else a point. It is looked for from the first line with a
    comma on: a machine at rest may have whole numbers only.
    """
    at = rows.find(",")
    if delimiter == "," or at < 0:
        return "."
    begin = rows.rfind("\n", 0, at) + 1
    seen = _year_first(rows[begin : begin + SEEN])
    whole = seen[: seen.rfind("\n")] if "\n" in seen else seen
    cells = re.findall(_cells_with(",", delimiter), whole)
    commas = any(NUMERIC.fullmatch(c) and BETWEEN_DIGITS.search(c) for c in cells)
    return "," if commas and _in_thousands(whole, delimiter) else "."


def _cells_with(mark: str, delimiter: str) -> str:
    """The pattern of a cell with this mark, tried once a cell."""
    return rf"(?<![^{delimiter}\n])[^{delimiter}\n{mark}]*[{mark}][^{delimiter}\n]*"


def _in_thousands(text: str, delimiter: str) -> bool:
    """Whether all points of numbers, if there are any, can stand between thousands. A word such as
    v1.2 says nothing of them.
    """
    cells = (found[0] for found in re.finditer(_cells_with(".", delimiter), text))
    return not any(NO_THOUSANDS.search(cell) and NUMERIC.fullmatch(cell) for cell in cells)


def _pointed(text: str, delimiter: str) -> str:
    """Numbers with decimal points, from those with decimal commas. Points are between thousands,
    unless some cannot be.
    """
    if _in_thousands(text, delimiter):
        text = re.sub(_cells_with(".", delimiter), _without_points, text)
    return text.replace(",", ".")


def _without_points(cell: re.Match[str]) -> str:
    return cell[0].replace(".", "") if NUMERIC.fullmatch(cell[0]) else cell[0]


def _with_words(text: str, raw: Raw, delimiter: str) -> Raw:
    """All columns. Empty cells, ``NA`` and ``null`` are NaN, dates are seconds, vectors in brackets
    are arrays, and rows of empty cells are left out; columns of words only are refused. A word
    among numbers raises ValueError.
    """
    names = list(raw.units)
    lines = csv.reader(io.StringIO(text), delimiter=delimiter)
    table = [cells for cells in lines if any(cell.strip() for cell in cells)]
    if any(len(cells) != len(names) for cells in table):
        raise ValueError("lines of different length")
    columns, units, refused, notes = {}, dict(raw.units), {}, list(raw.notes)
    for name, column in zip(names, zip(*table, strict=True), strict=True):
        cells = ["nan" if c.strip() in NOTHING else c.strip() for c in column]
        if all(c == "nan" or not is_number(c) for c in cells) and set(cells) != {"nan"}:
            vectors = _vectors(cells)
            if vectors is not None:
                columns[name] = vectors
                continue
            seconds = _seconds(cells)
            if seconds is None:
                date = EITHER_FIRST.match(cells[0])
                what = f"dates, of which {ISO} is read" if date else "text"
                refused[name] = f"holds {what}" if date else "holds text and no numbers"
                notes.append(f"{name}: left out, it holds {what}")
                continue
            if not any(":" in cell for cell in cells):
                refused[name] = "holds dates without a time of day"
                notes.append(f"{name}: left out, it holds dates without a time of day")
                continue
            notes.append(f"{name}: seconds since {cells[0]}")
            columns[name], units[name] = seconds, "s"
        else:
            columns[name] = np.array([float(c) for c in cells])
    if not columns:
        raise ValueError("nothing but text")
    return replace(raw, columns=columns, units=units, refused=refused, notes=tuple(notes))


def _vectors(cells: list[str]) -> FloatArray | None:
    """The numbers of cells that hold as many each in brackets, ``[0.1, 0.2]`` or ``(0.1, 0.2)``, as
    pandas writes the arrays of a JointState; None of any others.
    """
    inside = [VECTOR.fullmatch(cell) for cell in cells]
    try:
        rows = [[float(x) for x in one[1].replace(",", " ").split()] for one in inside if one]
        return np.array(rows) if len(rows) == len(cells) and rows[0] else None
    except ValueError:  # words, or more in one than in another
        return None


def _seconds(cells: list[str]) -> FloatArray | None:
    """Seconds since the first cell, of dates, or times of day, which go on past midnight; None for
    other cells.
    """
    day = "" if "-" in cells[0] else "1970-01-01 "
    try:
        times = [datetime.fromisoformat(day + cell) for cell in cells]
        seconds = np.array([(time - times[0]).total_seconds() for time in times])
        return np.unwrap(seconds, period=DAY_S) if day else seconds
    except (ValueError, TypeError):
        return None


def _first_fault(
    path: Path,
    rows: str,
    names: list[str],
    delimiter: str,
    decimal: str,
    first_line: int,
    error: Exception,
) -> RecordingError:
    """The error that names the line which the fast reader refused, and what is wrong with it."""
    for number, cells in enumerate(csv.reader(io.StringIO(rows), delimiter=delimiter), first_line):
        above = _where_named(path, rows, delimiter, decimal, number) * (number == first_line)
        if any("\n" in cell for cell in cells):
            return RecordingError(
                f"{path}: line {number}: a quote (\") is opened and not closed: correct it, or"
                " take it out"
            )
        if cells and len(cells) != len(names):
            line, have = _shorten(delimiter.join(cells)), counted(len(cells), "value")
            return RecordingError(
                f"{path}: line {number} ({line}) has {have}, parted by {delimiter!r}, where the"
                f" header names {len(names)}: correct it, or take it out{above}"
            )
        for name, cell in zip(names, cells, strict=False):
            text = _pointed(cell.strip(), delimiter) if decimal == "," else cell.strip()
            if text not in NOTHING and not is_number(text):
                comma = decimal == "," and any(c.isdigit() for c in cell)
                others = " with a decimal comma, as the others are" * comma
                return RecordingError(
                    f"{path}: column {name!r}, line {number}: {cell.strip()!r} is not a"
                    f" number{others}: correct it, or leave it empty{above}"
                )
    return RecordingError(f"{path}: cannot be read as a table of numbers ({error})")


def _where_named(path: Path, rows: str, delimiter: str, decimal: str, first_line: int) -> str:
    """What to do where the line before ``rows`` is no header: the names of the columns stand above
    the first line of numbers, or above the units there.
    """
    lines = csv.reader(io.StringIO(rows), delimiter=delimiter)
    words: list[list[str]] = []
    for cells in lines:
        bare = [c.strip() for c in cells]
        plain = [_pointed(c, delimiter) if decimal == "," else c for c in bare]
        if plain and all(map(is_number, plain)):
            break
        words.append(plain)
    else:  # no line of numbers: nothing says where the names are
        words = []
    if words and all(map(to_si, words[-1])):
        words.pop()
    delete = (
        f"; if line {first_line - 1} is no header, delete the lines above the names of the columns"
    )
    if not words or path.suffix == ".gz":
        return delete
    named = first_line - 1 + len(words)
    return (
        f"{delete}: if these are line {named} ({_shorten(delimiter.join(words[-1]))}), by"
        f" '{shlex.join(['tail', '-n', f'+{named}', str(path)])} > named.csv'"
    )


def _shorten(line: str) -> str:
    """The beginning of a line of a file, in quotes."""
    return repr(line if len(line) <= SHOWN else f"{line[:SHOWN]}…")


def is_number(text: str) -> bool:
    """Whether a text is a number as Python writes it."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def is_value(cell: str) -> bool:
    """Whether a cell can stand below a header: a number, a date or time, or nothing."""
    text = _year_first(cell.strip().strip('"'))
    return text in NOTHING or is_number(text.replace(",", ".")) or _seconds([text]) is not None
