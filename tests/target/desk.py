"""The server's way with a request, without a network."""

from __future__ import annotations

from typing import Any

import pytest

from zendsp_protocol import codec, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import ZendspError
from zendsp_target.runtime import Runtime
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.live_streams import LiveStreams
from zendsp_target.serving.repeated_requests import Repeats
from zendsp_target.serving.service import Service, identity


class Desk:
    """The server's way with a request, without a network, in one thread."""

    def __init__(self, service: Service) -> None:
        self.service = service
        self.repeats: dict[str, Repeats] = {
            lane: service.repeats(lane) for lane in ("quick", "sync")
        }
        self.again = 0  # requests answered the shorter way
        self.written = 0  # number of the last write that a test wants to see

    def ask(self, verb: str, by: str = "me", **arguments: Any) -> Any:
        return codec.decode_reply(self.reply(verb, by, arguments), verbs.VERBS[verb].result)

    def reply(self, verb: str, by: str, arguments: Any) -> bytes:
        request = codec.encode_request(verb, arguments, by)
        repeats = self.repeats.get(verbs.VERBS[verb].lane)
        try:
            known = None if repeats is None else repeats.answer(request)
        except Later as later:
            known = codec.encode_result(later.rest())
        if known is not None:
            self.again += 1
            return bytes(known)
        found, args, author = codec.decode_request(request, verbs.VERBS[verb].lane)
        try:
            result = self.service.handlers[verb](args, author)
        except Later as later:
            result = later.rest()
        reply = codec.encode_result(result)
        self.learn(request, found, args, author)
        return reply

    def learn(self, request: bytes, verb: verbs.Verb, args: Any, author: str) -> None:
        if verb.lane in self.repeats:
            self.repeats[verb.lane].learn(request, verb, args, author, author)

    def write(self, by: str = "me", **values: Any) -> int:
        written: m.Written = self.ask("write", by, values=values)
        return written.sequence

    def refusal(self, by: str = "me", **values: Any) -> str:
        before = self.again
        with pytest.raises(ZendspError) as refused:
            self.write(by, **values)
        assert self.again == before
        return f"{type(refused.value).__name__}: {refused.value}"


def desk_of(runtime: Runtime, kind: type[Desk] = Desk) -> Desk:
    live = LiveStreams(runtime, lambda *_: None, lambda *_: False)
    return kind(Service(runtime, identity("t", "imi_planar"), live))
