"""Host and target of one protocol, of which one is newer: what the other does not know is said."""

from __future__ import annotations

from typing import Any

from zendsp.errors import LinkError, VersionMismatch, ZendspError
from zendsp_protocol import codec
from zendsp_protocol.verbs import Verb


def explained(error: ZendspError, target: str, row: Verb, request: bytes, reply: bytes) -> Any:
    """The error to raise for one that a reply brought, or that came of reading it.

    A target that declines as malformed what is well-formed here is older than this host. A yes that
    cannot be read here is of a target of another version. All else is returned as it is.

    Parameters
    ----------
    error : ZendspError
        As `codec.decode_reply` raised it.
    target : str
        Its name.
    row : Verb
        That was asked.
    request, reply : bytes
        As they went over the wire.
    """
    if type(error) is not LinkError:
        return error
    again = "end the target and start it again with the zendsp of this host"
    if not codec.declined(reply):
        return VersionMismatch(
            f"target {target!r} is of another version of zendsp: its answer to {row.name!r} cannot"
            f" be read here ({error}); {again}"
        )
    try:
        codec.decode_request(request, row.lane)
    except ZendspError:  # wrong here too: the one who asked made the mistake
        return error
    return VersionMismatch(
        f"target {target!r} is of an older version of zendsp than this host, and does not know all"
        f" of {row.name!r}: nothing was done ({error}); {again}"
    )
