"""Passes on what a runner and its user code write to standard error."""

from __future__ import annotations

import contextlib
import os
import sys

from zendsp_protocol.texts import shown
from zendsp_target.threads import start_thread

LINE = 4096  # characters at the most


def open_said() -> int:
    """Return the end of a pipe for a runner; lines that come out of it are written to standard
    error, with every character written out that a terminal would obey.

    What nobody takes is lost: a loop never waits for it.
    """
    read, write = os.pipe()
    os.set_blocking(write, False)
    start_thread("said", lambda: _pass_on(read))
    return write


def _pass_on(read: int) -> None:
    with open(read, encoding="utf-8", errors="backslashreplace", newline="\n") as lines:
        while line := lines.readline(LINE):
            with contextlib.suppress(OSError, ValueError):  # nobody listens any more
                sys.stderr.write(f"program: {shown(line.rstrip(chr(10)))}\n")
                sys.stderr.flush()
