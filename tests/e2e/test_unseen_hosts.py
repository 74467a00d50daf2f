"""A host whose loss would not be noticed cannot command: its machine would move on for good."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import pytest
from helpers import kill, python
from waiting import until

import zendsp
from zendsp.errors import Refused
from zendsp.link import Target
from zendsp_protocol import keys
from zendsp_target.access.hosts import MOST_HOSTS
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.drives import Drives
from zendsp_target.serving.guard import Guard

COMMANDS: dict[str, Callable[[Target], object]] = {
    "take": lambda t: t.take_command(),
    "power": lambda t: t.power_on(),
    "enable": lambda t: t.enable(),
    "home": lambda t: t.home(),
    "attends": lambda t: t.start(attended=True),
    "run": lambda t: t.request("run_begin", names=["Kp1"], moves=True),
}


@pytest.fixture
def target(start: Callable[..., Target]) -> Target:
    """A target whose program stands still."""
    target = start(clock="real", options=["--no-realtime"])
    target.download("pd.c")
    return target


@pytest.mark.parametrize("how", COMMANDS)
def test_who_shows_no_token_commands_nothing(target: Target, how: str) -> None:
    with zendsp.connect(target.name, shown=False) as hidden:
        with pytest.raises(Refused, match="would be lost unnoticed"):
            COMMANDS[how](hidden)
        status = target.drive_status()
        assert status.commander == status.moved_by == ""
        assert target.status().state == "loaded"
        hidden.start()  # as one who need not stay
        hidden.stop()


def test_a_liveliness_token_that_comes_a_moment_later_is_waited_for(target: Target) -> None:
    with zendsp.connect(target.name, shown=False) as late:
        token: list[object] = []
        liveliness = late.link.session.liveliness()
        key = keys.host(target.name, late.link.author)
        show = threading.Timer(0.2, lambda: token.append(liveliness.declare_token(key)))
        show.start()
        late.take_command()
        assert target.drive_status().commander == late.link.author
        show.join()
    until(lambda: target.drive_status().commander == "", "it is lost, and free")


def test_of_more_hosts_than_are_seen_none_commands_unseen(target: Target) -> None:
    """For example connections that a notebook left open, cell after cell."""
    crowd = python(
        "import sys, zendsp\n"
        f"open = [zendsp.connect(sys.argv[1]) for _ in range({MOST_HOSTS})]\n"
        "print('there', flush=True); sys.stdin.read()\n",
        target.name,
    )
    assert crowd.stdout is not None and crowd.stdout.readline() == "there\n"
    try:
        with zendsp.connect(target.name) as late:
            assert late.link.author not in target.status().hosts
            with pytest.raises(Refused, match="close other connections"):
                late.take_command()
            kill(crowd)
            until(lambda: len(target.status().hosts) < MOST_HOSTS, "there is room again")
        with zendsp.connect(target.name) as again:
            again.take_command()
    finally:
        kill(crowd)


def test_who_is_lost_while_the_right_is_passed_to_it_does_not_keep_it() -> None:
    """The loss is reported after the check and before the host gets the right."""
    runtime = cast(RuntimeApi, SimpleNamespace(cancel=lambda whose: None))
    drives, seen = Drives(runtime), [True, False]
    guard = Guard(drives)
    guard.sees = lambda host: seen.pop(0) if seen else False
    lost: list[str] = []
    guard.lost = lost.append
    assert guard.watched("a@b:1", lambda: drives.take("a@b:1", False))
    assert lost == ["a@b:1"]
