"""Makes all threads of a program share one heap, for a program that is left open all day.

glibc gives nearly every thread a heap of its own, and each heap keeps the size of its fullest
moment. Over hours, unused memory accumulates with the threads of the link. In a shared heap, memory
that one thread frees is used by the next.
"""

from __future__ import annotations

import ctypes

ARENA_MAX, MMAP_THRESHOLD, TRIM_THRESHOLD = -8, -3, -1  # M_… of malloc.h
# bytes: larger blocks are pages of their own, which go back when they are freed (glibc would raise
# this as it goes)
BLOCK = 128 << 10


def keep_one_heap() -> bool:
    """Ask glibc for one heap, before threads are started. Returns False where the C library is
    another one; nothing changes then.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    options = ((ARENA_MAX, 1), (MMAP_THRESHOLD, BLOCK), (TRIM_THRESHOLD, 2 * BLOCK))
    accepted = [
        mallopt(ctypes.c_int(option), ctypes.c_int(value)) == 1 for option, value in options
    ]
    return all(accepted)
