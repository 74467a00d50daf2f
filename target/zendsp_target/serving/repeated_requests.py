"""Answers repeated requests, recognised by their bytes: a host that tunes or watches sends the same
ones thousands of times.

A monitor that wakes up for a request finds little of its Python in the processor's caches, so each
function on the way costs several times what it does in a loop. Therefore a request that was decoded
and answered once leaves a prepared answer. A reading is recognised by all of its bytes; a reading
that has to see a certain write, by all bytes but the number of that write at the end; a write or an
update of doubles, by all bytes but those of the doubles. Whatever differs otherwise, or is refused,
is decoded as usual, which also finds the words of the refusal.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from typing import Any

from msgspec.structs import replace

from zendsp_protocol import codec, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import LinkError, NotYet, Refused, RunnerDied
from zendsp_protocol.values import WireValue
from zendsp_target.api import Blank, RuntimeApi
from zendsp_target.serving.drives import Drives
from zendsp_target.serving.variable_verbs import APPLY_INLINE_S, applied_at

LONGEST = 65536  # bytes of a request that is kept
MOST = 64  # requests; a host that asks for ever new ones starts over
_FLOATS = frozenset((float,))
_FLOAT = struct.Struct(">d")  # what MessagePack puts behind the byte that announces a double
_COUNT = struct.Struct(">Q")  # likewise for a count
# a count that takes all of its eight bytes, which are no text: it stands nowhere else in a reply
_LARGEST = 2**64 - 1
_PROBE = -0.1  # likewise
# length of a number that is not negative in MessagePack, by its first byte; a small one is one byte
_NUMBER = {0xCC: 2, 0xCD: 3, 0xCE: 5, 0xCF: 9}
_SMALL = 0x7F  # the largest of these
_DOUBLE = b"\xcb"  # what announces a double

Answer = Callable[[bytes], bytes | bytearray | None]  # None: it has to go the whole way


class Repeats:
    """Prepared answers for one user and one thread: a reply is written over the last one."""

    def __init__(self, runtime: RuntimeApi, drives: Drives, lane: str) -> None:
        self._runtime, self._drives, self._lane = runtime, drives, lane
        # by the beginning of a request, up to what may change; None: it has to be decoded
        self._answers: dict[bytes, Answer | None] = {}
        # lengths of such beginnings, by the length of the request
        self._beginnings: dict[int, tuple[int, ...]] = {}

    def answer(self, request: bytes) -> bytes | bytearray | None:
        """The reply, which holds until the next call; None where the request has to be decoded.

        Raises
        ------
        Later
            An update that has to wait for its sample.
        """
        for length in self._beginnings.get(len(request), ()):
            answer = self._answers.get(request[:length])
            if answer is not None:
                return answer(request)
        return None

    def learn(self, request: bytes, verb: verbs.Verb, args: Any, said: str, author: str) -> None:
        """Prepare an answer after a request was decoded and carried out. ``said``: the author that
        it names; ``author``: the one that the target knows.
        """
        if len(request) > LONGEST:
            return
        if verb.name == "read":
            self._learn_read(request, verb, args, said)
        elif verb.name in ("write", "update"):
            self._learn_write(request, verb, args, said, author)

    def forget(self) -> None:
        """Drop the answers that were prepared for a program that is no longer loaded."""
        self._answers.clear()
        self._beginnings.clear()

    def _keep(
        self, request: bytes, length: int, answer: Answer | None, ends: Iterable[int]
    ) -> None:
        """Remember the answer to requests that begin with the first ``length`` bytes of this one;
        ``ends``: how many bytes may follow.
        """
        if len(self._answers) >= MOST:
            self.forget()
        self._answers[request[:length]] = answer
        for end in ends:
            known = self._beginnings.get(length + end, ())
            if length not in known:
                self._beginnings[length + end] = (*known, length)

    def _means(
        self, request: bytes, verb: verbs.Verb, args: verbs.Arguments, said: str
    ) -> bool:
        """Whether a request is decoded into these arguments."""
        try:
            found, other, by = codec.decode_request(request, self._lane)
        except LinkError:
            return False
        return (found, other, by) == (verb, args, said)

    def _learn_read(self, request: bytes, verb: verbs.Verb, args: verbs.Read, said: str) -> None:
        end = codec.encode(args.after) if args.after else b""
        length = len(request) - len(end)
        if not args.names or request[:length] in self._answers or not request.endswith(end):
            return
        other = request[:length] + codec.encode(_LARGEST)
        if end and not self._means(other, verb, replace(args, after=_LARGEST), said):
            return  # the number of the write does not come last
        values = {name: _PROBE - number for number, name in enumerate(args.names)}
        data = bytearray(codec.encode_result({"tick": _LARGEST, "values": values}))
        places = tuple(data.index(_FLOAT.pack(value)) for value in values.values())
        count = data.index(_COUNT.pack(_LARGEST))
        read = self._runtime.repeat_read(args.names, Blank(data, count, places))
        if read is None:
            self._keep(request, length, None, ())
            return

        def answer(request: bytes) -> bytearray | None:
            if end and not self._shown(request[length:]):
                return None
            return data if read() else None

        self._keep(request, length, answer, (1, *_NUMBER.values()) if end else (0,))

    def _shown(self, number: bytes) -> bool:
        """Whether the write of this number (in MessagePack) can be read now or within
        `APPLY_INLINE_S`.
        """
        first = number[0]
        if len(number) != _NUMBER.get(first, 1) or (first > _SMALL and len(number) == 1):
            return False
        sequence = int.from_bytes(number[1:] or number, "big")
        try:
            self._runtime.wait_applied(sequence, APPLY_INLINE_S)
        except (NotYet, Refused, RunnerDied):
            return False
        return True

    def _learn_write(
        self, request: bytes, verb: verbs.Verb, args: verbs.Write, said: str, author: str
    ) -> None:
        given = args.values
        plain = args.at_tick is None and not args.fade
        if not plain or not _FLOATS.issuperset(map(type, given.values())):
            return
        places = _places(request, given.values())
        if not places or request[: places[0]] in self._answers:
            return
        # whether these bytes are the values, and nothing else is: with others there, other values
        # must come out
        probes: dict[str, WireValue] = {name: _PROBE - n for n, name in enumerate(given)}
        other = bytearray(request)
        for at, probe in zip(places, probes.values(), strict=True):
            _FLOAT.pack_into(other, at, probe)
        if not self._means(bytes(other), verb, verbs.Write(values=probes), said):
            return
        # the reply to a write tells its number only, that to an update when it took effect as well
        waits = verb.name == "update"
        told: m.Message = m.Written(sequence=_LARGEST)
        if waits:
            told = m.Applied(sequence=_LARGEST, tick=_LARGEST)
        data = bytearray(codec.encode_result(told))
        count, tick = data.index(_COUNT.pack(_LARGEST)), data.rindex(_COUNT.pack(_LARGEST))
        runtime, drives, reply = self._runtime, self._drives, Blank(data, count)
        write = runtime.repeat_write(list(given), author, Blank(request, values=places), reply)
        if write is None:
            self._keep(request, places[0], None, ())
            return

        def answer(request: bytes) -> bytes | bytearray | None:
            commander = drives.commander
            if not commander or commander == author:
                sequence = write(request)
                if sequence:
                    if waits:
                        _COUNT.pack_into(data, tick, applied_at(runtime, sequence))
                    return data
            return None

        self._keep(request, places[0], answer, (len(request) - places[0],))


def _places(request: bytes, values: Iterable[object]) -> tuple[int, ...]:
    """Where the doubles stand in a request, in their order; none where one is not found."""
    places: list[int] = []
    at = 0
    for value in values:
        at = request.find(_DOUBLE + _FLOAT.pack(value), at) + len(_DOUBLE)
        if at < len(_DOUBLE):
            return ()
        places.append(at)
        at += _FLOAT.size
    return tuple(places)
