"""Writes that come again: the same bytes, and the same reading of replies, as by the whole way."""

from __future__ import annotations

from typing import Any

import hypothesis as hyp
import pytest
from hypothesis import strategies as st

from zendsp.link import repeated_writes
from zendsp.link.repeated_writes import MOST, RepeatedWrites
from zendsp_protocol import codec
from zendsp_protocol.errors import LinkError, VersionMismatch, ZendspError
from zendsp_protocol.messages import Applied, Written

AUTHOR = "me@here:7"
NUMBERS = st.floats(width=64, allow_nan=True)
# few names, so that they come again; two are alike in length, one is no text at all
NAMES = st.sampled_from(["a", "b", "Kp1", "q[0]", "größe", "%b", 1, True])
VALUES = st.dictionaries(NAMES, NUMBERS | st.integers(-3, 3) | st.booleans(), max_size=4)
REQUESTS = st.tuples(
    st.sampled_from(["write", "update", "check", "read"]),
    st.fixed_dictionaries({"values": VALUES}, optional={"at_tick": st.integers(0, 9)}),
    st.sampled_from([AUTHOR, "another"]),
)


@hyp.given(st.lists(REQUESTS, max_size=12))
def test_random_requests_become_the_same_bytes_on_either_way(asked: list[Any]) -> None:
    writes = RepeatedWrites()
    for verb, arguments, author in asked:
        assert writes.encode(verb, arguments, author) == codec.encode_request(
            verb, arguments, author
        )


NUMBER = st.integers(2**60, 2**64 - 1) | st.integers(0, 2**60) | st.floats() | st.text(max_size=9)


@hyp.given(
    st.lists(st.tuples(st.sampled_from(["sequence", "tick", "ticc"]), NUMBER), max_size=3),
    st.sampled_from([Written, Applied]),
    st.binary(max_size=2),
)
def test_random_replies_are_read_alike_on_either_way(
    told: list[tuple[str, Any]], kind: Any, more: bytes
) -> None:
    reply = codec.encode_result(dict(told)) + more
    found: list[Any] = []
    for decode in (RepeatedWrites().decode, codec.decode_reply):
        try:
            found.append(decode(reply, kind))
        except ZendspError as error:
            found.append((type(error), str(error)))
    assert found[0] == found[1]


def test_a_write_of_names_that_came_before_is_not_packed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    writes = RepeatedWrites()
    first = codec.encode_request("write", {"values": {"a": 1.0, "b": 2.0}}, AUTHOR)
    writes.encode("write", {"values": {"a": 0.5, "b": -0.1}}, AUTHOR)
    long = codec.encode_result(Written(sequence=2**63))
    two = codec.encode_result(Applied(sequence=2**63, tick=2**64 - 1))
    monkeypatch.setattr(repeated_writes, "codec", None)
    assert writes.encode("write", {"values": {"a": 1.0, "b": 2.0}}, AUTHOR) == first
    assert writes.decode(long, Written) == Written(sequence=2**63)
    assert writes.decode(two, Applied) == Applied(sequence=2**63, tick=2**64 - 1)


def test_a_host_that_writes_ever_new_names_keeps_no_more_than_a_few() -> None:
    writes = RepeatedWrites()
    for number in range(3 * MOST):
        writes.encode("write", {"values": {f"v{number}": 1.0}}, AUTHOR)
    assert len(writes._known) <= MOST


def test_a_reply_of_another_version_or_cut_short_says_so() -> None:
    writes = RepeatedWrites()
    whole = codec.encode_result(Written(sequence=2**63))
    with pytest.raises(LinkError, match="malformed"):
        writes.decode(whole[:-1], Written)
    other = codec.encode({"v": 99, "ok": True, "result": {"sequence": 2**63}})
    with pytest.raises(VersionMismatch):
        writes.decode(other, Written)
