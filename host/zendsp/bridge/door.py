"""Decides who may use the port of a viewer: the viewer's protocol knows no users, and any web page
may ask for it.

On the loopback the system tells to whom a connection belongs, and a browser says which page asks.
Other users and foreign pages are refused. All others are passed on to the server, whose own address
is random.
"""

from __future__ import annotations

import contextlib
import re
import secrets
import socket
import struct
import sys
import threading
from urllib.parse import urlsplit

from zendsp.here.loopback import connections, is_own
from zendsp.link.background import background

HOST = "127.0.0.1"
LONGEST_HEAD = 16_000  # bytes of a request
HEAD_S = 5.0  # for it to come
PART = 1 << 16  # bytes handed on at once
OWN_PAGES = ("localhost", "127.0.0.1", "::1")
VIEWER = ".foxglove.dev"  # its pages in the web
# what Lichtblick and viewers of before 2025 call the protocol; the server knows the new name only
FORMER, NAMED = b"foxglove.websocket.v1", b"foxglove.sdk.v1"
_ORIGIN = re.compile(rb"^origin:[ \t]*([^\r\n]*?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_REFUSED = b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


def drawn_host() -> str:
    """An address of the loopback that no page can guess; only Linux answers at all of them."""
    if not sys.platform.startswith("linux"):
        return HOST
    return "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))


def welcome(origin: str) -> bool:
    """Whether a page may connect: one of this computer, or the viewer's own. A program names no
    page, or a file; ``null`` is any page that hides its origin.
    """
    try:
        found = urlsplit(origin)
        name = found.hostname or ""
    except ValueError:
        return False
    if found.scheme in ("http", "https"):
        return name in OWN_PAGES or (found.scheme == "https" and name.endswith(VIEWER))
    return origin == "" or found.scheme == "file"


class Door:
    """Lets viewers of this user, and of root, connect to a server.

    Parameters
    ----------
    port : int
        On the loopback; 0 takes a free one.
    behind : tuple of str and int
        Address of the server.

    Raises
    ------
    OSError
        The port is taken.
    """

    def __init__(self, port: int, behind: tuple[str, int]) -> None:
        self.behind = behind
        self._inside: set[int] = set()  # ports of the connections to the server
        self._lock = threading.Lock()
        self._listener = socket.create_server((HOST, port))
        self.port: int = self._listener.getsockname()[1]
        background("bridge-door", self._open)

    def close(self) -> None:
        """Accept no further connections."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def alone(self) -> bool:
        """Whether every connection to the server came through this door."""
        with self._lock:
            inside = set(self._inside)
        return all(port in inside for port, _ in connections(*self.behind))

    def _open(self) -> None:
        while True:
            try:
                link, (_, port) = self._listener.accept()
            except OSError:  # closed
                return
            background("bridge-viewer", self._admit, link, port)

    def _admit(self, link: socket.socket, port: int) -> None:
        with link, contextlib.suppress(OSError):
            if not is_own(HOST, self.port, port):
                return
            link.settimeout(HEAD_S)
            head = _head(link)
            if not head:
                return
            pages = _ORIGIN.findall(head.partition(b"\r\n\r\n")[0])
            if not all(welcome(page.decode(errors="replace")) for page in pages):
                link.sendall(_REFUSED)
                return
            link.settimeout(None)
            self._hand_on(link, head)

    def _hand_on(self, link: socket.socket, head: bytes) -> None:
        with socket.socket() as server:
            server.bind((HOST, 0))
            own = server.getsockname()[1]
            with self._lock:
                self._inside.add(own)
            try:
                server.connect(self.behind)
                for end in (link, server):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, struct.pack("i", 1))
                former = FORMER in head and NAMED not in head
                server.sendall(head.replace(FORMER, NAMED) if former else head)
                if former:  # what is said under either name is the same
                    link.sendall(_head(server).replace(NAMED, FORMER, 1))
                back = background("bridge-back", _pour, server, link)
                _pour(link, server)
                back.join()
            finally:
                with self._lock:
                    self._inside.discard(own)


def _head(source: socket.socket) -> bytes:
    """The head of a request or of an answer, and the bytes right behind it; empty where there is
    none.
    """
    head = b""
    while b"\r\n\r\n" not in head:
        part = source.recv(PART)
        head += part
        if not part or len(head) > LONGEST_HEAD:
            return b""
    return head


def _pour(source: socket.socket, into: socket.socket) -> None:
    """Pass on bytes until one of both ends."""
    with contextlib.suppress(OSError):
        while part := source.recv(PART):
            into.sendall(part)
    for end in (source, into):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
