"""A user with many waiting requests does not delay others."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from waiting import PATIENCE_S

from zendsp_protocol.errors import Refused
from zendsp_target.serving.deferred import SHARE, WAITING, Waiters


@pytest.fixture
def waiters() -> Iterator[Waiters]:
    waiters = Waiters()
    yield waiters
    waiters.close()


def test_the_rest_of_one_user_waits_for_none_of_anothers(waiters: Waiters) -> None:
    sample, done = threading.Event(), threading.Event()

    def wait() -> None:
        sample.wait(PATIENCE_S)

    try:
        for _ in range(WAITING):
            waiters.submit("mallory", wait)
        waiters.submit("anna", done.set)
        assert done.wait(PATIENCE_S / 2), "while all of mallory's wait"
        with pytest.raises(Refused, match="256 requests of this user wait already"):
            for _ in range(SHARE + 1):
                waiters.submit("mallory", done.clear)
    finally:
        sample.set()


def test_all_waiting_requests_of_one_user_are_done(waiters: Waiters) -> None:
    left = threading.Barrier(SHARE + 1)

    def wait() -> None:
        left.wait(PATIENCE_S)

    for _ in range(100):
        waiters.submit("", lambda: None)
    for _ in range(SHARE):
        waiters.submit("", wait)
    wait()  # all that came before are done, or so many could not wait here
