"""Open files of a target: none is left open, and without one left it still answers."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable

import pytest
import zenoh
from waiting import until

import zendsp
from zendsp.errors import Refused
from zendsp.link import Target
from zendsp.link.settings import Credentials, zenoh_config


def test_connecting_again_and_again_leaves_nothing_open(fast: Target) -> None:
    def files(pid: int) -> int:
        return len(os.listdir(f"/proc/{pid}/fd"))

    def connect_often() -> None:
        for _ in range(10):
            with zendsp.connect(fast.name) as host:
                host.status()

    connect_often()  # what is opened once and kept is no leak
    before = files(os.getpid()), files(fast.info.pid)
    connect_often()
    until(
        lambda: files(os.getpid()) <= before[0] + 2 and files(fast.info.pid) <= before[1] + 2,
        "files are closed again",
    )


def test_a_target_may_open_as_many_files_as_the_system_allows(start: Callable[..., Target]) -> None:
    """Each connection takes one, also of a client that is refused."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, most[1]))
    try:
        target = start(clock="fast")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, most)
    files = resource.prlimit(target.info.pid, resource.RLIMIT_NOFILE)
    assert files == (most[1], most[1])


def test_a_target_without_a_file_left_goes_on_to_tell_its_status(fast: Target) -> None:
    fast.download("pd.c")
    pid, told = fast.info.pid, list[object]()
    most = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    with zenoh.open(zenoh_config(fast.link.endpoints, Credentials(), 3.0)) as session:
        session.declare_subscriber("zendsp/*/event", told.append)
        until(lambda: len(told) > 0, "its status")
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, most[1]))
        try:
            with pytest.raises(Refused, match="Too many open files"):
                fast.live(["q"])
            before = len(told)
            until(lambda: len(told) > before + 3, "its status, twice a second")
        finally:
            resource.prlimit(pid, resource.RLIMIT_NOFILE, most)
