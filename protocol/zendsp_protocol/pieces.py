"""Limits the work of decoding a message, which is counted before it is done.

A decoder written in C holds up every other thread until it is done, STOP too: 20 MB of empty maps
took it four seconds and a gigabyte. Large messages that are allowed consist of few long texts and
packed arrays.
"""

from __future__ import annotations

from zendsp_protocol.errors import LinkError

SMALL = 65536  # bytes: what is smaller is decoded in milliseconds, whatever it holds
MOST = 100_000  # pieces: numbers, texts, lists, maps
# bytes behind the first by its value: whole, and of the length of what follows
_WHOLE = {0xCA: 4, 0xCB: 8, **{0xCC + k: 1 << k % 4 for k in range(8)}}
_WHOLE |= {**{0xD4 + k: 1 + (1 << k) for k in range(5)}, 0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}
_TEXT = {0xD9: 1, 0xDA: 2, 0xDB: 4}
_BYTES = {0xC4: 1, 0xC5: 2, 0xC6: 4}
_OTHER = {0xC7: 1, 0xC8: 2, 0xC9: 4}  # with a byte more, of the kind
_LENGTH = _TEXT | _BYTES | _OTHER


def check_pieces(data: bytes, texts: bool) -> None:
    """Refuse MessagePack that would take long to decode.

    Parameters
    ----------
    texts : bool
        Whether it may hold texts of more than `SMALL` bytes, as programs are.

    Raises
    ------
    LinkError
    """
    if len(data) <= SMALL:
        return
    at = pieces = 0
    while at < len(data):
        first = data[at]
        at += 1
        pieces += 1
        if pieces > MOST:
            raise LinkError(
                f"a request of more than {MOST} numbers, texts, lists and maps is not taken: send"
                " arrays packed (docs/protocol.md)"
            )
        if first in _LENGTH:
            behind = at + _LENGTH[first]
            length = int.from_bytes(data[at:behind], "big")
            if first in _TEXT and length > SMALL and not texts:
                raise LinkError(f"a text of {length} bytes: {SMALL} at most here")
            at = behind + length + (first in _OTHER)
        elif 0xA0 <= first <= 0xBF:
            at += first - 0xA0
        else:
            at += _WHOLE.get(first, 0)
