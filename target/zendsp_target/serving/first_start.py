"""The first start after a load starts that program, and no other.

Between the load and the start of one host another may load. Without the right to command neither is
refused that, so the first would set a program in motion that it has never seen.
"""

from __future__ import annotations

import threading

from zendsp_protocol.errors import Refused

MOST = 256  # hosts that are remembered: as many as the status names


class FirstStart:
    """Who has loaded a program and not started it, and who replaced that program."""

    def __init__(self) -> None:
        self._waiting: dict[str, str] = {}  # host that loaded: who replaced its program, or ""
        self._lock = threading.Lock()

    def loading(self, by: str) -> None:
        """A load begins: what others loaded is not theirs any more."""
        with self._lock:
            for host, replaced_by in self._waiting.items():
                if host != by and not replaced_by:
                    self._waiting[host] = by

    def failed(self, by: str) -> None:
        """That load failed: the program that was loaded stays, or none is."""
        with self._lock:
            for host, replaced_by in self._waiting.items():
                if replaced_by == by:
                    self._waiting[host] = ""

    def loaded(self, by: str) -> None:
        """That load is done: the next start by this host means this program."""
        with self._lock:
            self._waiting.pop(by, None)
            self._waiting[by] = ""
            while len(self._waiting) > MOST:
                del self._waiting[next(iter(self._waiting))]  # the oldest

    def check(self, by: str) -> None:
        """Refuse a start by a host whose program was replaced; once, since it knows then."""
        with self._lock:
            replaced_by = self._waiting.get(by, "")
            if replaced_by:
                del self._waiting[by]
        if replaced_by:
            raise Refused(
                f"{replaced_by} has loaded a program since you loaded yours: load yours again, or"
                " look at what is loaded now (zendsp info) and start again"
            )

    def started(self, by: str) -> None:
        """It has started its program: from now on it may start whatever is loaded."""
        with self._lock:
            self._waiting.pop(by, None)
