"""Keeps a host that freezes while rows are sent to it (a laptop whose lid is closed) from delaying
other hosts.

When the lease is over, Zenoh closes the link and has the system wait up to ten seconds for unsent
bytes (SO_LINGER). A thread that serves all hosts would stand still for that time, and a STOP of
another host would wait for it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct

_OFF = struct.pack("ii", 0, 0)


def close_at_once() -> None:
    """Let the close of any TCP connection of this process return at once; the system sends the
    rest. It does nothing where the process has no file descriptor left to look with.
    """
    names: list[str] = []
    with contextlib.suppress(OSError):
        names = os.listdir("/proc/self/fd")
    for name in names:
        with contextlib.suppress(OSError):
            if not stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                continue
            link = socket.socket(fileno=int(name))
            try:
                if link.family in (socket.AF_INET, socket.AF_INET6):
                    link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            finally:
                link.detach()
