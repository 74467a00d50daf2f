"""The data of a search: rivals, steps, and the price of their parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.physics.calibration.fit import Fit
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

UNSETTLED = 24.0  # rad/s: a model that needs a faster observer still lacks something
SUFFICIENT = 0.8  # share of the best gain from which a simpler hypothesis goes first


@dataclass(frozen=True)
class Rival:
    """A fitted hypothesis: the terms that it adds to the model before it, and its likelihood."""

    effect: str
    joint: int
    scored: Scored
    price: float  # in deviance, of its free parameters and the size of the search
    terms: tuple[Term, ...]
    replaces: tuple[str, ...]
    rank: float = math.nan  # gain by which hypotheses are ordered, see Searcher.order

    @property
    def value(self) -> float:
        """The deviance plus the price; lower is better."""
        return self.scored.deviance + self.price


@dataclass(frozen=True)
class Step:
    """One accepted effect, with the rival hypotheses of its round."""

    chosen: Rival
    rivals: tuple[Rival, ...]
    before: Scored
    alone: bool = True  # it passed by itself, not only together with the next step


@dataclass(frozen=True)
class FineRipple:
    """A ripple above the band of the search, fitted under a fast observer.

    ``share``: of all torque that was found. ``alone``: fits of its amplitude and phase to each
    recording, where its phase differs between them.
    """

    term: Term
    fit: Fit  # its last term is the ripple
    share: float
    alone: tuple[Fit, ...]


@dataclass
class JointSearch:
    """The result of the search at one joint. ``fine``: fast ripples that the base has already."""

    joint: int
    base: Scored
    steps: list[Step] = field(default_factory=list)
    best: Scored | None = None
    dropped: tuple[str, ...] = ()
    tried: list[Rival] = field(default_factory=list)
    fine: tuple[FineRipple, ...] = ()

    @property
    def final(self) -> Scored:
        """The best model."""
        return self.best or self.base


def price(terms: Sequence[Term], n: int, replacing: Sequence[str] = ()) -> float:
    """The price of the free parameters of some terms in deviance: BIC, where a searched grid counts
    as one more parameter.
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
