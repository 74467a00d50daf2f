"""Packs repeated requests fast: a host that tunes or watches sends the same names thousands of
times with other numbers.

A host that wakes up for a reply has little of its Python in the processor's caches, so that every
function costs several times what it does in a loop. Therefore a write or update of doubles, or a
reading, is packed once. The next request of the same names reuses the bytes with its own numbers,
and a reply that differs only in its numbers is read without unpacking. Everything else goes through
`codec`, with the same result.
"""

from __future__ import annotations

import struct
from typing import Any

from zendsp_protocol import codec
from zendsp_protocol.messages import Applied, Reading, Written
from zendsp_protocol.texts import suspicious

MOST = 64  # requests that are kept; a host that sends ever new ones starts over
_FLOATS = frozenset((float,))
_TEXTS = frozenset((str,))
_FLOAT = struct.Struct(">d")  # what MessagePack puts behind the byte that announces a double
_COUNT = struct.Struct(">Q")  # likewise, of a whole number
_PROBE = -0.1  # its bytes stand in no text of UTF-8
_ANY = b"\xcb" + _FLOAT.pack(_PROBE)
_LARGEST = 2**64 - 1
# a yes to a write and to an update: a target that repeats its answers gives each number eight bytes
_WRITTEN = codec.encode_result(Written(sequence=_LARGEST))[: -_COUNT.size]
_APPLIED, _AT, _ = codec.encode_result(Applied(sequence=_LARGEST, tick=_LARGEST)).split(
    _COUNT.pack(_LARGEST)
)
_ONE = struct.Struct(f">{len(_WRITTEN)}sQ")
_TWO = struct.Struct(f">{len(_APPLIED)}sQ{len(_AT)}sQ")
# of a reading: where its numbers stand, what stands between them, and the names
_Form = tuple[struct.Struct, tuple[bytes, ...], tuple[str, ...]]


class RepeatedRequests:
    """Packs requests, and reads the replies to them."""

    def __init__(self) -> None:
        # by author, verb and names: the request, with %b where a number stands; a reading is up to
        # the number of a write that it is to see
        self._known: dict[tuple[str, ...], bytes] = {}
        self._forms: dict[tuple[str, ...], _Form] = {}  # of readings, by names

    def encode(self, verb: str, arguments: Any, author: str) -> bytes:
        """The request as `codec.encode_request` packs it, byte for byte.

        Raises
        ------
        Refused
            As there.
        """
        if type(arguments) is dict:
            if verb == "read":
                return self._encode_read(arguments, author)
            if verb in ("write", "update") and len(arguments) == 1:
                values = arguments.get("values")
                if type(values) is dict and _FLOATS.issuperset(map(type, values.values())):
                    known = self._known.get((author, verb, *values))
                    known = known or self._learn(verb, values, author)
                    return known % tuple(map(_FLOAT.pack, values.values()))
        return codec.encode_request(verb, arguments, author)

    def _learn(self, verb: str, values: dict[str, float], author: str) -> bytes:
        probes = {"values": dict.fromkeys(values, _PROBE)}
        request = codec.encode_request(verb, probes, author)
        known = request.replace(b"%", b"%%").replace(_ANY, _ANY[:1] + b"%b")
        if all(isinstance(name, str) for name in values):  # 1 and True are one key, and no name
            self._keep((author, verb, *values), known)
        return known

    def _encode_read(self, arguments: dict[str, Any], author: str) -> bytes:
        fields, names = (*arguments,), arguments.get("names")
        if type(names) is not list or not _TEXTS.issuperset(map(type, names)):
            return codec.encode_request("read", arguments, author)
        if fields == ("names",):
            end = b""
        elif fields == ("names", "after") and type(arguments["after"]) is int:
            end = codec.encode(arguments["after"])
        else:
            return codec.encode_request("read", arguments, author)
        key = (author, "read after" if end else "read", *names)
        known = self._known.get(key)
        if known is None:
            request = codec.encode_request("read", arguments, author)
            known = request[: len(request) - len(end)]
            self._keep(key, known)
        return known + end

    def _keep(self, key: tuple[str, ...], known: bytes) -> None:
        if len(self._known) >= MOST:
            self._known = {}
        self._known[key] = known

    def _form_of(self, names: list[str]) -> _Form:
        """The places of the numbers in a reply to a reading of these names."""
        form = self._forms.get((*names,))
        if form is None:
            values = dict.fromkeys(names, _PROBE)
            example = codec.encode_result({"tick": _LARGEST, "values": values})
            begin, rest = example.split(_COUNT.pack(_LARGEST))
            texts = begin, *rest.split(_FLOAT.pack(_PROBE))[:-1]
            # the target shortens or escapes such names, so that no reply is as short
            places = "" if suspicious(b"".join(texts)) else f"{len(begin)}sQ"
            places += "".join(f"{len(text)}sd" for text in texts[1:] if places)
            form = struct.Struct(f">{places}"), texts, (*values,)
            if len(self._forms) >= MOST:
                self._forms = {}
            self._forms[(*names,)] = form
        return form

    def decode(self, reply: bytes, kind: Any, arguments: Any) -> Any:
        """What `codec.decode_reply` returns for the reply to a request with these arguments.

        Raises
        ------
        ZendspError
            As there.
        """
        if kind is Reading:
            asked = arguments.get("names") if type(arguments) is dict else None
            if type(asked) is list and _TEXTS.issuperset(map(type, asked)):
                numbers, texts, names = self._form_of(asked)
                said = numbers.unpack(reply) if len(reply) == numbers.size else ()
                if said[::2] == texts:
                    return Reading(tick=said[1], values=dict(zip(names, said[3::2])))  # noqa: B905  quicker
        elif kind is Applied and len(reply) == _TWO.size:
            yes, sequence, at, tick = _TWO.unpack(reply)
            if yes == _APPLIED and at == _AT:
                return Applied(sequence=sequence, tick=tick)
        elif kind is Written and len(reply) == _ONE.size:
            yes, sequence = _ONE.unpack(reply)
            if yes == _WRITTEN:
                return Written(sequence=sequence)
        return codec.decode_reply(reply, kind)
