"""The file in shared memory by which a program of the target's own user stops it, with nothing in
between.

32 bytes in the byte order of the machine: ``magic`` and ``version`` (uint32), ``stop`` (uint32, at
8), 4 bytes unused, ``sample`` and ``taken`` (uint64, at 16 and 24). Whoever wants STOP reads
``taken``, writes 1 into the byte at ``STOP``, and knows once ``taken`` has changed that the machine
has its safe outputs; ``sample`` says since when.
"""

from __future__ import annotations

NAME = "stop"
MAGIC = 0x5A445350
VERSION = 2  # STOP_PAGE_VERSION of the runtime
HEAD = "=II"
SIZE = 32
STOP = 8
SAMPLE = 16
TAKEN = 24
