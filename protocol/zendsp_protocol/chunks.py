"""Large arrays in chunks, each with a CRC-32, so that a broken transfer resumes where it stopped."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

CHUNK = 1 << 20  # bytes: measured best for request and reply on loopback, small enough not to hold up a STOP


def crc(data: bytes | memoryview) -> int:
    """CRC-32 as in zlib, gzip and PNG."""
    return zlib.crc32(data)


def spans(first: int, count: int, step: int) -> Iterator[tuple[int, int]]:
    """Cut ``count`` items from ``first`` on into ``(first, count)`` pieces of at most ``step``.

    Examples
    --------
    >>> list(spans(10, 5, 2))
    [(10, 2), (12, 2), (14, 1)]
    """
    step = max(1, step)
    for start in range(first, first + count, step):
        yield start, min(step, first + count - start)


def gaps(have: list[tuple[int, int]], first: int, count: int) -> list[tuple[int, int]]:
    """List what is missing of ``count`` items from ``first`` on, given the ``(first, count)`` pieces received.

    Examples
    --------
    >>> gaps([(0, 3), (5, 2)], 0, 10)
    [(3, 2), (7, 3)]
    """
    missing = []
    place = first
    for start, length in sorted(have):
        if start > place:
            missing.append((place, min(start, first + count) - place))
        place = max(place, start + length)
    if place < first + count:
        missing.append((place, first + count - place))
    return [(start, length) for start, length in missing if length > 0]
