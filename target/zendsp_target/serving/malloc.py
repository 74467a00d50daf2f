"""Keeps the memory of large messages for the next ones."""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h


def keep_large_buffers() -> None:
    """Tell glibc not to give buffers of up to 32 MiB back to the kernel after each use.

    Otherwise every chunk of a transfer comes in fresh pages, and faulting them in costs more than
    filling them (measured: a third of the time of loading a recording). Other C libraries have no
    such setting and are left alone.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, 32 << 20)
        mallopt(M_TRIM_THRESHOLD, 64 << 20)
