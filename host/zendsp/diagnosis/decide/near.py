"""The likeliest law where none is claimed, and the reason that it is not, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from zendsp.diagnosis.decide.claims import Decision, Near, Piece
from zendsp.diagnosis.decide.contract import Rejected, Verdict, nearest
from zendsp.diagnosis.decide.findings import percent
from zendsp.diagnosis.measure.discrepancy import Size

LEAVES_MORE = "it leaves more of what its variables predict than a law may"
BENT_CURVE = "a curve that differs from it a little, which is no law with a name, predicts as well"
TWIN = "its wave and one like it of another mechanism imitate a third"
NOT_APART = "its variables do not tell it from other mechanisms"
NO_BETTER = "with it untouched recordings are predicted no better"


def why_apart(size: float, left: float, error: float, larger: float) -> str:
    """The reason that a mechanism of this size is not claimed: what stays unexplained, or the error
    of ``larger`` laws, is as large. All are parts of the RMS torque.

    Examples
    --------
    >>> why_apart(0.009, 0.001, 0.012, 0.4)
    'known laws, of 40 % of the torque, may be wrong by as much'
    >>> why_apart(0.009, 0.02, 0.0, 0.4)
    '2 % of the torque that its variables predict is left beside it'
    """
    if size > math.hypot(left, error):
        return "untouched recordings do not surely show it"
    if error >= size:
        return f"known laws, of {percent(larger)} % of the torque, may be wrong by as much"
    if left >= size:
        return f"{percent(left)} % of the torque that its variables predict is left beside it"
    return "it is no larger than what is left beside it and what known laws may be wrong by"


def why_curve(ways: Mapping[str, bool]) -> str:
    """The reason that a law only imitates the missing torque: the first of the ``ways`` that holds.
    """
    return next((why for why, holds in ways.items() if holds), "")


def bent(likely: Sequence[str]) -> str:
    """The reason that a law is doubted of which a neighbour predicts as well: neighbours have no
    names; the other laws that are ``likely`` have.

    Examples
    --------
    >>> bent(["hysteresis", "presliding"]).removeprefix(BENT_CURVE)
    '; so may hysteresis or presliding'
    """
    return BENT_CURVE + (f"; so may {' or '.join(likely)}" if likely else "")


def doubt(sure: float) -> str:
    """The reason that a named law is doubted: the confidence ``sure`` of such a finding.

    Examples
    --------
    >>> doubt(0.33)
    'such a law is right in 33 of 100 cases'
    """
    return f"such a law is right in {100 * sure:.0f} of 100 cases"


def with_reasons(
    claimed: Sequence[Piece], rest: Sequence[Piece], first: Decision | None, fell: Decision | None
) -> list[Piece]:
    """The tested pieces, each with the reason that it is not claimed.

    Parameters
    ----------
    first, fell : Decision or None
        The decision after naming, and the one after doubted laws were removed.
    """
    reasons: dict[str, str] = {}
    if first is not None and fell is not None:
        # no law was sure, and no mechanism without one
        reasons = dict.fromkeys((e for p in claimed for e in p.effects), NOT_APART)
        reasons |= {c.term.effect: c.why for c in fell.refinements if c.why}
        reasons |= {c.term.effect: c.why or NO_BETTER for c in fell.claims}
        if len(fell.claims) > 1:
            several = "several mechanisms would be needed, and no law of any is sure"
            reasons |= {c.term.effect: several for c in fell.claims}
    said = [next((reasons[e] for e in p.effects if e in reasons), p.why) for p in claimed]
    return [*(replace(p, why=why) for p, why in zip(claimed, said, strict=True)), *rest]


def nearest_law(
    lost: Sequence[Rejected], pieces: Sequence[Piece], before: Size, after: Size
) -> Near | None:
    """The likeliest of the tried laws, where one explains most of the missing torque."""
    named = nearest(Verdict.UNEXPLAINED, lost)
    piece = next((p for e, _ in named for p in pieces if e in p.effects), None)
    if piece is None:
        return None
    beside = dict.fromkeys(e for p in pieces for e in p.effects if e not in piece.effects)
    return Near(named[0][0], before.value, after.value, piece.why, tuple(beside))


def only_in_the_fit(joint: int, effect: str) -> str:
    """A sentence, without full stop, on effects that untouched recordings do not show."""
    return (
        f"Joint {joint}: only the recordings of the fit show {effect}. Look in them for what is"
        " wrong with them alone, if other motion like theirs does not show it either"
    )


def likeness(near: Near) -> str:
    """A sentence, without full stop, on a law that comes near.

    Examples
    --------
    >>> likeness(Near("ripple", 0.013, 0.002, "its waves draw a curve"))[:71]
    'It is most like ripple: with it 0.2 % of the torque stays unexplained, '
    """
    because = f": {near.why}" if near.why else ""
    also = "".join(f" and {effect}" for effect in near.beside)
    return (
        f"It is most like {near.effect}: with it{also} {percent(near.after)} % of the torque stays"
        f" unexplained, without it {percent(near.before)} %. It is not called that{because}"
    )
