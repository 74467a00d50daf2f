"""Rows of numbers as Protobuf messages that carry their own description: what Foxglove and
PlotJuggler both read, whatever the names. https://protobuf.dev/programming-guides/encoding/
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from zendsp.recording.names import FloatArray

FILE, PACKAGE, MESSAGE = "zendsp.proto", "zendsp", "Signals"
ONE, MANY, DOUBLE = 1, 3, 1  # of FieldDescriptorProto: optional, repeated, double
NUMBER, WORD, BYTES = 0, 1, 2  # wire types: varint, 8 bytes, bytes of a stated length


class Rows:
    """The Protobuf form of the rows of a table: time and signals, each one number or several.

    Parameters
    ----------
    names : sequence of str
    widths : sequence of int
        Numbers of each.
    """

    def __init__(self, names: Sequence[str], widths: Sequence[int]) -> None:
        self.schema = _file(names, widths)
        parts = []
        for number, width in enumerate(widths, 1):
            key = _key(number, WORD) if width == 1 else _key(number, BYTES) + _varint(8 * width)
            parts.append((np.frombuffer(key, "u1"), width))
        self._rows = np.dtype(
            [
                entry
                for k, (key, width) in enumerate(parts)
                for entry in ((f"key{k}", "u1", (len(key),)), (f"value{k}", "<f8", (width,)))
            ]
        )
        self._parts = parts

    def encode(self, data: FloatArray) -> Iterator[bytes]:
        """Yield a message for each row; the columns are those of all names, one after another."""
        rows, at = np.empty(len(data), self._rows), 0
        for k, (key, width) in enumerate(self._parts):
            rows[f"key{k}"] = key
            rows[f"value{k}"] = data[:, at : at + width]
            at += width
        for row in rows:
            yield row.tobytes()


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _key(number: int, kind: int) -> bytes:
    return _varint(number << 3 | kind)


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _key(number, NUMBER) + _varint(value)
    body = value.encode() if isinstance(value, str) else value
    return _key(number, BYTES) + _varint(len(body)) + body


def _file(names: Sequence[str], widths: Sequence[int]) -> bytes:
    """A FileDescriptorSet of one file with one message; descriptor.proto has the numbers."""
    packed = _field(8, _field(2, 1))
    fields = [
        _field(1, name) + _field(3, k) + _field(5, DOUBLE) + _field(10, name)
        + (_field(4, ONE) if width == 1 else _field(4, MANY) + packed)
        for k, (name, width) in enumerate(zip(names, widths, strict=True), 1)
    ]  # fmt: skip
    message = _field(1, MESSAGE) + b"".join(_field(2, field) for field in fields)
    file = _field(1, FILE) + _field(2, PACKAGE) + _field(4, message)
    return _field(1, file)
