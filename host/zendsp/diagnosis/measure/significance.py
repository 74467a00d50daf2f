"""What a fit says of one term of its model: its numbers, and whether they differ from nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.physics.calibration.fit import Fit
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Term

SIGNIFICANT = 3.0  # standard deviations: a score of hypotheses is tried in every round
# of a number, rad for angles: what any two simulators' equations do differently
INTEGRATION_ERROR = 2e-3


def essence_of(effect: str) -> tuple[str, ...]:
    """Parameters without which an effect is none, as the torque of Coulomb friction."""
    entry = get_effect(effect)
    return entry.essence or (entry.linear if len(entry.linear) == 1 and not entry.replaces else ())


def counterpart(terms: Sequence[Term], term: Term) -> Term:
    """The same term in another fit of the model, where its fitted numbers have moved.

    A joint may have several terms of one effect. They are told apart first by what no fit moves: a
    coupling's law and its joint. Then by how often they repeat: a ripple's order, the period of a
    friction that varies with position.

    Raises
    ------
    LookupError
        No term is of that effect at that joint.
    """
    settings = [p.name for p in get_effect(term.effect).parameters if not p.fitted]

    def unlike(t: Term) -> tuple[bool, int, float]:
        repeats = sum(abs(t.value(n) - term.value(n)) for n in ("order", "period"))
        return t is not term, sum(t.value(n) != term.value(n) for n in settings), repeats

    alike = [t for t in terms if (t.effect, t.joint) == (term.effect, term.joint)]
    if not alike:
        raise LookupError(
            f"no {term.effect} at joint {term.joint} among"
            f" {', '.join(t.effect for t in terms) or 'no terms'}"
        )
    return min(alike, key=unlike)


def vanishes(fitted: Fit, term: Term) -> bool:
    """Whether a number that makes an effect what it is cannot be told from zero or infinity, or
    lies at the bound of what can be seen.
    """
    own = _numbers_of(fitted, term)
    return any(
        fitted.at_bound[own[key]]
        or abs(fitted.x[own[key]]) < SIGNIFICANT * essential_deviation(fitted, term, key)
        for key in essence_of(term.effect)
        if key in own
    )


def essential_deviation(fitted: Fit, term: Term, key: str) -> float:
    """Standard deviation of a number that makes an effect what it is, its shape known: without any
    size there is no shape, and a weight may hide behind the model's own but for a part.
    """
    own = _numbers_of(fitted, term)
    i, shape = own[key], own.get(get_effect(term.effect).shape)
    variance = float(fitted.covariance[i, i])
    if shape is not None and fitted.covariance[shape, shape] > 0:
        variance -= float(fitted.covariance[i, shape] ** 2 / fitted.covariance[shape, shape])
    return math.sqrt(max(variance, 0.0))


def deviation(fitted: Fit, term: Term, key: str) -> float:
    """Standard deviation of one number of a term; 0 where it is held."""
    at = _numbers_of(fitted, term).get(key)
    return 0.0 if at is None else float(fitted.std[at])


def _numbers_of(fitted: Fit, term: Term) -> dict[str, int]:
    """Where a term's free numbers stand in a fit."""
    same = counterpart(fitted.model.terms, term)
    return {
        handle.key: i
        for i, handle in enumerate(fitted.handles)
        if handle.place == "term" and fitted.model.terms[handle.index] is same
    }


def whole(name: str, value: float, travel: float) -> float:
    """What a relative error refers to; of how often a pattern repeats, a phase that drifts by it
    over the ``travel``: the positions themselves are measured.
    """
    if name == "order":
        return 1.0 / travel
    if name == "period":
        return value * value / (2 * math.pi * travel)
    return 1.0 if name in ("phase", "angle") else abs(value)
