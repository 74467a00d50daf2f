"""The terminal as a user sees it: `zendsp tui`, or a shell, behind a pseudo-terminal, its screen
read by pyte.
"""

from __future__ import annotations

import fcntl
import os
import pty
import re
import signal
import struct
import termios
import threading
import time
from collections.abc import Sequence

import pyte
from journey import Installed, until


class Screen:
    """`zendsp tui` in a pseudo-terminal, and what it shows.

    Parameters
    ----------
    installed : Installed
    size : tuple of int
        Columns and rows.
    *options : str
        Of the command.
    program : sequence of str
        What to run in its place, with its arguments.
    """

    def __init__(
        self, installed: Installed, size: tuple[int, int], *options: str,
        program: Sequence[str] = (),
    ) -> None:
        self.shown = pyte.Screen(*size)
        self._fed, self._fed_at = 0, time.monotonic()  # pieces that have been read, and when
        self._last, self._unread = b"", ""  # bytes; why no more are read
        self._read: tuple[int, list[str]] = (-1, [])  # rows, after so many
        stream = pyte.ByteStream(self.shown)
        self.status: int | None = None  # of the end
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.chdir(installed.folder)
            command = list(program) or [str(installed.zendsp), "tui", *options, "--frames", "4"]
            os.execve(command[0], command, installed.env)
        self.resize(*size)

        def read() -> None:
            try:
                while data := os.read(self.fd, 1 << 16):
                    # pyte knows no private queries of this kind
                    self._last = (self._last + data)[-2000:]
                    stream.feed(data.replace(b"\x1b[>", b"\x1b["))
                    self._fed += 1
                    self._fed_at = time.monotonic()
            except OSError:
                return
            except Exception as error:
                self._unread = repr(error)
                raise

        threading.Thread(target=read, daemon=True).start()

    def resize(self, columns: int, rows: int) -> None:
        """Let the window have so many."""
        self.shown.resize(rows, columns)
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def rows(self) -> list[str]:
        """All rows as they are now; put together once for each change."""
        fed = self._fed
        if self._read[0] != fed:
            self._read = fed, list(self.shown.display)
        return self._read[1]

    def text(self) -> str:
        """All rows as they are now, as one text."""
        return "\n".join(self.rows())

    def clock(self) -> str:
        """The time of day in the status bar, empty before it is there: it goes on while the screen
        lives.
        """
        found = re.search(r"\d\d:\d\d:\d\d", self.text())
        return found.group() if found else ""

    def keys(self, data: bytes) -> None:
        """Type."""
        os.write(self.fd, data)

    def click(self, text: str) -> None:
        """Press and release the left button on a text, once it stands where it stood a picture
        before: what is still being laid out moves from under the pointer.
        """
        before, place = None, self._place(text)
        while place is None or place != before:
            before, then = place, self.clock()
            until(
                lambda then=then: self.clock() != then and text in self.text(),  # type: ignore[misc]
                f"{text}, and the next picture",
                self.text,
            )
            place = self._place(text)
        at = f"{place[0] + 2};{place[1] + 1}"
        self.keys(f"\x1b[<0;{at}M\x1b[<0;{at}m".encode())

    def _place(self, text: str) -> tuple[int, int] | None:
        found = [(line.index(text), row) for row, line in enumerate(self.rows()) if text in line]
        return found[0] if found else None

    def until(self, what: str) -> None:
        """Wait until the text is on the screen."""
        until(lambda: what in self.text(), f"on the screen: {what}", self._evidence)

    def _evidence(self) -> str:
        """What is on the screen, and how it came there: of a failure that nobody can repeat."""
        silent = time.monotonic() - self._fed_at
        return (
            f"\n{self.text()}\nread for the last time {silent:.1f} s ago {self._unread}"
            f"\n{self._last!r}"
        )

    def ended(self) -> int:
        """Wait until the application has ended by itself; its exit status."""

        def reaped() -> bool:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.status = os.waitstatus_to_exitcode(status)
            return bool(pid)

        until(lambda: self.status is not None or reaped(), "the terminal's end", self.text)
        assert self.status is not None
        return self.status

    def end(self) -> None:
        """Kill it, where it is still there."""
        if self.status is None:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self.fd)
