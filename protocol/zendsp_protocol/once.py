"""The identity of a request that changes something: it is carried out once, however often it is
sent.

A link that breaks may lose the request or its reply, and a host cannot tell which. So it sends the
same request again, with the same identity, as an attachment of the message: the target knows it,
and answers as it did the first time.
"""

from __future__ import annotations

import struct

FIRST, AGAIN, SETTLE = 0, 1, 2
_FORM = struct.Struct(">8sQ8sB")


# link: 8 random bytes, of the host's connection; number: of the request, rising within the
# connection; instance: 8 random bytes, of the run of the target that the host knows, which is
# another after each start; attempt: FIRST; AGAIN: it was sent before; SETTLE: tell how it ended,
# and if it did not come, never carry it out.
stamp = _FORM.pack  # link, number, instance, attempt


def read_stamp(data: bytes) -> tuple[bytes, int, bytes, int]:
    """Decode an attachment into link, number, instance and attempt.

    Raises
    ------
    ValueError
        It is none.
    """
    try:
        return _FORM.unpack(data)  # type: ignore[return-value]
    except struct.error as error:
        raise ValueError(
            f"an attachment of a request has {_FORM.size} bytes, not {len(data)}; see"
            " docs/protocol.md"
        ) from error
