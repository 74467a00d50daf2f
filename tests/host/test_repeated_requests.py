"""Repeated requests give the same bytes, and their replies the same values, as the full encoding.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import hypothesis as hyp
import pytest
from hypothesis import strategies as st

from zendsp.link import repeated_requests
from zendsp.link.repeated_requests import MOST, RepeatedRequests
from zendsp_protocol import codec
from zendsp_protocol.errors import LinkError, VersionMismatch, ZendspError
from zendsp_protocol.messages import Applied, Reading, Written

AUTHOR = "me@here:7"
NUMBERS = st.floats(width=64, allow_nan=True)
# few names, so that they come again; two are alike in length, one is no text at all
NAMES = st.sampled_from(["a", "b", "Kp1", "q[0]", "größe", "%b", 1, True])
VALUES = st.dictionaries(NAMES, NUMBERS | st.integers(-3, 3) | st.booleans(), max_size=4)
WRITES = st.fixed_dictionaries({"values": VALUES}, optional={"at_tick": st.integers(0, 9)})
ASKED = st.lists(NAMES, max_size=4)
READS = st.fixed_dictionaries(
    {"names": ASKED}, optional={"after": st.integers(0, 2**64 - 1) | st.booleans()}
)
REQUESTS = st.tuples(
    st.sampled_from(["write", "update", "check", "read"]),
    WRITES | READS,
    st.sampled_from([AUTHOR, "another"]),
)


@hyp.given(st.lists(REQUESTS, max_size=12))
def test_random_requests_become_the_same_bytes_on_either_way(asked: list[Any]) -> None:
    repeats = RepeatedRequests()
    for verb, arguments, author in asked:
        assert repeats.encode(verb, arguments, author) == codec.encode_request(
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
    for decode in (partial(RepeatedRequests().decode, arguments={}), codec.decode_reply):
        try:
            found.append(decode(reply, kind))
        except ZendspError as error:
            found.append((type(error), str(error)))
    assert found[0] == found[1]


@hyp.given(
    st.lists(st.sampled_from(["a", "b", "q[0]", "größe", "\x1b[2J"]), max_size=3),
    st.lists(NUMBERS | st.integers(-3, 3), max_size=3),
    st.integers(2**60, 2**64 - 1) | st.integers(0, 300),
    st.fixed_dictionaries({}, optional={"ended": st.text(max_size=9)}),
    st.binary(max_size=2),
)
def test_random_readings_are_read_alike_on_either_way(
    names: list[str], numbers: list[float], tick: int, more: dict[str, str], end: bytes
) -> None:
    reading = {"tick": tick, "values": dict(zip(names, numbers, strict=False)), **more}
    reply = codec.encode_result(reading) + end
    repeats = RepeatedRequests()
    for asked in ({"names": names}, {"names": names, "after": 7}, {"names": [["a"]]}, {}):
        found: list[Any] = []
        for decode in (partial(repeats.decode, arguments=asked), codec.decode_reply):
            try:
                found.append(repr(decode(reply, Reading)))  # NaN is not NaN
            except ZendspError as error:
                found.append((type(error), str(error)))
        assert found[0] == found[1]


def test_requests_for_names_that_came_before_are_not_packed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    repeats = RepeatedRequests()
    first = codec.encode_request("write", {"values": {"a": 1.0, "b": 2.0}}, AUTHOR)
    repeats.encode("write", {"values": {"a": 0.5, "b": -0.1}}, AUTHOR)
    long = codec.encode_result(Written(sequence=2**63))
    two = codec.encode_result(Applied(sequence=2**63, tick=2**64 - 1))
    asked = {"names": ["a", "b"]}
    read = repeats.encode("read", asked, AUTHOR)
    told = {"tick": 2**63, "values": {"a": 0.5, "b": -0.1}}
    reading = codec.encode_result(told)
    assert repeats.decode(reading, Reading, asked) == Reading(**told)
    monkeypatch.setattr(repeated_requests, "codec", None)
    assert repeats.encode("write", {"values": {"a": 1.0, "b": 2.0}}, AUTHOR) == first
    assert repeats.encode("read", asked, AUTHOR) == read
    assert repeats.decode(reading, Reading, asked) == Reading(**told)
    assert repeats.decode(long, Written, {}) == Written(sequence=2**63)
    assert repeats.decode(two, Applied, {}) == Applied(sequence=2**63, tick=2**64 - 1)


def test_a_host_that_writes_ever_new_names_keeps_no_more_than_a_few() -> None:
    repeats = RepeatedRequests()
    for number in range(3 * MOST):
        repeats.encode("write", {"values": {f"v{number}": 1.0}}, AUTHOR)
        repeats._form_of([f"v{number}"])
    assert len(repeats._known) <= MOST and len(repeats._forms) <= MOST


def test_a_reply_of_another_version_or_cut_short_says_so() -> None:
    repeats = RepeatedRequests()
    whole = codec.encode_result(Written(sequence=2**63))
    with pytest.raises(LinkError, match="malformed"):
        repeats.decode(whole[:-1], Written, {})
    other = codec.encode({"v": 99, "ok": True, "result": {"sequence": 2**63}})
    with pytest.raises(VersionMismatch):
        repeats.decode(other, Written, {})
