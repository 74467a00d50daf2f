"""Which user of this computer a connection over the loopback belongs to."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections.abc import Iterator


def connections(host: str, port: int) -> Iterator[tuple[int, int]]:
    """Port and user of each connection to an address of this computer (Linux)."""
    packed = socket.inet_aton(host)
    shown = (packed[::-1] if sys.byteorder == "little" else packed).hex().upper()
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError), open(f"/proc/net/{table}", encoding="ascii") as file:
            for fields in map(str.split, list(file)[1:]):
                at, _, number = fields[2].partition(":")
                if at.endswith(shown) and int(number, 16) == port and fields[3] == "01":
                    yield int(fields[1].rpartition(":")[2], 16), int(fields[7])


def is_own(host: str, port: int, peer_port: int) -> bool:
    """Whether the connection from ``peer_port`` is of this user or of root; elsewhere than on Linux
    nobody tells, and all are.
    """
    users = {user for at, user in connections(host, port) if at == peer_port}
    return not sys.platform.startswith("linux") or (bool(users) and users <= {os.getuid(), 0})
