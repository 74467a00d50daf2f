"""The file in shared memory by which a program of the target's own user stops it, with nothing in
between.

128 bytes in the byte order of the machine: ``magic`` and ``version`` (uint32), ``stop`` (uint32, at
8), 4 bytes of the target's own, ``sample`` and ``taken`` (uint64, at 16 and 24), ``by`` (88 bytes
of UTF-8, at 32: who asks and when, ended by 0), ``reason`` (uint32, at 120), 4 bytes unused.
Whoever wants STOP writes ``by`` and 0 into ``reason``, reads ``taken``, writes 1 into the byte at
``STOP``, and knows once ``taken`` has changed that the machine has its safe outputs; ``sample``
says since when, and ``reason`` whether a STOP is what is latched (1) or a trip that came before it
(greater).
"""

from __future__ import annotations

import time

NAME = "stop"
MAGIC = 0x5A445350
VERSION = 3  # STOP_PAGE_VERSION of the runtime
HEAD = "=II"
SIZE = 128
STOP = 8
SAMPLE = 16
TAKEN = 24
BY = 32
REASON = 120
BY_STOP = 1  # TRIP_STOP of the runtime


def signed(author: str) -> bytes:
    """The content of ``by`` for somebody who asks now: author, as in a request, and local time."""
    text = f"{author} at {time.strftime('%H:%M:%S')}" if author else ""
    return text.encode()[: REASON - BY - 1].ljust(REASON - BY, b"\0")


def signature(by: bytes) -> str:
    """The text that `signed` made, in printable characters."""
    text = by.partition(b"\0")[0].decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in text)
