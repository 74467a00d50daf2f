"""What any Zenoh client may send, and what is answered to it."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zenoh
from waiting import PATIENCE_S

from zendsp.errors import LinkError, Refused, VersionMismatch
from zendsp.link import Target
from zendsp.link.settings import Credentials, zenoh_config
from zendsp_protocol import codec, keys
from zendsp_protocol import messages as m
from zendsp_target.runtime import Runtime


def raw_session(target: Target) -> zenoh.Session:
    return zenoh.open(zenoh_config(target.link.endpoints, Credentials(), 3.0))


def ask(session: zenoh.Session, key: str, payload: bytes | None) -> bytes:
    replies = list(session.get(key, payload=payload, timeout=5.0))
    assert len(replies) == 1, f"{key}: {len(replies)} replies"
    answer = replies[0].ok or replies[0].err
    assert answer is not None
    return answer.payload.to_bytes()


@pytest.mark.parametrize("lane", keys.LANES)
def test_malformed_messages_get_an_error_reply_and_nothing_else_happens(
    running: Target, lane: str
) -> None:
    rng = np.random.default_rng(7)
    good = codec.encode_request("write", {"values": {"Kp1": 4.0}}, "me")
    bad: list[bytes | None] = [
        None,
        b"",
        b"\x00",
        b"{}",
        b"\xc1",
        good[:-3],
        codec.encode([1, 2]),
        codec.encode({"v": 1}),
    ]
    bad += [rng.bytes(int(n)) for n in rng.integers(1, 400, 20)]
    bad += [
        codec.encode_request("write", {"values": {"Kp1": "x"}}, "me"),
        codec.encode_request("write", {}, "me"),
    ]
    bad += [
        codec.encode_request("write", {"values": {}, "typo": 1}, "me"),
        codec.encode_request("nonsense", {}, "me"),
    ]
    with raw_session(running) as session:
        for payload in bad:
            with pytest.raises((LinkError, VersionMismatch)):
                codec.decode_reply(ask(session, keys.rpc("fake", lane), payload), m.Empty)
    assert running["Kp1"] == 100.0 and running.status().state == "running"


def test_an_old_host_meeting_a_new_target_gets_a_clear_sentence(running: Target) -> None:
    with raw_session(running) as session:
        request = codec.encode_request("status", {}, "me", version=0)
        reply = ask(session, keys.rpc("fake", "quick"), request)
        with pytest.raises(
            VersionMismatch,
            match=(
                "the host speaks protocol 0, the target speaks protocol 1: upgrade zendsp on the"
                " host"
            ),
        ):
            codec.decode_reply(reply, m.Status)
        newer = codec.encode({"v": 99, "completely": "different"})
        with pytest.raises(VersionMismatch, match="upgrade zendsp on the target"):
            codec.decode_reply(ask(session, keys.rpc("fake", "quick"), newer), m.Status)


def test_any_zenoh_client_reads_a_variable_and_follows_the_state(running: Target) -> None:
    with raw_session(running) as session:
        value = codec.decode(ask(session, "zendsp/fake/var/Kp1", None), dict)
        assert (
            value["value"] == 100.0
            and value["unit"] == "N m/rad"
            and value["v"] == 1
            and value["tick"] >= 0
        )
        found = {str(r.ok.key_expr) for r in session.get("zendsp/*/var/K$*") if r.ok is not None}
        assert found == {"zendsp/fake/var/Kp1", "zendsp/fake/var/Kd1"}
        error = codec.decode(ask(session, "zendsp/fake/var/nope", None), dict)
        assert "no variable matches" in error["error"]["message"]
        events = session.declare_subscriber("zendsp/*/event")
        running.pause()
        deadline = time.monotonic() + PATIENCE_S
        while codec.decode(events.recv().payload.to_bytes(), dict)["state"] != "paused":
            assert time.monotonic() < deadline


def test_an_unexpected_failure_inside_the_target_is_an_answer_too(
    running: Target, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime, "read", lambda names: (0, {"Kp1": object()}))
    with pytest.raises(Refused, match=r"the target failed inside .* this is a bug"):
        running.read(["Kp1"])
    monkeypatch.undo()
    assert running["Kp1"] == 100.0


def test_unknown_verbs_and_arguments_are_refused_by_name(target: Target) -> None:
    with pytest.raises(Refused, match="no such request 'dance'"):
        target.request("dance")
    with pytest.raises(LinkError, match=r"unknown field `speed` .*upgrade zendsp on the target"):
        target.request("status", speed=3)


@pytest.mark.parametrize("lane", keys.LANES)
def test_a_request_whose_refusal_fails_does_not_block_later_requests(
    running: Target, lane: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(error: BaseException) -> bytes:
        raise MemoryError

    with raw_session(running) as session:
        for _ in range(4):  # as many as the lane has threads, and one
            with monkeypatch.context() as without:
                without.setattr(codec, "encode_error", no_memory)
                assert list(session.get(keys.rpc("fake", lane), payload=b"", timeout=5.0)) == []
        with pytest.raises(LinkError):
            codec.decode_reply(ask(session, keys.rpc("fake", lane), b""), m.Empty)
