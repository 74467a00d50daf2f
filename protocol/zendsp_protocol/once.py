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
read_stamp = _FORM.unpack  # raises struct.error
STAMP_SIZE = _FORM.size
