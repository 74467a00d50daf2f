"""The version of what goes over the wire."""

from __future__ import annotations

PROTOCOL = 1
"""Raised whenever an old host would misread a new target. New verbs and new optional fields do not
raise it.
"""


def mismatch(theirs: object, who_asks: str) -> str:
    """The sentence about a peer of another version.

    Parameters
    ----------
    theirs : object
        The version that the other side sent; None where it sent none.
    who_asks : str
        ``"host"`` or ``"target"``: the side that reads the sentence.
    """
    other = "target" if who_asks == "host" else "host"
    said = (
        f"speaks protocol {theirs}"
        if isinstance(theirs, int)
        else "sent a message without a protocol version"
    )
    if isinstance(theirs, int):
        older = who_asks if theirs > PROTOCOL else other
        advice = f"upgrade zendsp on the {older}"
    else:
        advice = "every message needs the field v; see docs/protocol.md"
    return f"the {other} {said}, the {who_asks} speaks protocol {PROTOCOL}: {advice}"
