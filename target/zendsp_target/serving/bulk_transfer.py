"""Sends recorded rows: one request, many replies, each with its own checksum."""

from __future__ import annotations

import numpy as np
import zenoh

from zendsp_protocol import messages as m
from zendsp_protocol import verbs
from zendsp_protocol.chunks import FOLD, crc, spans
from zendsp_protocol.codec import encode
from zendsp_protocol.errors import AcquisitionError
from zendsp_protocol.version import PROTOCOL
from zendsp_target.api import RuntimeApi

LOWEST, HIGHEST = 1 << 12, 1 << 23  # bytes of one chunk


def send_rows(
    runtime: RuntimeApi, stream: int, args: verbs.AcquireRead, query: zenoh.Query
) -> m.Empty:
    """Reply with the rows asked for, in chunks; short replies on the same link go first.

    Raises
    ------
    AcquisitionError
        The rows were never recorded or are overwritten already.
    """
    status = runtime.acquire_status(stream)
    if args.first < status.first or args.count < 0 or args.first + args.count > status.count:
        raise AcquisitionError(
            f"rows {args.first}…{args.first + args.count} are not held; the recorder has"
            f" {status.first}…{status.count}"
        )
    columns = max(1, len(status.channels))
    rows_each = max(1, min(max(args.chunk, LOWEST), HIGHEST) // (8 * columns))
    buffer = _Buffer(rows_each, columns)  # one for all of them, since Zenoh copies what it is given
    for first, count in spans(args.first, args.count, rows_each):
        # In this thread: the link's queue holds a whole chunk (see endpoints), so that one is
        # filled while the last one leaves anyway, and what was just copied here is still in this
        # processor's cache when Zenoh copies it on.
        header, payload = buffer.fill(runtime, stream, first, count)
        # Priority is that of the query: hosts ask with DATA_LOW, so that quick replies overtake
        # these.
        query.reply(query.key_expr, payload, attachment=header)
    return m.Empty()


class _Buffer:
    """Memory for one chunk of rows."""

    def __init__(self, rows: int, columns: int) -> None:
        self._columns = columns
        self._memory = bytearray(rows * columns * 8)
        self._into = np.frombuffer(self._memory, dtype=np.float64).reshape(rows, columns)

    def fill(
        self, runtime: RuntimeApi, stream: int, first: int, count: int
    ) -> tuple[bytes, bytes | bytearray]:
        """Copy rows into it; return the chunk's header and its bytes, which hold until the next
        call.
        """
        fold = bytearray(FOLD)
        rows = runtime.acquire_read(stream, first, count, self._into, fold)
        header = m.ChunkHeader(
            v=PROTOCOL, first=first, rows=len(rows), columns=self._columns, crc=crc(fold)
        )
        size = len(rows) * self._columns * 8
        return encode(header), self._memory if size == len(self._memory) else self._memory[:size]
