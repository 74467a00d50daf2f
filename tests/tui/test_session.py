"""Actions that wait for a long one are dropped when it fails or is paused: a minute later nobody
expects a machine to start.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from waiting import until

from zendsp.errors import LinkError, Refused
from zendsp.tui.session import Session
from zendsp.tui.snapshot import LinkState, Snapshot


class Machine:
    """A target that homes until it is paused, or fails at it."""

    here = True

    def __init__(self) -> None:
        self.paused, self.fails, self.started = threading.Event(), threading.Event(), 0

    def snapshot(self) -> Snapshot:
        return Snapshot(link="up", target="arm", state="running")

    def home(self) -> str:
        while not (self.paused.is_set() or self.fails.is_set()):
            time.sleep(0.01)
        raise Refused("homing ended: " + ("by a pause" if self.paused.is_set() else "joint 7"))

    def start(self) -> str:
        self.started += 1
        return "started"

    def close(self) -> None: ...


@pytest.fixture
def desk() -> Iterator[tuple[Session, Machine]]:
    session, machine = Session(lambda _: Machine()), Machine()  # type: ignore[arg-type, return-value]
    session.start()
    session.adopt(machine, "arm")  # type: ignore[arg-type]
    yield session, machine
    machine.fails.set()
    session.close()


def homing(session: Session) -> Any:
    home = session.do("home", lambda port: port.home())  # type: ignore[attr-defined]
    until(lambda: session.busy == "home", "the homing is told")
    return home


def test_actions_that_wait_for_a_homing_are_dropped_when_it_fails(
    desk: tuple[Session, Machine]
) -> None:
    session, machine = desk
    homing(session)
    start = session.do("start", lambda port: port.start())
    assert any("start: waits until home is done" in e.text for e in session.events.since(0)[1])
    machine.fails.set()
    with pytest.raises(Refused, match="since home failed after it was asked: ask again"):
        start.result(5.0)
    assert machine.started == 0
    session.do("start", lambda port: port.start()).result(5.0)  # asked again
    assert machine.started == 1


def test_a_pause_ends_a_homing_and_the_actions_that_wait_for_it(
    desk: tuple[Session, Machine]
) -> None:
    session, machine = desk
    home = homing(session)
    start = session.do("start", lambda port: port.start())
    session.do_first("pause", lambda _: machine.paused.set()).result(5.0)
    with pytest.raises(Refused, match="by a pause"):
        home.result(5.0)
    with pytest.raises(Refused, match="not done, since"):
        start.result(5.0)
    assert machine.started == 0


@pytest.mark.parametrize("here", [True, False])
@pytest.mark.parametrize(
    ("safe", "said"), [(True, "in its safe state"), (False, "NOT in its safe state"), (None, "")]
)
def test_what_a_target_says_of_its_machine_at_its_end_is_shown(
    desk: tuple[Session, Machine], here: bool, safe: bool | None, said: str
) -> None:
    """The command line told it, and the screen did not."""
    session, machine = desk
    ended = threading.Event()

    def snapshot() -> Snapshot:
        if ended.is_set():
            raise LinkError("arm has ended")
        return Snapshot(link=LinkState.UP, target="arm", state="running")

    machine.here, machine.over, machine.snapshot = here, True, snapshot  # type: ignore[method-assign, attr-defined]
    machine.farewell = lambda: safe  # type: ignore[attr-defined]
    until(lambda: session.snapshot.link == LinkState.UP, "the target is shown")
    ended.set()
    until(lambda: session.snapshot.link != LinkState.UP, "its end is shown")
    if said:
        until(lambda: session.snapshot.safe is safe, "what it said is shown")
        words = [e.text for e in session.events.since(0)[1]]
        assert f"arm has ended; as it said, its machine is {said}" in words
    else:
        assert session.snapshot.safe is None
