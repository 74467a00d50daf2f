"""The identity of a request that changes something: it is carried out once, however often it is sent.

A link that breaks may lose the request or its reply, and a host cannot tell which. So it sends the same request again, with the
same identity, as an attachment of the message: the target knows it, and answers as it did the first time.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

# Of every other verb it does not matter how often it is carried out: it reads, or it is STOP, or it names its own place in the data.
ONCE = frozenset((
    "load", "unload", "start", "pause", "write", "update", "set_limits", "set_drive", "set_ramp", "set_overrun", "set_inputs", "home",
    "acknowledge", "drive", "acquire_configure", "acquire_start", "acquire_stop", "table_begin", "table_commit", "live_open", "live_close",
))  # fmt: skip
FIRST, AGAIN, SETTLE = 0, 1, 2
_FORM = struct.Struct(">8sQ8sB")


class Stamp(NamedTuple):
    """What the attachment says.

    Attributes
    ----------
    link : bytes
        8, random: the host's connection.
    number : int
        Of the request, rising within the connection.
    instance : bytes
        8, random: the run of the target that the host knows; a target that was started again has another.
    attempt : int
        ``FIRST``; ``AGAIN``: it was sent before; ``SETTLE``: tell how it ended, and if it did not come, never carry it out.
    """

    link: bytes
    number: int
    instance: bytes
    attempt: int


stamp = _FORM.pack  # link, number, instance, attempt


def read_stamp(data: bytes) -> Stamp:
    """Decode an attachment.

    Raises
    ------
    ValueError
        It is none.
    """
    try:
        return Stamp(*_FORM.unpack(data))
    except struct.error as error:
        raise ValueError(f"an attachment of a request has {_FORM.size} bytes, not {len(data)}; see docs/protocol.md") from error
