"""A target belongs to the process that connected: another is told so at once, and never waits."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable

import pytest

import zendsp
from zendsp.errors import LinkError
from zendsp.link import Target

HANGS_S = 20  # after which a child that waits for threads that it does not have is ended


def in_fork(work: Callable[[], object]) -> str:
    """The outcome of `work` in a forked child."""
    out, into = os.pipe()
    pid = os.fork()
    if pid == 0:
        signal.alarm(HANGS_S)
        try:
            said = repr(work())
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        os.write(into, said.encode())
        os._exit(0)
    os.close(into)
    os.waitpid(pid, 0)
    with os.fdopen(out) as said_there:
        return said_there.read()


def test_a_forked_child_is_told_that_the_connection_is_not_its_own(running: Target) -> None:
    assert running.status().state == "running"  # a request that was made ready
    for work in (running.status, lambda: running["Kp"], lambda: running.update(Kp=1.0)):
        assert in_fork(work).startswith("LinkError") and "forked from" in in_fork(work)
    assert "'spawn'" in in_fork(lambda: zendsp.connect("fake"))
    assert in_fork(running.close) == "None"
    assert running.alive and running.status().state == "running", "the parent goes on"


def test_a_target_is_not_pickled(target: Target) -> None:
    with pytest.raises(TypeError, match="hand its name on, and connect"):
        pickle.dumps(target)
    with pytest.raises(LinkError, match="no target named"):
        zendsp.connect("another")
