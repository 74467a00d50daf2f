"""What a model file keeps of a diagnosis for the next recording of the same machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.fast_ripple import fixed
from zendsp.diagnosis.decide.laws import replaced
from zendsp.physics.model import Discrepancy, Model, Term


def remembered(model: Model, given: Model, decisions: Sequence[Decision]) -> Model:
    """The improved model as the next diagnosis should get it: with the torque that stayed
    unexplained at each joint, and the numbers of what only refined the fit held.

    A refinement is no physics that is claimed: free, it would be bent to what the next recording
    lacks.

    Parameters
    ----------
    model : Model
        Improved, or calibrated where nothing is missing.
    given : Model
    decisions : sequence of Decision
        One a joint, in their order.
    """
    hold: set[int] = set()
    for d in decisions:
        mine = _numbered(d.final.model.at(d.joint))
        there = {key: i for i, key in _numbered(model.terms) if model.terms[i].joint == d.joint}
        for claim in d.refinements:
            term = claim.term
            row = next((key for i, key in mine if d.final.model.at(d.joint)[i] is term), None)
            if row in there and not replaced(given, d.final.model, term):
                hold.add(there[row])
    terms = (fixed(t) if i in hold else t for i, t in enumerate(model.terms))
    left = Discrepancy(
        tuple(d.after.value * d.scale for d in decisions),
        tuple(d.state.size * d.scale for d in decisions),
    )
    return replace(model, terms=tuple(terms), discrepancy=left)


def _numbered(terms: Sequence[Term]) -> list[tuple[int, tuple[str, int, int]]]:
    """Rows of some terms, each with effect, joint and its number among those of both."""
    seen: dict[tuple[str, int], int] = {}
    out = []
    for i, t in enumerate(terms):
        count = seen.get((t.effect, t.joint), 0)
        seen[t.effect, t.joint] = count + 1
        out.append((i, (t.effect, t.joint, count)))
    return out

