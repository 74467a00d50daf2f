"""The queue of requests: those who ask take turns, however many requests one of them sends."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from zendsp_protocol import keys

WAITING = 1024  # requests that may wait in a lane, and of them
SHARE = 256  # of one who asks


def asker(query: Any) -> str | bytes:
    """Who asks: a user who is known by name; of the target's own user, a connection where the
    request names it.
    """
    user = keys.user_of(str(query.key_expr))
    if user or query.attachment is None:
        return user
    connection: bytes = query.attachment.to_bytes()[:8]
    return connection


class Turns:
    """The requests that a lane has still to answer; safe from any thread.

    What does not fit is dropped, and its sender asks again. Holding the sender back instead would
    block the few threads in which Zenoh receives, and STOP with them. Of an asker with too many
    requests the oldest is dropped; where all together have too many, the oldest of whoever has
    most.

    Parameters
    ----------
    waiting : zenoh.handlers.Handler
        Where they come in, all in one row.
    """

    def __init__(self, waiting: Any, who: Callable[[Any], str | bytes] = asker) -> None:
        self._waiting, self._who = waiting, who
        self._lock = threading.Lock()
        self._of: dict[str | bytes, deque[Any]] = {}  # by asker, in the order of their turns
        self._count = 0
        # an item for each thread that waits in Zenoh's queue itself; list methods need no lock
        self._asleep: list[None] = []

    def next(self) -> Any:
        """Wait for a request and return it.

        Raises
        ------
        zenoh.ZError
            There will be none any more.
        """
        with self._lock:
            for _ in range(0 if self._asleep else SHARE):  # more may come in meanwhile
                query = self._waiting.try_recv()
                if query is None:
                    break
                self._enter(query)
            for who, queue in self._of.items():
                query = queue.popleft()
                del self._of[who]
                if queue:
                    self._of[who] = queue  # its next turn comes last
                self._count -= 1
                return query
            self._asleep.append(None)
        try:
            return self._waiting.recv()
        finally:
            self._asleep.pop()

    def _enter(self, query: Any) -> None:
        who = self._who(query)
        queue = self._of.get(who)
        if queue is not None and len(queue) >= SHARE:
            queue.popleft().drop()
        elif self._count >= WAITING:  # whoever has most loses one
            longest = max(self._of.values(), key=len)
            if len(longest) == 1:
                query.drop()
                return
            longest.popleft().drop()
        else:
            self._count += 1
        self._of.setdefault(who, deque()).append(query)
