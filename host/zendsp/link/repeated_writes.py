"""Writes that come again and again: a host that tunes sends the same names thousands of times, with
other numbers.

A host that wakes up for a reply finds little of its Python in the caches, and pays several times
for every function on the way. So a write or an update of doubles is packed once; the next one of
these names is the same bytes with its own numbers in them, and a reply that differs in its numbers
only is read without unpacking. What is not plainly so goes through `codec`, with the same result.
"""

from __future__ import annotations

import struct
from typing import Any

from zendsp_protocol import codec
from zendsp_protocol.messages import Applied, Written

MOST = 64  # requests that are kept; a host that sends ever new ones starts over
_REPEATED = frozenset(("write", "update"))
_FLOATS = frozenset((float,))
_FLOAT = struct.Struct(">d")  # what MessagePack puts behind the byte that announces a double
_COUNT = struct.Struct(">Q")  # likewise, of a whole number
_PROBE = -0.1  # its nine bytes stand in no text of UTF-8
_ANY = b"\xcb" + _FLOAT.pack(_PROBE)
_LARGEST = 2**64 - 1
# a yes to a write and to an update: a target that repeats its answers gives each number eight bytes
_WRITTEN = codec.encode_result(Written(sequence=_LARGEST))[: -_COUNT.size]
_APPLIED, _AT, _ = codec.encode_result(Applied(sequence=_LARGEST, tick=_LARGEST)).split(
    _COUNT.pack(_LARGEST)
)
_ONE = struct.Struct(f">{len(_WRITTEN)}sQ")
_TWO = struct.Struct(f">{len(_APPLIED)}sQ{len(_AT)}sQ")


class RepeatedWrites:
    """Packs requests, and reads the replies to them."""

    def __init__(self) -> None:
        # by author, verb and names: the request, with %b where a number stands
        self._known: dict[tuple[str, ...], bytes] = {}

    def encode(self, verb: str, arguments: Any, author: str) -> bytes:
        """Return what `codec.encode_request` does, byte for byte.

        Raises
        ------
        Refused
            As there.
        """
        if verb not in _REPEATED or type(arguments) is not dict or len(arguments) > 1:
            return codec.encode_request(verb, arguments, author)
        values = arguments.get("values")
        if type(values) is not dict or not _FLOATS.issuperset(map(type, values.values())):
            return codec.encode_request(verb, arguments, author)
        known = self._known.get((author, verb, *values)) or self._learn(verb, values, author)
        return known % tuple(map(_FLOAT.pack, values.values()))

    def _learn(self, verb: str, values: dict[str, float], author: str) -> bytes:
        probes = {"values": dict.fromkeys(values, _PROBE)}
        request = codec.encode_request(verb, probes, author)
        known = request.replace(b"%", b"%%").replace(_ANY, _ANY[:1] + b"%b")
        if all(isinstance(name, str) for name in values):  # 1 and True are one key, and no name
            if len(self._known) >= MOST:
                self._known = {}
            self._known[author, verb, *values] = known
        return known

    def decode(self, reply: bytes, kind: Any) -> Any:
        """Return what `codec.decode_reply` does.

        Raises
        ------
        ZendspError
            As there.
        """
        if kind is Applied and len(reply) == _TWO.size:
            yes, sequence, at, tick = _TWO.unpack(reply)
            if yes == _APPLIED and at == _AT:
                return Applied(sequence=sequence, tick=tick)
        elif kind is Written and len(reply) == _ONE.size:
            yes, sequence = _ONE.unpack(reply)
            if yes == _WRITTEN:
                return Written(sequence=sequence)
        return codec.decode_reply(reply, kind)
