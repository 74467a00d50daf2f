"""Threads that end with the process."""

from __future__ import annotations

import threading
from collections.abc import Callable


def start_thread(name: str, work: Callable[[], None]) -> threading.Thread:
    """Start a thread and return it.

    Raises
    ------
    MemoryError
        The system allows this process no more threads.
    """
    thread = threading.Thread(target=work, name=name, daemon=True)
    try:
        thread.start()
    except RuntimeError as error:  # a new thread can fail to start for no other reason
        raise MemoryError(str(error)) from error
    return thread
