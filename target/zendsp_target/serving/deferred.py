"""How a handler says that it would have to wait, and the threads that do the waiting."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from zendsp_protocol.errors import Refused

THREADS = 24
SHARE = 8  # of them, of one user
WAITING = 256  # requests of one user


class Later(Exception):
    """Raised by a handler that would have to wait; ``rest`` is the work for another thread."""

    def __init__(self, rest: Callable[[], Any]) -> None:
        self.rest = rest


class Waiters:
    """Threads that finish requests that have to wait. A user with many of them does not hold up
    others.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(THREADS, "waiter")
        self._lock = threading.Lock()
        self._waiting: dict[str, deque[Callable[[], None]]] = {}  # by user
        self._busy: dict[str, int] = {}  # threads

    def submit(self, user: str, work: Callable[[], None]) -> None:
        """Have a thread do the rest of a request.

        Raises
        ------
        Refused
            Too many of this user's wait already.
        """
        with self._lock:
            waiting = self._waiting.setdefault(user, deque())
            if len(waiting) >= WAITING:
                raise Refused(f"{WAITING} requests of this user wait already: wait for some")
            waiting.append(work)
            if self._busy.get(user, 0) < SHARE:
                self._busy[user] = self._busy.get(user, 0) + 1
                self._pool.submit(self._work, user)

    def _work(self, user: str) -> None:
        while True:
            with self._lock:
                if not self._waiting[user]:
                    self._busy[user] -= 1
                    return
                work = self._waiting[user].popleft()
            work()

    def close(self) -> None:
        """Start no further work."""
        with self._lock:
            for waiting in self._waiting.values():
                waiting.clear()
        self._pool.shutdown(wait=False, cancel_futures=True)
