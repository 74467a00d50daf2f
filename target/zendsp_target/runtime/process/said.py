"""Passes on what a runner and its user code write to standard error."""

from __future__ import annotations

import contextlib
import os
import sys

from zendsp_protocol.texts import shown
from zendsp_target.threads import start_thread

LINE = 4096  # characters at the most


def open_said() -> int:
    """Return the writing end of a pipe for a runner. Its lines are written to this process's
    standard error, with control characters spelled out so that no terminal obeys them.

    What does not fit into the pipe is lost: a loop never waits for a reader.
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
