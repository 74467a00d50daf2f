"""Hypotheses of a search and what becomes of them: rivals, steps, and their price."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.physics.effects import get_effect
from zendsp.physics.fit import Fit
from zendsp.physics.model import Model, Term

UNSETTLED = 24.0  # rad/s: a model that needs a faster observer still lacks something
SIGNIFICANT = 3.0  # standard deviations: a score of hypotheses is tried in every round
SUFFICIENT = 0.8  # share of the best gain with which a simpler hypothesis goes first


@dataclass(frozen=True)
class Rival:
    """A hypothesis that was fitted: what it adds to the model before it, and how likely it made the
    recording.
    """

    effect: str
    joint: int
    scored: Scored
    price: float  # deviance that its free parameters and the size of the search cost
    terms: tuple[Term, ...]
    replaces: tuple[str, ...]
    rank: float = math.nan  # gain by which hypotheses are ordered, see Searcher.order

    @property
    def value(self) -> float:
        """Deviance with the price, the lower the better."""
        return self.scored.deviance + self.price


@dataclass(frozen=True)
class Step:
    """One accepted effect, with the hypotheses that stood beside it."""

    chosen: Rival
    rivals: tuple[Rival, ...]
    before: Scored
    alone: bool = True  # it passed by itself, not only together with what came after it


@dataclass
class JointSearch:
    """What the search found at one joint."""

    joint: int
    base: Scored
    steps: list[Step] = field(default_factory=list)
    best: Scored | None = None
    dropped: tuple[str, ...] = ()
    tried: list[Rival] = field(default_factory=list)
    discarded: bool = False  # what was found left most of the mismatch

    @property
    def final(self) -> Scored:
        """The best model."""
        return self.best or self.base


def price(terms: Sequence[Term], n: int, replacing: Sequence[str] = ()) -> float:
    """What the free parameters of some terms cost in deviance: BIC, and a grid searched counts as a
    parameter more.
    """
    count = 0.0
    for term in terms:
        effect = get_effect(term.effect)
        count += (
            sum(1 for p in effect.parameters if p.fitted)
            + (1 if effect.grid or effect.hidden else 0)
            - effect.odds
        )
        if effect.name in replacing:
            count -= 1
    return count * math.log(max(n, 10))


def _essence(effect: str) -> tuple[str, ...]:
    entry = get_effect(effect)
    return entry.essence or (entry.linear if len(entry.linear) == 1 and not entry.replaces else ())


def with_numbers(model: Model, effect: str, joint: int, numbers: Mapping[str, float]) -> Model:
    """The model with some numbers of a joint's (1-based) terms of one effect set."""

    def changed(term: Term) -> Term:
        if (term.effect, term.joint) != (effect, joint):
            return term
        return Term(
            effect,
            joint,
            {
                **term.parameters,
                **{n: replace(term.parameters[n], value=v) for n, v in numbers.items()},
            },
        )

    return model.with_terms(tuple(map(changed, model.terms)))


def sizes(effect: str) -> tuple[str, ...]:
    """Names of the numbers that say how large an effect is."""
    entry = get_effect(effect)
    return (
        _essence(effect) or entry.linear or tuple(p.name for p in entry.parameters if p.fitted)[:1]
    )


def counterpart(terms: Sequence[Term], term: Term) -> Term:
    """The same term in another fit of the model, where its fitted numbers have moved.

    A joint may have several terms of one effect: they are told apart by what no fit moves (a
    coupling's law and its joint), then by how often they repeat (a ripple's order, the period of a
    friction that varies with position).

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
    """Whether a number that makes an effect what it is cannot be told from zero, or from endless,
    or lies at the bound of what can be seen.
    """
    effect, same = term.effect, counterpart(fitted.model.terms, term)
    own = {
        handle.key: i
        for i, handle in enumerate(fitted.handles)
        if handle.place == "term" and fitted.model.terms[handle.index] is same
    }
    for key in _essence(effect):
        if key not in own:
            continue
        i = own[key]
        variance = float(fitted.covariance[i, i])
        shape = own.get(get_effect(effect).shape)
        if shape is not None and fitted.covariance[shape, shape] > 0:
            variance -= float(fitted.covariance[i, shape] ** 2 / fitted.covariance[shape, shape])
        if fitted.at_bound[i] or abs(fitted.x[i]) < SIGNIFICANT * math.sqrt(max(variance, 0.0)):
            return True
    return False
