"""Packs and unpacks MessagePack, checked against the declared types; a handler never gets half a
message.

``msgpack`` packs and unpacks the bytes, ``msgspec.convert`` checks what came out of them.
"""

from __future__ import annotations

import dataclasses
import threading
from enum import StrEnum
from typing import Any

import msgpack
import msgspec

from zendsp_protocol import errors
from zendsp_protocol.errors import LinkError, Refused, VersionMismatch, ZendspError
from zendsp_protocol.messages import ErrorBody
from zendsp_protocol.pieces import check_pieces
from zendsp_protocol.texts import shown, shown_all, suspicious
from zendsp_protocol.values import enc_hook
from zendsp_protocol.verbs import VERBS, Arguments, Verb
from zendsp_protocol.version import PROTOCOL, mismatch

MOST_NAME = 200  # characters of who asks: it is kept in the log and told to all
MOST_REQUEST = 64_000_000  # bytes; a target takes none in that is larger, and says nothing
_ENVELOPE = 10_000  # bytes of it for what Zenoh adds
MOST_TEXT = 20_000  # characters of an error, which may quote what was asked
ROOM = 1024  # bytes at first: a packer that makes room for 256 kB each time asks the kernel for it
_KNOWN: set[Any] = set()  # types that msgspec has looked at, nested ones included
_LOOKING = threading.Lock()
_MALFORMED = (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError)


class Reply(msgspec.Struct, frozen=True):
    """The envelope of a reply: either ``result`` or ``error``."""

    v: int
    ok: bool
    result: Any = None
    error: ErrorBody | None = None


def encode(message: Any) -> bytes:
    """Encode any message, dataclass, number or array."""
    return msgpack.Packer(default=_plain, buf_size=ROOM).pack(message)  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    """A value in types that MessagePack has, one level deep."""
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.asdict(value)
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    known = enc_hook(value)
    return msgspec.structs.asdict(known) if isinstance(known, msgspec.Struct) else known


def decode(data: bytes, kind: Any) -> Any:
    """Decode and validate ``data`` as ``kind``.

    Raises
    ------
    LinkError
        Not MessagePack, or not of that form.
    """
    return _convert(_said(_unpack(data, "message"), data), kind, "message")


# what a verb or field that nobody knows here most likely means
_NEWER = " (where the host is newer than this target, upgrade zendsp on the target)"


def _said(message: Any, data: bytes) -> Any:
    """A message of another process, without characters that a terminal would obey."""
    return shown_all(message) if suspicious(data) else message


def _why(error: Exception) -> str:
    """What is wrong, in words; msgpack itself says little."""
    deep = isinstance(error, msgpack.StackError)
    return str(error) or ("it is nested too deeply" if deep else "not MessagePack")


def _unpack(data: bytes, what: str) -> Any:
    try:
        return msgpack.unpackb(data)
    except _MALFORMED as error:
        raise LinkError(f"malformed {what}: {_why(error)}") from error


def _checked(value: Any, kind: Any) -> Any:
    """The value converted to a type.

    At a new type msgspec first looks at the fields; a thread that meets the type while another is
    doing so would crash the process (SIGSEGV). So only one thread at a time does that.
    """
    if kind in _KNOWN:
        return msgspec.convert(value, kind)
    with _LOOKING:
        try:
            return msgspec.convert(value, kind)
        finally:
            _KNOWN.add(kind)


def _convert(value: Any, kind: Any, what: str) -> Any:
    try:
        return _checked(value, kind)
    except _MALFORMED as error:
        raise LinkError(f"malformed {what}: {_why(error)}") from error


def encode_request(verb: str, arguments: Any, by: str, version: int = PROTOCOL) -> bytes:
    """Encode a request; ``arguments`` is the verb's struct or a dictionary of the same fields."""
    try:
        request = encode({"v": version, "verb": verb, "by": by, "args": arguments})
    except UnicodeEncodeError as error:  # of a name that was read in another encoding
        raise Refused(f"{error.object!r} is no text in UTF-8") from error
    if len(request) > MOST_REQUEST - _ENVELOPE:
        raise Refused(
            f"{verb} of {len(request) / 1e6:.0f} MB was not sent: a request has"
            f" {MOST_REQUEST / 1e6:g} MB at most; upload() sends a table or an array in parts"
        )
    return request


def decode_request(data: bytes, lane: str) -> tuple[Verb, Arguments, str]:
    """Decode a request of one lane into verb, checked arguments and author.

    Raises
    ------
    VersionMismatch
        The host speaks another version.
    LinkError
        Malformed, unknown, or sent to the wrong lane; the message says which.
    """
    check_pieces(data, texts=lane == "slow")
    try:  # nearly always: all that is wrong is one exception
        message = msgpack.unpackb(data)
        verb, by, version = VERBS[message["verb"]], message["by"], message["v"]
        fits = version == PROTOCOL and type(version) is int and verb.lane == lane
        if fits and len(by) <= MOST_NAME and by.isprintable():
            return verb, _checked(message["args"], verb.arguments), by
    except (*_MALFORMED, LookupError, AttributeError):
        pass  # what follows finds the words
    return _decode_in_steps(data, lane)


def _decode_in_steps(data: bytes, lane: str) -> tuple[Verb, Arguments, str]:
    """As `decode_request`, in steps, so that the error names the part that is wrong."""
    message = _unpack(data, "request")
    _check_version(message, "target")
    if type(message) is not dict:
        raise LinkError("malformed request: it is no map")
    name, by = message.get("verb"), message.get("by", "unknown")
    if type(name) is not str or type(by) is not str:
        raise LinkError("malformed request: `verb` and `by` have to be texts")
    verb = VERBS.get(name)
    if verb is None:
        known = ", ".join(VERBS)
        raise LinkError(f"unknown verb {name[:MOST_NAME]!r}{_NEWER}; known: {known}")
    if verb.lane != lane:
        raise LinkError(f"verb {name!r} belongs to the lane {verb.lane!r}, not {lane!r}")
    arguments = message.get("args")
    _check_words(arguments, verb)
    return (
        verb,
        _convert(arguments, verb.arguments, f"arguments of {name!r}"),
        shown(by[:MOST_NAME], lines=False),
    )


def _check_words(arguments: Any, verb: Verb) -> None:
    """Refuse a field that the verb has not. Refuse a word that an argument may not be, and name
    those that it may be, which msgspec does not.
    """
    given = arguments if type(arguments) is dict else {}
    fields = msgspec.structs.fields(verb.arguments)
    for name in given.keys() - {field.name for field in fields}:
        raise LinkError(
            f"malformed arguments of {verb.name!r}: unknown field `{str(name)[:MOST_NAME]}`{_NEWER}"
        )
    for field in fields:
        if isinstance(field.type, type) and issubclass(field.type, StrEnum):
            word = given.get(field.name, field.default)
            if type(word) is str and word not in list(field.type):
                words = ", ".join(field.type)
                raise Refused(f"{verb.name}: {field.name} {word!r}: expected one of {words}")


def encode_result(result: Any) -> bytes:
    """Encode the reply to a request that succeeded."""
    body: dict[str, Any] = {"v": PROTOCOL, "ok": True}
    if result is not None:
        known = isinstance(result, msgspec.Struct)
        body["result"] = msgspec.structs.asdict(result) if known else result
    return encode(body)


def encode_error(error: BaseException, details: dict[str, Any] | None = None) -> bytes:
    """Encode the reply to a request that failed, with the reason."""
    if isinstance(error, OSError) and not isinstance(error, ZendspError) and error.strerror:
        # a full disk, no memory, a folder that is gone: nothing that a program of ours can mend
        error = Refused(f"the target's computer refuses: {error}")
    kind = type(error).__name__ if isinstance(error, ZendspError) else "Internal"
    text = (
        str(error)
        if kind != "Internal"
        else f"the target failed inside ({type(error).__name__}: {error}); this is a bug"
    )
    if len(text) > MOST_TEXT:
        text = f"{text[:MOST_TEXT]} …"
    return encode(
        {
            "v": PROTOCOL,
            "ok": False,
            "error": ErrorBody(kind=kind, message=text, details=details or {}),
        }
    )


def decode_reply(data: bytes, kind: Any) -> Any:
    """Decode a reply into its result, checked as ``kind``, or raise the error that it carries.

    Raises
    ------
    VersionMismatch
        The target speaks another version.
    LinkError
        Malformed.
    ZendspError
        Whatever the target says, as the class it names.
    """
    try:  # nearly always
        message = msgpack.unpackb(data)
        if message["ok"] is True and message["v"] == PROTOCOL:
            result = message.get("result")
            return _checked(shown_all(result) if suspicious(data) else result, kind)
    except (*_MALFORMED, LookupError):
        pass  # what follows finds the words
    return _explain(data, kind)


def declined(data: bytes) -> bool:
    """Whether a reply says no, rather than yes or nothing that can be read."""
    try:
        return msgpack.unpackb(data)["ok"] is False
    except (*_MALFORMED, LookupError):
        return False


def _explain(data: bytes, kind: Any) -> Any:
    """Raise the error that a reply carries, whatever its version; else one that says what is wrong
    with the reply.
    """
    message = _said(_unpack(data, "reply"), data)
    try:
        reply = _checked(message, Reply)
    except _MALFORMED as error:
        _check_version(message, "host")
        raise LinkError(f"malformed reply: {_why(error)}") from error
    if reply.error is not None:
        raise make_error(reply.error)
    _check_version(message, "host")
    if not reply.ok:
        raise LinkError("malformed reply: it says no and not why")
    return _convert(reply.result, kind, "result")


def check_version(version: object) -> None:
    """Raise VersionMismatch, in words for the host, unless ``version`` is this one."""
    if version != PROTOCOL:
        raise VersionMismatch(mismatch(version, "host"))


def make_error(body: ErrorBody) -> ZendspError:
    """The exception that an error reply names; :class:`Refused` for a name that is not known."""
    found = getattr(errors, body.kind, None)
    known = isinstance(found, type) and issubclass(found, ZendspError)
    return found(body.message) if known and found is not None else errors.Refused(body.message)


def _check_version(message: Any, reader: str) -> None:
    """Raise VersionMismatch if a message is of another version; that is the reason to name,
    whatever else is wrong with it.
    """
    if type(message) is dict:
        version = message.get("v")
        if type(version) is not int or version != PROTOCOL:
            raise VersionMismatch(mismatch(version, reader))
