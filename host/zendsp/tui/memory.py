"""One heap for all threads of a program that is left open all day.

glibc gives nearly every thread a heap of its own, and each stays as large as its fullest moment:
memory that nobody uses piles up with the threads of the link, in steps, over hours. With one heap
what one thread frees the next one takes.
"""

from __future__ import annotations

import ctypes

ARENA_MAX, MMAP_THRESHOLD, TRIM_THRESHOLD = -8, -3, -1  # M_… of malloc.h
# bytes: larger blocks are pages of their own, which go back when they are freed (glibc would raise
# this as it goes)
BLOCK = 128 << 10


def keep_one_heap() -> bool:
    """Ask glibc for one heap; call before threads start. False where the C library is another one,
    and all stays as it is.
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
