"""Recorded rows on their way home: in checked chunks, put in their place, resumed after a broken link."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from zendsp.errors import AcquisitionError, LinkError
from zendsp.link.requests import PATIENCE_S, Requests
from zendsp_protocol import codec
from zendsp_protocol import messages as m
from zendsp_protocol.chunks import CHUNK, folded_crc, gaps
from zendsp_protocol.lazily import Lazily

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]
else:
    np = Lazily("numpy")

REQUEST_BYTES = 128 << 20  # rows asked for at once: what is lost at most when the link breaks
CHUNK_BYTES = CHUNK  # of one part: each has its own price at either end, and larger ones leave the caches
MOST_IDLE = 3  # requests in a row without a single row, until it is given up


class Rows:
    """Rows as they arrive, each chunk checked and put in its place."""

    def __init__(self, columns: int, rows: int) -> None:
        self.data: FloatArray = np.empty((rows, columns))
        self.pieces: list[tuple[int, int]] = []
        self.origin = 0

    def take(self, attachment: bytes, payload: bytes) -> None:
        """Accept one chunk.

        Raises
        ------
        AcquisitionError
            Its checksum or its size is wrong; what came before is kept.
        """
        header: m.ChunkHeader = codec.decode(attachment, m.ChunkHeader)
        if folded_crc(payload) != header.crc or len(payload) != 8 * header.rows * header.columns:
            raise AcquisitionError(
                f"rows {header.first}…{header.first + header.rows} arrived damaged (checksum)"
            )
        place = header.first - self.origin
        self.data[place : place + header.rows] = np.frombuffer(payload, "<f8").reshape(
            header.rows, header.columns
        )
        self.pieces.append((header.first, header.rows))

    @property
    def count(self) -> int:
        """Rows received."""
        return sum(rows for _, rows in self.pieces)


class Transfers(Requests):
    """Methods of a target that fetch rows of the recorder."""

    def load_rows(
        self,
        first: int,
        count: int,
        columns: int,
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> FloatArray:
        """Load rows of the recorder, shape ``(count, columns)``; resumes after a broken link."""
        rows = Rows(columns, count)
        rows.origin = first
        each = max(1, REQUEST_BYTES // (8 * columns))
        idle = 0  # rounds in a row that brought nothing
        while missing := gaps(rows.pieces, first, count):
            before = rows.count
            start, length = missing[0]
            arguments = {"first": start, "count": min(length, each), "chunk": CHUNK_BYTES}
            try:
                self.link.stream("acquire_read", arguments, rows.take)
            except LinkError:
                idle = idle + 1 if rows.count == before else 0
                if self.link.closed or idle >= MOST_IDLE or not self.link.wait_alive(patience):
                    raise
            if progress is not None:
                progress(rows.count / count)
        return rows.data
