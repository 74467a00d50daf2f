"""An author who sends many requests delays only his own."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import pytest
import zenoh

from zendsp_protocol import keys
from zendsp_protocol.once import FIRST, stamp
from zendsp_target.serving.turns import SHARE, WAITING, Turns, asker


class Request:
    def __init__(self, who: str, number: int) -> None:
        self.who, self.number, self.dropped = who, number, False

    def drop(self) -> None:
        self.dropped = True


class Waiting(deque[Request]):
    def try_recv(self) -> Request | None:
        return self.popleft() if self else None

    def recv(self) -> Request:
        return self.popleft()


@pytest.fixture
def waiting() -> Waiting:
    return Waiting()


@pytest.fixture
def turns(waiting: Waiting) -> Turns:
    return Turns(waiting, lambda query: query.who)


def test_whoever_floods_is_answered_no_oftener_than_others(
    turns: Turns, waiting: Waiting
) -> None:
    waiting += [Request("mallory", k) for k in range(100)] + [Request("anna", 0)]
    assert [turns.next().who for _ in range(3)] == ["mallory", "anna", "mallory"]


def test_requests_of_one_stay_in_order(turns: Turns, waiting: Waiting) -> None:
    waiting += [Request("anna", k) for k in range(10)]
    assert [turns.next().number for _ in range(10)] == list(range(10))


def test_nobody_takes_what_one_who_sleeps_would_be_woken_for(waiting: Waiting) -> None:
    """Otherwise it would wait for the busy thread, which may take long."""
    answered: list[Request] = []

    def recv() -> Request:
        if not answered:
            waiting.extend(Request("anna", k) for k in range(3))
            answered.append(waiting.popleft())
            answered.append(turns.next())  # another thread, meanwhile
        return waiting.popleft()

    waiting.recv = recv  # type: ignore[method-assign]
    turns = Turns(waiting, lambda query: query.who)
    assert turns.next().number == 2 and [query.number for query in answered] == [0, 1]


@dataclass
class Asked:
    key_expr: str
    attachment: Any = None


def test_those_who_ask_are_told_apart() -> None:
    anna, bob = (Asked(keys.rpc("imi", "sync", name)) for name in ("anna", "bob"))
    assert [asker(anna), asker(bob)] == ["anna", "bob"]
    stamps = (stamp(bytes([k]) * 8, 5, bytes(8), FIRST) for k in (1, 2))
    own = [Asked(keys.rpc("imi", "sync"), zenoh.ZBytes(data)) for data in stamps]
    assert len({asker(query) for query in own}) == 2, "connections of the target's own user"
    assert asker(Asked(keys.rpc("imi", "sync"))) == ""


def test_a_flood_that_never_ends_is_answered_meanwhile(turns: Turns, waiting: Waiting) -> None:
    def flood() -> Request:
        assert len(came) < 10 * WAITING, "it is taken in for ever"
        came.append(Request("mallory", len(came)))
        return came[-1]

    came: list[Request] = []
    waiting.try_recv = flood  # type: ignore[method-assign]
    assert turns.next() is came[0]


def test_of_too_many_requests_of_one_author_the_oldest_are_dropped(
    turns: Turns, waiting: Waiting
) -> None:
    anna = Request("anna", 0)
    flood = [Request("mallory", k) for k in range(2 * SHARE)]
    waiting += [anna, *flood]
    assert turns.next() is anna
    while waiting:
        turns.next()
    dropped = [query.number for query in flood if query.dropped]
    assert dropped and max(dropped) < 2 * SHARE - 1, "the newest is kept"
    assert not anna.dropped


def test_endless_author_names_take_bounded_memory(turns: Turns, waiting: Waiting) -> None:
    flood = [Request(f"mallory {k}", k) for k in range(2 * WAITING)]
    waiting += flood
    answered = 0
    while waiting:
        turns.next()
        answered += 1
    assert sum(not query.dropped for query in flood) <= WAITING + answered
    waiting.append(last := Request("anna", 0))
    left = [turns.next() for _ in range(sum(not query.dropped for query in flood) - answered)]
    assert turns.next() is last and not set(left) & {last}, "and what was answered makes room"


def test_when_the_queue_is_full_the_author_with_most_requests_loses_one(
    turns: Turns, waiting: Waiting
) -> None:
    """A newcomer's requests had been dropped again and again, while others had a hundred each."""
    floods = [Request(f"mallory {k % 5}", k) for k in range(5 * SHARE - 1)]
    waiting += [*floods, anna := Request("anna", 0)]
    while waiting:
        turns.next()
    assert not anna.dropped and any(query.dropped for query in floods)
    assert anna in [turns.next() for _ in range(6)], "her turn comes like any other"
