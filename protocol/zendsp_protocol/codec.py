"""MessagePack there and back, checked against the declared types; nothing half-read reaches a handler."""

from __future__ import annotations

from functools import cache, reduce
from operator import or_
from typing import Any, Generic, TypeVar

import msgspec

from zendsp_protocol import errors
from zendsp_protocol.errors import LinkError, VersionMismatch, ZendspError
from zendsp_protocol.keys import LANES
from zendsp_protocol.messages import ErrorBody
from zendsp_protocol.values import enc_hook
from zendsp_protocol.verbs import VERBS, Arguments, Verb
from zendsp_protocol.version import PROTOCOL, mismatch

_encoder = msgspec.msgpack.Encoder(enc_hook=enc_hook)


Result = TypeVar("Result")


class Request(msgspec.Struct, frozen=True):
    """The envelope of a request."""

    v: int
    verb: str
    by: str  # who asks: shown in the log and to other hosts
    args: Any


class _RawRequest(msgspec.Struct, frozen=True):
    v: int
    verb: str
    args: msgspec.Raw
    by: str = "unknown"


class _AnyVersion(msgspec.Struct, frozen=True):
    v: Any = None


class Reply(msgspec.Struct, frozen=True, omit_defaults=True):
    """The envelope of a reply: either ``result`` or ``error``."""

    v: int
    ok: bool
    result: Any = None
    error: ErrorBody | None = None


class _RawReply(msgspec.Struct, frozen=True):
    v: int
    ok: bool
    result: msgspec.Raw = msgspec.Raw(b"\xc0")
    error: ErrorBody | None = None


class _Success(msgspec.Struct, Generic[Result], frozen=True):
    """A reply that says yes, with its result in the form that its verb has."""

    v: int
    ok: bool
    result: Result
    error: None = None


def _envelope(verb: Verb) -> type[msgspec.Struct]:
    """Make the envelope of one verb's requests, told from the others by its field ``verb``."""
    fields: list[tuple[str, Any] | tuple[str, Any, Any]] = [
        ("v", int),
        ("args", verb.arguments),
        ("by", str, "unknown"),
    ]
    return msgspec.defstruct(f"Request_{verb.name}", fields, tag_field="verb", tag=verb.name, frozen=True)


_envelopes = {_envelope(verb): verb for verb in VERBS.values()}
_of_lane = {lane: {kind: verb for kind, verb in _envelopes.items() if verb.lane == lane} for lane in LANES}
_any_request_decoder: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(reduce(or_, _envelopes))
_request_decoder = msgspec.msgpack.Decoder(_RawRequest)
_reply_decoder = msgspec.msgpack.Decoder(_RawReply)
_version_decoder = msgspec.msgpack.Decoder(_AnyVersion)


@cache
def _decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    return msgspec.msgpack.Decoder(kind)


def encode(message: Any) -> bytes:
    """Encode any message, dataclass, number or array."""
    return _encoder.encode(message)


def decode(data: bytes, kind: Any) -> Any:
    """Decode and validate ``data`` as ``kind``.

    Raises
    ------
    LinkError
        Not MessagePack, or not of that form.
    """
    try:
        return _decoder(kind).decode(data)
    except (msgspec.MsgspecError, ValueError) as error:
        raise LinkError(f"malformed message: {error}") from error


def encode_request(verb: str, arguments: Any, by: str, version: int = PROTOCOL) -> bytes:
    """Encode a request; ``arguments`` is the verb's struct or a dictionary of the same fields."""
    return _encoder.encode(Request(version, verb, by, arguments))


def decode_request(data: bytes, lane: str) -> tuple[Verb, Arguments, str]:
    """Decode a request of one lane into verb, checked arguments and author.

    Raises
    ------
    VersionMismatch
        The host speaks another version.
    LinkError
        Malformed, unknown, or sent to the wrong lane; the message says which.
    """
    try:  # nearly always, and in one go
        whole = _any_request_decoder.decode(data)
        verb = _of_lane[lane].get(type(whole))
        if verb is not None and whole.v == PROTOCOL:
            return verb, whole.args, whole.by
    except (msgspec.MsgspecError, ValueError):
        pass  # what follows finds the words
    return _decode_piecewise(data, lane)


def _decode_piecewise(data: bytes, lane: str) -> tuple[Verb, Arguments, str]:
    try:
        request = _request_decoder.decode(data)
    except (msgspec.MsgspecError, ValueError) as error:
        _check_version(data, "target")
        raise LinkError(f"malformed request: {error}") from error
    if request.v != PROTOCOL:
        raise VersionMismatch(mismatch(request.v, "target"))
    verb = VERBS.get(request.verb)
    if verb is None:
        raise LinkError(f"unknown verb {request.verb!r}; known: {', '.join(VERBS)}")
    if verb.lane != lane:
        raise LinkError(f"verb {verb.name!r} belongs to the lane {verb.lane!r}, not {lane!r}")
    try:
        return verb, _decoder(verb.arguments).decode(request.args), request.by
    except (msgspec.MsgspecError, ValueError) as error:
        raise LinkError(f"malformed arguments of {verb.name!r}: {error}") from error


def encode_result(result: Any) -> bytes:
    """Encode a reply that says yes."""
    return _encoder.encode(Reply(PROTOCOL, True, result))


def encode_error(error: BaseException, details: dict[str, Any] | None = None) -> bytes:
    """Encode a reply that says no, and why."""
    kind = type(error).__name__ if isinstance(error, ZendspError) else "Internal"
    text = (
        str(error)
        if kind != "Internal"
        else f"the target failed inside ({type(error).__name__}: {error}); this is a bug"
    )
    return _encoder.encode(
        Reply(PROTOCOL, False, None, ErrorBody(kind=kind, message=text, details=details or {}))
    )


class ReplyReader:
    """Decodes the replies of one verb.

    Parameters
    ----------
    kind : type
        Of its result.
    """

    def __init__(self, kind: Any) -> None:
        self._kind = kind
        self._success = msgspec.msgpack.Decoder(_Success[kind])

    def read(self, data: bytes) -> Any:
        """Decode a reply into its result, or raise the error that it carries.

        Raises
        ------
        VersionMismatch
            The target speaks another version.
        ZendspError
            Whatever the target says, as the class it names.
        """
        try:  # nearly always, and in one go
            reply = self._success.decode(data)
            if reply.ok and reply.v == PROTOCOL:
                return reply.result
        except (msgspec.MsgspecError, ValueError):
            pass  # what follows finds the words
        return self._explain(data)

    def _explain(self, data: bytes) -> Any:
        try:
            reply = _reply_decoder.decode(data)
        except (msgspec.MsgspecError, ValueError) as error:
            _check_version(data, "host")
            raise LinkError(f"malformed reply: {error}") from error
        if reply.error is not None:
            raise make_error(reply.error)
        if reply.v != PROTOCOL:
            raise VersionMismatch(mismatch(reply.v, "host"))
        try:
            return _decoder(self._kind).decode(reply.result)
        except (msgspec.MsgspecError, ValueError) as error:
            raise LinkError(f"malformed result: {error}") from error


@cache
def reply_reader(kind: Any) -> ReplyReader:
    """Return the reader of replies with results of one kind."""
    return ReplyReader(kind)


def decode_reply(data: bytes, kind: Any) -> Any:
    """Decode a reply into its result, or raise the error that it carries; see :meth:`ReplyReader.read`."""
    return reply_reader(kind).read(data)


def check_version(version: object) -> None:
    """Raise VersionMismatch, in words for the host, unless ``version`` is this one."""
    if version != PROTOCOL:
        raise VersionMismatch(mismatch(version, "host"))


def make_error(body: ErrorBody) -> ZendspError:
    """Turn an error reply into the exception that it names; unknown kinds become :class:`Refused`."""
    found = getattr(errors, body.kind, None)
    known = isinstance(found, type) and issubclass(found, ZendspError)
    return found(body.message) if known and found is not None else errors.Refused(body.message)


def _check_version(data: bytes, reader: str) -> None:
    """Raise if a message that cannot be read is of another version: that is then the reason to name."""
    try:
        version = _version_decoder.decode(data).v
    except (msgspec.MsgspecError, ValueError):
        return
    if version != PROTOCOL:
        raise VersionMismatch(mismatch(version, reader))
