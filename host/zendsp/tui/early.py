"""The keys that are typed before the screens are there: the terminal hands them over one by one and
loses none, and they are taken from it at once.

In a terminal's usual mode what is typed waits for the end of its line. Ctrl+C, Ctrl+U and the
closing of the terminal would take an F9 away that nobody had seen. This module loads little, since
it comes first.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import termios
import threading
from collections.abc import Sequence

NOT_HERE = {"--web", "--screenshots", "--help", "-h"}  # with which `zendsp tui` reads no keys


class Early:
    """Takes what is typed, in a thread, until it is asked for.

    Parameters
    ----------
    terminal : int
        File descriptor.
    typed : bytes
        What was typed before that.
    """

    def __init__(self, terminal: int, typed: bytes = b"") -> None:
        self._terminal, self._typed = terminal, typed
        self._enough, self._end = os.pipe()
        self._thread = threading.Thread(target=self._take, name="early-keys", daemon=True)
        self._thread.start()

    def taken(self) -> bytes:
        """All that was typed until now. What comes later is left to others."""
        os.close(self._end)
        self._thread.join()
        os.close(self._enough)
        return self._typed

    def _take(self) -> None:
        with contextlib.suppress(OSError):  # the terminal is gone
            while True:
                ready, _, _ = select.select([self._enough, self._terminal], [], [])
                if self._enough in ready:
                    return
                piece = os.read(self._terminal, 4096)
                if not piece:
                    return
                self._typed += piece


_reading: list[Early] = []


def begin(words: Sequence[str]) -> bool:
    """Begin to take keys, if these are the words of a command that reads them from a terminal;
    return whether they are. The mode of the terminal is given back at the end of this process.
    """
    others = not NOT_HERE.isdisjoint(word.partition("=")[0] for word in words)
    if list(words[:1]) != ["tui"] or others or not os.isatty(1):
        return False
    try:
        before = termios.tcgetattr(0)
        mode = termios.tcgetattr(0)
        mode[0] &= ~(termios.ICRNL | termios.IXON)
        mode[3] &= ~(termios.ICANON | termios.ECHO)
        mode[3] |= termios.NOFLSH  # Ctrl+C takes nothing away
        termios.tcsetattr(0, termios.TCSANOW, mode)
    except termios.error:  # keys come from elsewhere
        return False
    atexit.register(_give_back, before)
    _reading.append(Early(0))
    return True


def has_begun() -> bool:
    """Whether keys are taken from a terminal, which may be gone by now."""
    return bool(_reading)


def taken() -> bytes:
    """What was typed since `begin`, from which on it is left to who asks; nothing without."""
    return _reading.pop().taken() if _reading else b""


def _give_back(mode: list[object]) -> None:
    with contextlib.suppress(termios.error):  # the terminal is gone
        termios.tcsetattr(0, termios.TCSADRAIN, mode)  # type: ignore[arg-type]
