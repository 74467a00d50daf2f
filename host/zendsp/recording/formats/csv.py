"""CSV and TSV: a header of names (``q1`` or ``q1 [rad]``), optionally a row of units, then rows of
numbers.

In a recording of zendsp the first line is a comment for people, and the last line, a comment too,
holds the metadata; readers that know ``#`` skip both. The separator, ``,`` ``;`` or tab, is found
from the header and may also end each line; where the header has none, blanks part the columns.
Lines of text above the header are passed over where only one line has a name for each number below.
``;`` with decimal commas is understood, and ``,`` where they are quoted. A column of dates or times
of day (ISO 8601, or day.month.year) becomes seconds since its first; a column of words or days only
is left out. The two columns of a ROS time stamp become one. The text is UTF-8, UTF-16 with its
mark, or Windows-1252, as spreadsheets write. A file ``.gz`` is unpacked.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import gzip
import io
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.cells import NOTHING, is_number, is_value, numbers
from zendsp.recording.formats.raw import Raw, Share, check_room
from zendsp.recording.names import split_quotients, split_unit
from zendsp.recording.units import to_si
from zendsp_protocol.texts import counted

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

MARK = "# zendsp "
FIRST, PIECE = 1 << 12, 1 << 26  # bytes that are read first, and then at a time
TITLE = "# A recording of zendsp"
# "0,5" in quotes; "1,234" may have its comma between thousands
QUOTED_COMMA = re.compile(r'" *[+-]?(?:0,\d|\d+,(?!\d{3}\D))')
# what ROS calls the whole seconds of a time stamp, and the rest beside them
NANOSECONDS = {"sec": ("nanosec", "nsec"), "secs": ("nsecs", "nanosecs")}
PREFACE = 100  # lines at the most above the header, of which every instrument writes fewer
HEAD = 1 << 17  # characters in which they are looked for
ALIKE = 3  # rows of numbers below it that have to part alike
ROSTOPIC = re.compile(r"%time,field\b")  # echo -p: its own time in ns, then the message
EXAMPLE = ("t", "position", "torque", "reference", "...")  # of a header, for who has none
WORD = re.compile(r"[^\s\[]+(?:\s*\[[^\]]*\])?")  # a name, perhaps with its unit: t [s]
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording`` with 17 significant digits, so that reading returns the same numbers.
    Columns of one name, as those of ``q`` and of ``q[1]`` beside it, are one; the signal ``t`` is
    the time.
    """
    units = dict(zip(recording.columns, recording.column_units, strict=True))
    units.pop("t", "")
    header = ["t [s]", *(f"{name} [{unit}]" if unit else name for name, unit in units.items())]
    once = [recording.columns.index(name) for name in units]
    with path.open("w", newline="") as file:
        file.write(f"{_title(recording)}\n")
        csv.writer(file, lineterminator="\n").writerow(header)
        numbers = np.column_stack([recording.t, recording.data[:, once]])
        np.savetxt(file, numbers, fmt="%s", delimiter=",")
        file.write(f"{MARK}{metadata}\n")


def _title(recording: Recording) -> str:
    """A line that says what the file is, and where the metadata are."""
    made = f" of {recording.target}" if recording.target else ""
    rows = len(recording.t)
    apart = float(np.median(np.diff(recording.t))) if rows > 1 else 0.0
    what = f"{rows} rows, {apart:g} s apart"
    return f"{TITLE}{made}: {what}. Parameters and source: last line."


def read(path: Path, tell: Share | None = None) -> Raw:
    """Read any CSV whose first line that is not a comment names the columns. ``tell`` takes the
    share that is read, where that is not done at once.
    """
    body, metadata = _apart(_text(path))
    first_line, ours, above = 1, False, ""
    while body.startswith(("#", "\n")):
        line, _, body = body.partition("\n")
        first_line, above = first_line + 1, line
        ours = ours or line.startswith(TITLE)
        if line.startswith(MARK):  # where it stood before it stood last
            metadata = line[len(MARK) :]
    if ours and not metadata:
        raise RecordingError(
            f"{path}: is cut short: it lacks its last line, which holds the parameters and a"
            " checksum. Take another copy, or delete the first line to read what is left"
        )
    passed = _preface(body)
    for _ in range(passed):
        above, _, body = body.partition("\n")
    first_line += passed
    header_line, _, rows = body.partition("\n")
    if _names(above, header_line):  # as np.savetxt writes them
        header_line, rows, first_line = above[1:].strip(), body, first_line - 1
    header_line = header_line.lstrip("%") if ROSTOPIC.match(header_line) is None else header_line
    if not header_line.strip():
        raise RecordingError(
            f"{path}: is empty; expected a line of column names, then rows of numbers"
        )
    delimiter = next((d for d in (";", "\t", ",") if d in header_line), ",")
    if words := _by_blanks(header_line, rows.partition("\n")[0]):
        header_line, delimiter = " ".join(words), " "
        rows = "\n".join(" ".join(line.split()) for line in rows.split("\n"))
    if header_line.endswith(delimiter):
        header_line = header_line[:-1]
        rows = "\n".join(line.removesuffix(delimiter) for line in rows.split("\n"))
    names, units = _header(path, header_line, delimiter, first_line)
    if said := _unit_row(rows.partition("\n")[0], delimiter, len(names)):
        units = {name: units[name] or unit for name, unit in zip(names, said, strict=True)}
        rows, first_line = rows.partition("\n")[2], first_line + 1
    if delimiter == "," and _quotes_decimals(rows, len(names)):
        delimiter = ";"
        rows = "\n".join(";".join(cells) for cells in csv.reader(io.StringIO(rows)))
    said_above = f"{counted(passed, 'line')} above the names of the columns passed over"
    raw = Raw({}, units, {}, metadata, notes=(said_above,) * bool(passed))
    return _stamped(numbers(path, rows, raw, delimiter, first_line + 1, tell))


def _names(comment: str, line: str) -> bool:
    """Whether a comment names the numbers of the line below it."""
    between = r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+"
    words, cells = (re.split(between, text.strip()) for text in (comment[1:], line))
    return len(words) == len(cells) > 1 and all(map(is_number, cells))


def _quotes_decimals(rows: str, width: int) -> bool:
    """Whether commas part numbers in quotes that have commas of their own: "0,5","1,25"."""
    head = rows[: rows.rfind("\n", 0, 4096) + 1] or rows
    cells = csv.reader(io.StringIO(head))
    return (
        bool(QUOTED_COMMA.search(head)) and ";" not in rows
        and all(len(row) in (0, width) for row in cells)
    )


def _preface(body: str) -> int:
    """The number of lines above the header: the one line, perhaps with a row of units below it,
    that has as many fields as the rows that follow. 0 where it is the first, or not sure.
    """
    lines = body[:HEAD].split("\n")[:-1][: PREFACE + ALIKE]
    for delimiter in (";", "\t", ","):
        bare = [line.removesuffix(delimiter) for line in lines]
        fields = [next(csv.reader([line], delimiter=delimiter), []) for line in bare]
        first = next((k for k in range(len(fields)) if _alike(fields[k : k + ALIKE])), 0)
        named = [k for k in range(first) if len(fields[k]) == len(fields[first])]
        if not named:
            continue
        units = _unit_row(lines[first - 1], delimiter, len(fields[first]))
        if named[0] == first - 1 or (named == [first - 2, first - 1] and units):
            return named[0]
    return 0


def _alike(rows: list[list[str]]) -> bool:
    """Whether rows part alike: two or more columns of values, and perhaps some of words."""
    if len({len(cells) for cells in rows}) > 1:
        return False
    kinds = [
        {is_value(cell) for cell in column if cell.strip() not in NOTHING}
        for column in zip(*rows, strict=True)
    ]
    return all(len(kind) < 2 for kind in kinds) and kinds.count({True}) > 1


def _stamped(raw: Raw) -> Raw:
    """One column of each time stamp of two: ``header.stamp.sec`` and ``header.stamp.nanosec``; that
    of rostopic in s.
    """
    columns, units, notes = dict(raw.columns), dict(raw.units), list(raw.notes)
    if ROSTOPIC.match(",".join(columns)):
        units |= {name: "ns" for name in columns if name == "%time" or name.endswith(".stamp")}
    for name in raw.columns:
        last = next((w for w in NANOSECONDS if re.search(rf"(?<![a-z]){w}$", name)), "")
        before = name.removesuffix(last)
        rest = next((before + n for n in NANOSECONDS.get(last, ()) if before + n in columns), "")
        stamp = before.rstrip("./_") or "stamp"
        if rest and stamp not in columns:
            whole = columns.pop(name)
            columns = {stamp: whole - whole[:1] + 1e-9 * columns.pop(rest), **columns}
            units[stamp] = "s"
            notes.append(f"{stamp}: {name} and {rest}, since {whole[0]:.0f} s")
    return replace(raw, columns=columns, units=units, notes=tuple(notes))


def _by_blanks(header: str, row: str) -> list[str]:
    """The names of a header that blanks part, as they part as many numbers in the row below it;
    empty of any other.
    """
    names = [word.replace(" ", "") for word in WORD.findall(header)]
    values = row.replace(",", ".").split()
    same = len(names) == len(values) > 1 and not any(d in header for d in ";\t,")
    return names if same and all(map(is_number, values)) else []


def _apart(text: str) -> tuple[str, str]:
    """The lines of numbers, and the metadata where the last line holds them."""
    at = text.rfind(f"\n{MARK}")
    if at < 0 or "\n" in text[at + 1 :].rstrip("\n"):
        return text, ""
    return text[: at + 1], text[at + 1 + len(MARK) :].rstrip("\n")


def _text(path: Path) -> str:
    try:
        return _decoded(path, _bytes(path)).replace("\r\n", "\n").replace("\r", "\n")
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise RecordingError(
            f"{path}: is not a readable gzip file, or it is cut short ({error})"
        ) from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be opened ({error.strerror})") from error


def _bytes(path: Path) -> bytes:
    """The bytes of a file, unpacked. What does not fit into memory is refused, by the size of the
    file or as it unpacks, to a thousand times as many bytes; and what is no text, by its first
    piece that is none.
    """
    raw = bytearray()
    if path.suffix != ".gz":
        check_room(path, path.stat().st_size)
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        while piece := file.read(PIECE if raw else FIRST):
            raw += piece
            check_room(path, len(raw))
            if _has_nul(piece, wide=raw[:2] in UTF_16):
                raise _no_text(path)
    return bytes(raw)


def _has_nul(piece: bytes, *, wide: bool) -> bool:
    """Whether a character 0 is among them, of which no text has one; ``wide``: of two bytes."""
    return not np.frombuffer(piece[: len(piece) & ~1], np.uint16).all() if wide else b"\0" in piece


def _decoded(path: Path, raw: bytes) -> str:
    """The text of a file, whose encoding is guessed. Numbers are the same in all encodings but
    UTF-16.
    """
    for encoding in ("utf-16" if raw[:2] in UTF_16 else "utf-8-sig", "cp1252"):
        with contextlib.suppress(UnicodeDecodeError):
            text = raw.decode(encoding)
            if "\0" not in text:
                return text
    raise _no_text(path)


def _no_text(path: Path) -> RecordingError:
    return RecordingError(
        f"{path}: is not text; is it a file of another kind? Then give it that kind's suffix"
    )


def _header(path: Path, line: str, delimiter: str, number: int) -> tuple[list[str], dict[str, str]]:
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    if all(is_number(cell) for cell in cells):
        raise RecordingError(
            f"{path}: line {number} holds numbers ({line[:40].strip()}); expected the names of its"
            f" {counted(len(cells), 'column')} there: put a line such as"
            f" {delimiter.join(EXAMPLE[: len(cells)])} above it"
        )
    split = split_quotients(cells) or [split_unit(cell) for cell in cells]
    names = [name for name, _ in split]
    seen: set[str] = set()
    for k, name in enumerate(names):
        if not name:
            raise RecordingError(f"{path}: column {k + 1} has no name in line {number}")
        if name in seen:
            raise RecordingError(f"{path}: line {number} names column {name!r} twice")
        seen.add(name)
    return names, dict(split)


def _unit_row(line: str, delimiter: str, width: int) -> list[str]:
    """The units in the row below the header; empty where that row holds anything else."""
    cells = [
        cell.strip().strip("[]()").strip()
        for cell in next(csv.reader([line], delimiter=delimiter), [])
    ]
    words = [cell for cell in cells if cell not in ("", "-", "1")]
    known = [word for word in words if to_si(word)]
    if (
        len(cells) != width
        or any(is_number(word) for word in words)
        or 2 * len(known) <= len(words)
    ):
        return []
    return ["" if cell in ("-", "1") else cell for cell in cells]
