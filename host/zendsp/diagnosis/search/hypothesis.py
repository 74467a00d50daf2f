"""Hypotheses of a search and what becomes of them: rivals, steps, and their price."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

UNSETTLED = 24.0  # rad/s: a model that needs a faster observer still lacks something
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
