"""Large arrays sent to the target: chunks are checked, kept in order, and applied in one sample
when complete.
"""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zendsp_protocol.chunks import crc
from zendsp_protocol.errors import Refused, VariableError
from zendsp_protocol.values import DTYPES

LARGEST = 1 << 30  # bytes of one upload
PATIENCE_S = 300.0  # an upload that nobody continues is forgotten after this time
MOST = 8  # uploads under way at once


@dataclass
class Upload:
    """One array that is being received."""

    name: str
    dtype: str
    crc: int
    buffer: bytearray
    received: int = 0
    touched: float = field(default_factory=time.monotonic)


class Uploads:
    """All uploads under way; safe from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._open: dict[int, Upload] = {}

    def begin(self, name: str, dtype: str, length: int, checksum: int) -> int:
        """Reserve memory for an array and return the upload's number.

        Raises
        ------
        VariableError
            Unknown dtype or unreasonable length.
        Refused
            Too many uploads under way.
        """
        if dtype not in DTYPES:
            raise VariableError(
                f"{name}: dtype {dtype!r} cannot be uploaded; use one of {', '.join(DTYPES)}"
            )
        size = length * np.dtype(dtype).itemsize
        if not 0 < size <= LARGEST:
            raise VariableError(
                f"{name}: {size} bytes cannot be uploaded; between 1 and {LARGEST} can"
            )
        with self._lock:
            now = time.monotonic()
            self._open = {k: u for k, u in self._open.items() if now - u.touched < PATIENCE_S}
            if len(self._open) >= MOST:
                raise Refused(
                    f"{MOST} uploads are under way already; finish one or wait {PATIENCE_S:g} s"
                )
            number = next(self._numbers)
            self._open[number] = Upload(name, dtype, checksum, bytearray(size))
            return number

    def chunk(self, number: int, offset: int, data: bytes, checksum: int) -> int:
        """Take one chunk and return how many bytes are there without a gap; a repeated chunk does
        no harm.

        Raises
        ------
        Refused
            Unknown upload, a gap, bytes beyond the end, or a checksum that does not fit: send from
            the returned place on.
        """
        with self._lock:
            upload = self._get(number)
            if crc(data) != checksum:
                raise Refused(
                    f"chunk at byte {offset} of {upload.name!r} arrived damaged (CRC-32); send it"
                    " again"
                )
            end = offset + len(data)
            if not 0 <= offset <= upload.received or end > len(upload.buffer):
                raise Refused(
                    f"chunk {offset}…{end} of {upload.name!r} does not follow byte"
                    f" {upload.received} of {len(upload.buffer)}"
                )
            upload.buffer[offset:end] = data
            upload.received = max(upload.received, end)
            upload.touched = time.monotonic()
            return upload.received

    def finish(self, number: int) -> tuple[str, npt.NDArray[np.generic]]:
        """Return name and array of a complete upload, and forget it.

        Raises
        ------
        Refused
            Bytes are missing, or the whole does not match its checksum.
        """
        with self._lock:
            upload = self._get(number)
            if upload.received != len(upload.buffer):
                raise Refused(
                    f"{upload.name!r} is not complete: {upload.received} of {len(upload.buffer)}"
                    " bytes"
                )
            del self._open[number]
        if crc(memoryview(upload.buffer)) != upload.crc:
            raise Refused(
                f"{upload.name!r} arrived damaged (CRC-32 of the whole differs); upload it again"
            )
        return upload.name, np.frombuffer(upload.buffer, dtype=upload.dtype)

    def _get(self, number: int) -> Upload:
        if number not in self._open:
            raise Refused(f"no upload {number} is under way; begin again")
        return self._open[number]
