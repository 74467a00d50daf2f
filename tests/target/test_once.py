"""A request that changes something is carried out once, however often and in whatever order it
arrives.
"""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from zendsp_protocol import codec
from zendsp_protocol.errors import LinkError, NotApplied
from zendsp_protocol.once import AGAIN, FIRST, SETTLE, stamp
from zendsp_protocol.verbs import VERBS
from zendsp_target.serving.request_log import LINKS, QUIET_S, RESULTS, Once

LINK = b"a-link-0"
YES = codec.encode_result({})


def result(reply: bytes | None) -> Any:
    assert reply is not None
    return codec.decode_reply(reply, Any)


def sent(once: Once, number: int, attempt: int = FIRST, link: bytes = LINK) -> bytes:
    return stamp(link, number, once.instance, attempt)


def test_what_was_carried_out_is_answered_from_memory() -> None:
    once = Once()
    new, reply = once.begin(sent(once, 1), None)
    assert new is not None and reply is None
    assert once.finish(new, bytearray(YES)) == []
    for attempt in (AGAIN, SETTLE, FIRST):  # the first may arrive last
        assert once.begin(sent(once, 1, attempt), None) == (None, YES)


def test_a_retry_during_the_work_gets_the_same_reply() -> None:
    once = Once()
    new, _ = once.begin(sent(once, 1), "first")
    assert once.begin(sent(once, 1, AGAIN), "second") == (None, None)
    assert new is not None and once.finish(new, YES) == ["second"]


def test_a_request_that_did_not_arrive_is_carried_out_at_its_retry() -> None:
    once = Once()
    new, _ = once.begin(sent(once, 7, AGAIN), None)
    assert new is not None and new == ("", LINK, 7)


def test_what_was_settled_as_not_applied_is_never_applied() -> None:
    once = Once()
    new, reply = once.begin(sent(once, 1, SETTLE), None)
    assert new is None
    with pytest.raises(NotApplied, match="not applied, and will not be"):
        result(reply)
    assert once.begin(sent(once, 1), None) == (None, reply)  # late


def test_a_target_that_was_started_again_says_so_and_does_nothing() -> None:
    before, now = Once(), Once()
    assert before.instance != now.instance
    for attempt in (AGAIN, SETTLE):
        new, reply = now.begin(sent(before, 1, attempt), None)
        assert new is None
        with pytest.raises(LinkError, match=r"started again.*cannot be known"):
            result(reply)
    new, _ = now.begin(sent(before, 2), None)  # a new request of a host that came back by itself
    assert new is not None


def test_kept_replies_are_bounded_and_a_dropped_request_is_not_repeated() -> None:
    once = Once()
    for number in range(1, RESULTS + 11):
        new, _ = once.begin(sent(once, number), None)
        assert new is not None
        once.finish(new, YES)
    assert once.begin(sent(once, 11, AGAIN), None) == (None, YES)
    new, reply = once.begin(sent(once, 10, AGAIN), None)
    assert new is None
    with pytest.raises(LinkError, match="too old"):
        result(reply)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def crowd(once: Once, count: int, user: str = "") -> None:
    """So many connections, each with one request that was answered."""
    for k in range(count):
        new, _ = once.begin(sent(once, 1, link=k.to_bytes(8, "big")), None, user)
        if new is not None:
            once.finish(new, YES)


def test_a_connection_is_forgotten_when_its_host_has_given_up_and_not_before() -> None:
    clock = Clock()
    once = Once(clock)
    crowd(once, 10)
    slow, _ = once.begin(sent(once, 1), None)
    assert slow is not None
    clock.now = QUIET_S - 1.0
    crowd(once, 1, "anna")
    assert once.begin(sent(once, 1, AGAIN, (3).to_bytes(8, "big")), None) == (None, YES)
    clock.now += 2.0
    once.begin(sent(once, 1, link=b"new-link"), None)
    # one has work under way, one asked again
    assert set(once.remembered()) == {LINK, b"new-link", (3).to_bytes(8, "big")}
    assert once.finish(slow, YES) == [] and once.begin(sent(once, 1, AGAIN), None) == (None, YES)


def test_who_opens_connections_without_end_breaks_no_retry_of_anybody_else_and_none_is_done_twice() -> (  # noqa: E501
    None
):
    clock = Clock()
    once = Once(clock)
    busy, _ = once.begin(sent(once, 1), None, "anna")
    crowd(once, 3, "anna")
    crowd(once, 5000, "mallory")
    assert len(once.remembered("mallory")) == LINKS and len(once.remembered("anna")) == 4
    assert busy is not None and once.finish(busy, YES) == []
    assert once.begin(sent(once, 1, AGAIN), None, "anna") == (None, YES)
    # Mallory's own first connection was dropped: whether its request was done is not known any
    # more, so it is not done again.
    new, reply = once.begin(sent(once, 1, AGAIN, bytes(8)), None, "mallory")
    assert new is None
    with pytest.raises(LinkError, match=r"more than 256 connections.*cannot be known"):
        result(reply)
    assert once.begin(sent(once, 1, FIRST, b"12345678"), None, "mallory")[0] is not None
    clock.now += QUIET_S + 1.0  # nobody asks again for what was sent before
    assert once.begin(sent(once, 2, AGAIN, b"87654321"), None, "mallory")[0] is not None


def test_two_links_do_not_share_numbers() -> None:
    once = Once()
    for link, number in itertools.product((b"12345678", b"87654321"), (1, 2)):
        assert once.begin(sent(once, number, link=link), None)[0] is not None


def test_a_malformed_stamp_is_refused() -> None:
    new, reply = Once().begin(b"short", None)
    assert new is None
    with pytest.raises(LinkError, match="25 bytes, not 5"):
        result(reply)


def test_every_verb_that_changes_something_is_carried_out_once() -> None:
    again = {"compile", "reveal", "run_end", "table_chunk"}  # do the same however often they come
    assert {name for name, row in VERBS.items() if row.role != "observe" and not row.once} == again
