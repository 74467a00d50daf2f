"""Recorded rows on their way out: one request, many replies, each with its own checksum."""

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


def send_rows(runtime: RuntimeApi, stream: int, args: verbs.AcquireRead, query: zenoh.Query) -> m.Empty:
    """Reply with the rows asked for, in chunks; they give way to quick replies on the same link.

    Raises
    ------
    AcquisitionError
        The rows were never recorded or are overwritten already.
    """
    status = runtime.acquire_status(stream)
    if args.first < status.first or args.count < 0 or args.first + args.count > status.count:
        raise AcquisitionError(
            f"rows {args.first}…{args.first + args.count} are not held; the recorder has {status.first}…{status.count}"
        )
    columns = max(1, len(status.channels))
    rows_each = max(1, min(max(args.chunk, LOWEST), HIGHEST) // (8 * columns))
    memory = bytearray(rows_each * columns * 8)  # used for each chunk in turn: Zenoh copies what it is given
    into = np.frombuffer(memory, dtype=np.float64).reshape(rows_each, columns)
    for first, count in spans(args.first, args.count, rows_each):
        fold = bytearray(FOLD)
        rows = runtime.acquire_read(stream, first, count, into, fold)
        header = m.ChunkHeader(v=PROTOCOL, first=first, rows=len(rows), columns=columns, crc=crc(fold))
        whole = len(rows) * columns * 8 == len(memory)
        # Priority is that of the query: hosts ask with DATA_LOW, so that quick replies overtake these.
        query.reply(query.key_expr, memory if whole else memory[: len(rows) * columns * 8], attachment=encode(header))
    return m.Empty()
