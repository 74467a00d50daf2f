"""Threads that work for links, and the closing of all links when the process ends."""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any, Protocol

import zenoh


class Connected(Protocol):
    """A connection that must be closed before the process ends."""

    def close(self) -> None:
        """End the connection."""

    def disown(self) -> None:
        """Forget the connection in a child of fork(): it belongs to the parent."""


open_links: weakref.WeakSet[Connected] = weakref.WeakSet()
_background: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
END_S = 1.0  # for saying goodbye when the process ends


def background(name: str, work: Callable[..., object], *arguments: object) -> threading.Thread:
    """A daemon thread that does ``work``. The end of the process waits for it for a short time.

    While the interpreter shuts down, Python ends a thread that returns from Zenoh by unwinding its
    stack, upon which Rust aborts the whole process ("FATAL: exception not rethrown"). Therefore the
    links are closed first, which ends every wait in Zenoh, and these threads are given the time to
    return.
    """
    thread = threading.Thread(target=work, args=arguments, name=name, daemon=True)
    _background.add(thread)
    thread.start()
    return thread


class Listener:
    """Calls ``take`` with each sample of a subscriber, in a thread for which the end of the process
    does not wait.

    For a Python callback Zenoh starts a thread that Python joins before it runs functions
    registered with ``atexit``: a script that does not close its session would never end.
    """

    def __init__(
        self, subscriber: zenoh.Subscriber[Any], take: Callable[[zenoh.Sample], None], name: str
    ) -> None:
        self._subscriber = subscriber
        background(name, _pull, subscriber.handler, take)

    def undeclare(self) -> None:
        """End the subscription."""
        with contextlib.suppress(zenoh.ZError):  # gone with its session, as after an outage
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]


def _pull(samples: Any, take: Callable[[zenoh.Sample], None]) -> None:
    while True:
        try:
            sample = samples.recv()
        except zenoh.ZError:  # undeclared, or its session is closed
            return
        try:
            take(sample)
        except Exception:  # of a user's callback; the next sample may fare better
            sys.excepthook(*sys.exc_info())


@atexit.register
def _close_all() -> None:
    """Close every connection. A target that cannot be told so (a frozen one) notices within the
    lease.
    """
    for link in list(open_links):
        background("closing", link.close)
    deadline = time.monotonic() + END_S
    for thread in list(_background):
        if thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))


def _disown_all() -> None:
    for link in list(open_links):
        link.disown()
    open_links.clear()
    _background.clear()


os.register_at_fork(after_in_child=_disown_all)
