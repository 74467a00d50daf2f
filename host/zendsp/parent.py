"""A process that ends with the one that started it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1  # <sys/prctl.h>


def die_with(parent: int) -> None:
    """Have the kernel end this process when `parent` ends, however that ends (Linux; elsewhere
    nothing happens).

    Parameters
    ----------
    parent : int
        Process id that this process was started by.
    """
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the kernel was told
        os._exit(1)


def call(parent: int) -> str:
    """Return Python code that is ``zendsp`` and ends with `parent`."""
    return (
        f"from zendsp.parent import die_with; die_with({parent}); from zendsp.__main__ import"
        " main; main()"
    )
