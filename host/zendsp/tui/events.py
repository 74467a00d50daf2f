"""The event log: what happened and when; any thread may read it."""

from __future__ import annotations

import threading
import time
from collections import deque

from zendsp.tui.actions import in_keys
from zendsp.tui.snapshot import Event

KEPT = 2000


class EventLog:
    """The newest events; the number is bounded, so that a day's use does not fill the memory."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._count = 0
        self._lock = threading.Lock()

    def add(self, text: str, level: str = "info") -> None:
        """Add one line; ``level`` is info, good, warning or error."""
        with self._lock:
            self._events.append(Event(time.time(), level, in_keys(text)))
            self._count += 1

    def since(self, count: int) -> tuple[int, list[Event]]:
        """Return the number of events so far and those after the first ``count``."""
        with self._lock:
            fresh = min(self._count - count, len(self._events))
            return self._count, list(self._events)[len(self._events) - fresh :] if fresh > 0 else []
