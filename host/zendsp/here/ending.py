"""Signals that end a command. SIGTERM and the closing of the terminal act as Ctrl-C, so that
unfinished work is cleaned up; line and exit status say which of them it was.
"""

from __future__ import annotations

import errno
import os
import signal
from types import FrameType

SOFT = (signal.SIGTERM, signal.SIGHUP)  # which Python by itself would let end a process at once
ENDING = (signal.SIGINT, *SOFT)

_came: list[int] = []  # of SOFT


def end_softly() -> None:
    """Have SIGTERM and the closing of the terminal act as Ctrl-C, unless they are ignored."""
    for number in SOFT:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, interrupt)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Act as Ctrl-C, and remember which signal it was.

    Raises
    ------
    KeyboardInterrupt
        Always.
    """
    if number in SOFT:
        _came.append(number)
    let_go_of_terminal()
    signal.default_int_handler(number, frame)


def let_go_of_terminal() -> bool:
    """Have standard streams whose terminal is gone lead nowhere, and return whether any had: an
    error of writing there would keep a command from saving what it has.
    """
    gone = False
    for stream in (0, 1, 2):
        try:
            os.tcgetpgrp(stream)
        except OSError as error:
            if error.errno == errno.EIO:
                os.dup2(os.open(os.devnull, os.O_RDWR), stream)
                gone = True
    return gone


def ended_by() -> signal.Signals:
    """The signal that ended this process: SIGINT, unless one that acts as it came."""
    return signal.Signals(_came[0]) if _came else signal.SIGINT


def interruption() -> tuple[str, int]:
    """What a command that was interrupted says, and its exit status: that of a shell."""
    number = ended_by()
    words = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
    return words, 128 + number
