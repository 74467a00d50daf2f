"""The numbers of one term in a fit, and whether they differ from zero."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.physics.calibration.fit import Fit
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Term

SIGNIFICANT = 3.0  # standard deviations: every round tries some twenty hypotheses
# of a number, rad for angles: difference between any two simulators
INTEGRATION_ERROR = 2e-3


def essence_of(effect: str) -> tuple[str, ...]:
    """The parameters without which an effect vanishes, such as the level of Coulomb friction."""
    entry = get_effect(effect)
    return entry.essence or (entry.linear if len(entry.linear) == 1 and not entry.replaces else ())


def counterpart(terms: Sequence[Term], term: Term) -> Term:
    """The same term in another fit of the model, with other fitted numbers.

    A joint may have several terms of one effect. They are distinguished first by numbers that no
    fit moves (a coupling's law and joint), then by how often they repeat (a ripple's order, the
    period of a friction over position).

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
    """Whether an essential number of an effect cannot be told from zero or infinity, or lies at the
    bound of what can be seen.
    """
    own = _numbers_of(fitted, term)
    return any(
        fitted.at_bound[own[key]]
        or abs(fitted.x[own[key]]) < SIGNIFICANT * essential_deviation(fitted, term, key)
        for key in essence_of(term.effect)
        if key in own
    )


def essential_deviation(fitted: Fit, term: Term, key: str) -> float:
    """Standard deviation of an essential number with the effect's shape held fixed: at size zero
    the shape is undefined. Other correlations stay: a weight may hide partly behind the model's
    own.
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
    """The indices of a term's free numbers in a fit."""
    same = counterpart(fitted.model.terms, term)
    return {
        handle.key: i
        for i, handle in enumerate(fitted.handles)
        if handle.place == "term" and fitted.model.terms[handle.index] is same
    }


def whole(name: str, value: float, travel: float) -> float:
    """The scale of a relative error of a number. For the order or period of a pattern: the change
    that shifts its phase over the ``travel`` by one radian, since positions themselves are
    measured.
    """
    if name == "order":
        return 1.0 / travel
    if name == "period":
        return value * value / (2 * math.pi * travel)
    return 1.0 if name in ("phase", "angle") else abs(value)
