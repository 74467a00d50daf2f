"""Loads recorded rows from the target.

Over the link the rows come in checked chunks, each put in its place, and the transfer resumes after
a broken link. A host of the target's own user on the same computer reads the rows in shared memory,
where the loop wrote them: Zenoh over a Unix socket would bring them at a third of that speed, with
work for both processes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zendsp.errors import AcquisitionError, LinkError, Refused, VariableError
from zendsp.link.requests import PATIENCE_S, Part, Requests
from zendsp_protocol import codec
from zendsp_protocol import messages as m
from zendsp_protocol.chunks import CHUNK, KERNEL, folded_crc, gaps, spans
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.states import ProgramState

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]
else:
    np = Lazily("numpy")

REQUEST_BYTES = 128 << 20  # rows asked for at once: what is lost at most when the link breaks
# of one part: each has its own price at either end, and larger ones leave the caches
CHUNK_BYTES = CHUNK
PIECE_BYTES = 16 << 20  # read at once from shared memory: progress is told in between
MOST_IDLE = 3  # requests in a row without a single row, until it is given up


def need_channels(
    request: Callable[..., Any], channels: str | Sequence[str], status: m.Status
) -> None:
    """Refuse a channel that does not exist, whatever state the program is in.

    Raises
    ------
    AcquisitionError
        No such channel.
    """
    if status.state == ProgramState.EMPTY:
        return
    try:
        request("read", names=[channels] if isinstance(channels, str) else list(channels))
    except VariableError as error:
        raise AcquisitionError(str(error)) from None


def room(rows: int, columns: int) -> FloatArray:
    """Memory for rows. It is taken as they come: to fill 6 GB now would take half a minute, deaf to
    Ctrl-C.

    Raises
    ------
    AcquisitionError
        The computer has not as much.
    """
    try:
        return np.empty((rows, columns))
    except (MemoryError, ValueError):  # more than there is, or than can be counted
        raise AcquisitionError(
            f"{rows} rows of {columns} columns take {8e-9 * rows * columns:.3g} GB, more than this"
            " computer has: acquire for a shorter time, or with a decimation"
        ) from None


class Rows:
    """Memory for rows: each chunk that arrives is checked and put in its place."""

    def __init__(self, columns: int, rows: int) -> None:
        self.data = room(rows, columns)
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


def open_held(held: m.Held) -> int:
    """Open the file that holds the rows; return -1 where it cannot be opened from here."""
    try:
        if not held.path or Path(KERNEL).read_text().strip() != held.kernel:
            return -1
        file = os.open(held.path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:  # another container, or a target that gave itself more rights than its user has
        return -1
    found = os.fstat(file)
    if (found.st_dev, found.st_ino) == (held.device, held.inode):
        return file
    os.close(file)
    return -1


def read_held(file: int, held: m.Held, first: int, rows: FloatArray) -> None:
    """Copy rows out of the ring in which the loop keeps them.

    Parameters
    ----------
    first : int
        Index of the first row.
    rows : ndarray, shape (count, columns)
        C-contiguous; takes them.

    Raises
    ------
    AcquisitionError
        The file is shorter than it was said to be.
    """
    done = 0
    while done < len(rows):
        place = (first + done) % held.capacity
        part = rows[done : done + held.capacity - place].reshape(-1).data.cast("B")
        at = held.offset + place * 8 * held.columns
        while len(part):
            got = os.preadv(file, [part], at)
            if got == 0:
                raise AcquisitionError(
                    f"the recorder's memory ends before row {first + done}: load it again"
                )
            part, at = part[got:], at + got
        done += min(len(rows) - done, held.capacity - place)


class Transfers(Part):
    """Asks about rows of a target's recorder, and loads them."""

    def __init__(self, requests: Requests) -> None:
        super().__init__(requests)
        self._begun: int | None = None  # the recording that this host set up last, by its number

    def _ask(
        self, verb: str, patience: float | None, begun: int | None, **arguments: Any
    ) -> Any:
        """Ask about the rows of a number, past outages of ``patience`` s; None: only once.

        Raises
        ------
        Refused
            The recorder has others: those of this host are gone.
        """
        try:
            if patience is None:
                return self.request(verb, begun=begun, **arguments)
            return self.insist(verb, patience, begun=begun, **arguments)
        except Refused:
            if begun == self._begun:
                self._begun = None
            raise

    def load_rows(
        self,
        first: int,
        count: int,
        columns: int,
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
        begun: int | None = None,
    ) -> FloatArray:
        """Rows of the recorder, shape ``(count, columns)``; the transfer resumes after a broken
        link.

        Parameters
        ----------
        first, count, columns : int
        progress : callable, optional
            Called with the fraction done.
        patience : float, s
        begun : int, optional
            Number of the rows, of `AcquireStatus`. Default: whatever rows there are.

        Raises
        ------
        AcquisitionError
            Some of them are not held, or were overwritten meanwhile.
        Refused
            The recorder has others than those of number ``begun``.
        LinkError
            The target did not come back within ``patience`` s.
        """
        if self.link.own:
            held: m.Held = self._ask("acquire_held", patience, begun)
            file = open_held(held)
            if file >= 0:
                try:
                    data = _read_checked(file, held, first, count, columns, progress)
                finally:
                    os.close(file)
                # what the loop has overwritten by now may have been so while it was read
                now: m.Held = self._ask("acquire_held", patience, begun)
                if (now.device, now.inode) != (held.device, held.inode):
                    raise AcquisitionError(
                        "the recorder was configured again while its rows were loaded: record again"
                    )
                _check_held(now, first, count, columns)
                return data
        return self._load_streamed(first, count, columns, progress, patience, begun)

    def _load_streamed(
        self,
        first: int,
        count: int,
        columns: int,
        progress: Callable[[float], None] | None,
        patience: float,
        begun: int | None,
    ) -> FloatArray:
        rows = Rows(columns, count)
        rows.origin = first
        each = max(1, REQUEST_BYTES // (8 * columns))
        idle = 0  # rounds in a row that brought nothing
        while missing := gaps(rows.pieces, first, count):
            before = rows.count
            start, length = missing[0]
            arguments = {
                "first": start, "count": min(length, each), "chunk": CHUNK_BYTES, "begun": begun,
            }
            try:
                self.link.stream("acquire_read", arguments, rows.take)
            except LinkError:
                idle = idle + 1 if rows.count == before else 0
                if self.link.closed or idle >= MOST_IDLE or not self.link.wait_alive(patience):
                    raise
            if progress is not None:
                progress(rows.count / count)
        return rows.data


def _read_checked(
    file: int,
    held: m.Held,
    first: int,
    count: int,
    columns: int,
    progress: Callable[[float], None] | None,
) -> FloatArray:
    _check_held(held, first, count, columns)
    data: FloatArray = np.empty((count, columns))
    for start, length in spans(0, count, PIECE_BYTES // (8 * columns)):
        read_held(file, held, first + start, data[start : start + length])
        if progress is not None:
            progress((start + length) / count)
    return data


def _check_held(held: m.Held, first: int, count: int, columns: int) -> None:
    if columns != held.columns or first < held.first or first + count > held.count:
        raise AcquisitionError(
            f"rows {first}…{first + count} of {columns} columns are not held; "
            f"the recorder has {held.first}…{held.count} of {held.columns}"
        )
