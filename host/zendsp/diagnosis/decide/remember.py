"""The model file that a diagnosis leaves for the next recording of the same machine."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.rivals import replaced
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Discrepancy, Model, Term


def remembered(
    model: Model, given: Model, decisions: Sequence[Decision], findings: Sequence[Finding]
) -> Model:
    """The improved model for the next diagnosis: with the torque that stayed unexplained at each
    joint, the uncertainties of the findings, and the numbers of refinements held fixed.

    A refinement is no claimed physics; if free it would be bent to what the next recording lacks.

    Parameters
    ----------
    model : Model
        Improved, or calibrated where nothing is missing.
    decisions : sequence of Decision
        One a joint, in their order.
    """
    hold: set[tuple[str, int, int]] = set()
    for d in decisions:
        final = d.final.model
        numbers = dict(zip(map(id, final.terms), _numbered(final.terms), strict=True))
        hold |= {
            numbers[id(c.term)]
            for c in d.refinements
            if id(c.term) in numbers and not replaced(given, final, c.term)
        }
    terms = (
        term.held() if number in hold else _stated(term, findings)
        for term, number in zip(model.terms, _numbered(model.terms), strict=True)
    )
    left = Discrepancy(
        tuple(d.after.value * d.scale for d in decisions),
        tuple(d.state.size * d.scale for d in decisions),
    )
    return replace(model, terms=tuple(terms), discrepancy=left)


def _stated(term: Term, findings: Sequence[Finding]) -> Term:
    """A term with the standard deviations of the finding for it. A number of a transmission that
    two sensors tell better than a fit to one keeps their value and is held, since another fit would
    lose it.
    """
    numbers, between = dict(term.parameters), get_effect(term.effect).family == "transmission"
    for f in findings:
        if (f.effect, f.joint) != (term.effect, term.joint):
            continue
        for name, e in f.parameters.items():
            q = numbers.get(name)
            if q is not None and e.value == q.value:
                numbers[name] = replace(q, std=e.std)
            elif q is not None and between and q.free and 0.0 < e.std < q.std:
                numbers[name] = replace(q, value=e.value, std=e.std, free=False)
    return replace(term, parameters=numbers)


def as_reported(model: Model, stated: Sequence[Finding]) -> Model:
    """A model of a file with the standard deviations of the report, where it has its numbers: a
    breakaway of a file is a friction, in the search it is what that has above the Coulomb level.
    """
    terms = []
    for term in model.terms:
        numbers = dict(term.parameters)
        for f in stated:
            if (f.effect, f.joint) == (term.effect, term.joint):
                numbers |= {
                    name: replace(numbers[name], std=e.std)
                    for name, e in f.parameters.items()
                    if name in numbers and math.isclose(e.value, numbers[name].value)
                }
        terms.append(replace(term, parameters=numbers))
    return replace(model, terms=tuple(terms))


def _numbered(terms: Sequence[Term]) -> list[tuple[str, int, int]]:
    """Keys of the terms: effect, joint, and the count of equal ones before it. They find a term
    again in another model of the machine.
    """
    seen: Counter[tuple[str, int]] = Counter()
    out = []
    for t in terms:
        out.append((t.effect, t.joint, seen[t.effect, t.joint]))
        seen[t.effect, t.joint] += 1
    return out
