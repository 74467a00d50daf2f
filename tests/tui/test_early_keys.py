"""F9 before the screens are there: whatever is typed after it, it stops."""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
import pty
import select
import signal
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import until

from zendsp import Target
from zendsp.tui import early

CALL = "from zendsp.__main__ import main; main()"
F9 = b"\x1b[20~"


class Terminal:
    """`zendsp tui` in a terminal of its own, from its first moment on."""

    def __init__(self, *words: str) -> None:
        self.ours, theirs = pty.openpty()
        self.name, self.mode = os.ttyname(theirs), termios.tcgetattr(theirs)
        self.pid = os.fork()
        if self.pid == 0:
            os.environ["TERM"] = "xterm-256color"
            os.login_tty(theirs)
            os.execv(sys.executable, [sys.executable, "-c", CALL, "tui", *words])
        os.close(theirs)
        self.shown = b""
        until(self.hands_over, "it hands over each key")

    def hands_over(self) -> bool:
        """Whether keys do not wait for the end of a line."""
        return not termios.tcgetattr(self.ours)[3] & termios.ICANON

    def all_taken(self) -> bool:
        """Whether everything that was typed has been read."""
        left = array.array("i", [0])
        theirs = os.open(self.name, os.O_RDWR | os.O_NOCTTY)
        try:
            fcntl.ioctl(theirs, termios.FIONREAD, left)
        finally:
            os.close(theirs)
        return left[0] == 0

    def ended(self) -> bool:
        """Whether it has ended; reads what it shows."""
        done = self.pid == 0 or os.waitpid(self.pid, os.WNOHANG) != (0, 0)
        with contextlib.suppress(OSError):
            while select.select([self.ours], [], [], 0.0)[0]:
                self.shown += os.read(self.ours, 1 << 16)
        return done


@pytest.fixture
def opened(target: Target, tmp_path: Path) -> Iterator[Terminal]:
    target.stop(), target.acknowledge()
    terminal = Terminal(target.name, "--folder", str(tmp_path))
    try:
        yield terminal
    finally:
        if terminal.pid and not terminal.ended():
            os.kill(terminal.pid, signal.SIGKILL)
            os.waitpid(terminal.pid, 0)
        with contextlib.suppress(OSError):
            os.close(terminal.ours)


@pytest.mark.parametrize("then", [b"\x03", b"\x15"], ids=["Ctrl+C", "Ctrl+U"])
def test_f9_stops_before_there_is_a_screen_whatever_is_typed_after_it(
    opened: Terminal, target: Target, then: bytes
) -> None:
    """The terminal dropped it with the line that was being typed."""
    os.write(opened.ours, F9 + then)
    until(lambda: target.status().trip is not None, "it is stopped")
    if then == b"\x03":
        until(opened.ended, "Ctrl+C ends it")
        opened.pid = 0
        assert termios.tcgetattr(opened.ours)[3] == opened.mode[3], "as it was found"
        assert b"stopped" in opened.shown, "it had said nothing but 'interrupted'"


def test_f9_stops_before_there_is_a_screen_though_the_terminal_is_closed(
    opened: Terminal, target: Target
) -> None:
    """What waits in a terminal is gone with it."""
    os.write(opened.ours, F9)
    children = Path(f"/proc/{opened.pid}/task/{opened.pid}/children")
    until(children.read_text, "STOP has a process of its own")
    until(opened.all_taken, "it is taken at once")
    os.close(opened.ours)
    until(lambda: target.status().trip is not None, "it is stopped")
    until(opened.ended, "it ends with its terminal")
    opened.pid = 0


def test_what_is_typed_early_is_taken_once_and_the_rest_is_left() -> None:
    ours, theirs = os.pipe()
    keys = early.Early(ours, b"a")
    os.write(theirs, b"b")
    until(lambda: keys._typed == b"ab", "it is taken")
    assert keys.taken() == b"ab"
    os.write(theirs, b"c")
    assert os.read(ours, 9) == b"c"
    os.close(ours), os.close(theirs)


@pytest.mark.parametrize("words", [["stop"], ["tui", "--web"], ["tui", "--help"], ["tui"]])
def test_no_terminal_is_touched_by_what_reads_no_keys(words: list[str]) -> None:
    assert not early.begin(words) and early.taken() == b""  # these tests have no terminal
