"""MAT files of version 5 that hold matrices of real numbers and nothing else, as most recordings
do. SciPy reads all others: importing its reader takes a third of a second.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.recording.formats.raw import check_room

HEAD, TAG = 128, 8  # bytes of a file before its first part, and of a part before its contents
MATRIX, COMPRESSED, FLAGS, NAME = 14, 15, 16, 64  # kinds of parts; bytes
NUMBERS = {  # kinds of parts that hold numbers
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"
}  # fmt: skip
CLASSES = range(6, 16)  # of matrices: numbers from double to uint64
ODD = 0x0E  # of the flags of a matrix: complex, global or logical
EIGHT = 8  # bytes that a number takes as a column
UNREADABLE = (ValueError, KeyError, struct.error, zlib.error)


class _Other(ValueError):
    """Something that is left to SciPy."""


@dataclass(frozen=True)
class _Matrix:
    """A part of the file as bytes, its tag taken off."""

    body: bytes
    claimed: int  # bytes that it says it has
    rest: Any = None  # what decompresses the rest of it
    packed: bytes = b""


def read_plain(path: Path) -> dict[str, npt.NDArray[Any]] | None:
    """The matrices of a file by name, as SciPy returns them; None where it holds anything else, or
    cannot be read.

    Raises
    ------
    RecordingError
        It claims to hold more than there is memory.
    """
    data = path.read_bytes()
    if data[126:128] != b"IM" or data[125] != 1:  # another order of bytes, another version
        return None
    try:
        heads = list(_parts(data))
        shapes = [math.prod(_shape(part.body)) for part in heads]
        check_room(path, EIGHT * sum(shapes) + sum(part.claimed for part in heads))
        found = dict(_matrix(_whole(part)) for part in heads)
    except UNREADABLE:
        return None
    return found if len(found) == len(heads) else None


def _parts(data: bytes) -> Iterator[_Matrix]:
    """The parts of a file, of compressed ones the beginning."""
    at = HEAD
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        body = data[at + TAG : at + TAG + size]
        if len(body) < size:
            raise _Other
        at += TAG + size
        rest, claimed = None, size
        if kind == COMPRESSED:
            rest = zlib.decompressobj()
            begin = rest.decompress(body, TAG + FLAGS + NAME)
            kind, claimed = struct.unpack_from("<II", begin)
            body = begin[TAG:]
        if kind != MATRIX:
            raise _Other
        yield _Matrix(body, claimed, rest, b"" if rest is None else rest.unconsumed_tail)


def _whole(part: _Matrix) -> bytes:
    """A part in its full length."""
    if part.rest is None:
        return part.body
    left = part.claimed - len(part.body)
    body = part.body + (part.rest.decompress(part.packed, left) if left > 0 else b"")
    if len(body) != part.claimed:
        raise _Other
    return body


def _element(body: bytes, at: int) -> tuple[int, bytes, int]:
    """Kind and bytes of an element, and where the next one begins."""
    kind, size = struct.unpack_from("<II", body, at)
    if kind >> 16:  # a small one: its size stands beside its kind
        return kind & 0xFFFF, body[at + 4 : at + 4 + (kind >> 16)], at + TAG
    end = at + TAG + size
    return kind, body[at + TAG : end], end + -size % 8


def _shape(body: bytes) -> tuple[int, ...]:
    """The shape of a matrix of real numbers."""
    _, flags, at = _element(body, 0)
    said = struct.unpack_from("<I", flags)[0]
    if said & 0xFF not in CLASSES or said >> 8 & ODD:
        raise _Other
    _, dims, _ = _element(body, at)
    shape = struct.unpack(f"<{len(dims) // 4}i", dims)
    if len(shape) < 2 or min(shape) < 0:
        raise _Other
    return shape


def _matrix(body: bytes) -> tuple[str, npt.NDArray[Any]]:
    """Name and numbers of a matrix."""
    shape = _shape(body)
    *_, at = _element(body, 0)
    *_, at = _element(body, at)
    _, name, at = _element(body, at)
    kind, numbers, _ = _element(body, at)
    values = np.frombuffer(numbers, f"<{NUMBERS[kind]}").copy()  # which may be written to
    if not name or name.startswith(b"__") or values.size != math.prod(shape):
        raise _Other
    return name.decode("latin-1"), values.reshape(shape, order="F")
