"""What brings a machine to rest is not ended half-way by a Ctrl-C that is pressed again."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from zendsp.here.ending import ENDING, interrupt

PATIENCE_S = 5.0  # then Ctrl-C ends the block too: a link that hangs is left at last


@contextmanager
def uninterrupted() -> Iterator[None]:
    """A block that stops a machine and keeps what it did, after whatever ended its motion: signals
    that would interrupt it are dropped for 5 s. Who presses Ctrl-C again wants what it does.

    Examples
    --------
    >>> import os
    >>> with uninterrupted():
    ...     os.kill(os.getpid(), signal.SIGINT)
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals come to the main thread alone
        return
    end = time.monotonic() + PATIENCE_S

    def dropped(number: int, frame: FrameType | None) -> None:
        if time.monotonic() >= end:
            interrupt(number, frame)

    acting = (signal.default_int_handler, interrupt)
    ours = {n: now for n in ENDING if (now := signal.getsignal(n)) in acting}
    for number in ours:
        signal.signal(number, dropped)
    try:
        yield
    finally:
        for number, before in ours.items():
            signal.signal(number, before)
