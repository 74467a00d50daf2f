"""The chosen terms that the untouched recordings need, and the compliance that these would have
shown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.decide.claims import needed
from zendsp.diagnosis.decide.thresholds import PLAIN, SURE
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.transmission.sets import Sets
from zendsp.diagnosis.transmission.terms import (
    INSTEAD,
    Chosen,
    applied,
    fitted,
    may_be_off,
    physical,
)
from zendsp.diagnosis.transmission.torsion import Array, Twist, judged
from zendsp.diagnosis.transmission.torsion_fit import evidence, numbers_of, rms
from zendsp.physics.model import Model

AS_EFFECT = {"spring": "elasticity", "gap": "backlash", "step": "hysteresis"}
# terms that only modify another one, and vanish with it
BEND = {"spring": ("cubic", "loop")}
ENOUGH = 1.0  # of what stays unexplained: a smaller term is no finding


@dataclass(frozen=True)
class Claim:
    """One term that the untouched recordings need."""

    name: str
    value: float
    std: float
    evidence: Evidence
    log_e: float
    size: float  # RMS, rad or m
    left: float  # RMS of what stays unexplained beyond the sensors' noise
    order: float = 0.0
    phase: float = 0.0
    order_std: float = 0.0
    damping: tuple[float, float] = (0.0, 0.0)
    same: tuple[str, ...] = ()


def unexplained(residual: Sequence[Array], twists: Sequence[Twist]) -> float:
    """RMS torsion left beyond the sensors' noise, rad."""
    noise = max(t.noise for t in twists)
    return math.sqrt(max(rms(judged(twists, residual)) ** 2 - noise**2, 0.0))


def apart(twists: Sequence[Twist], one: Sequence[Array], other: Sequence[Array]) -> float:
    """RMS difference of two residuals where they are evidence."""
    return rms(judged(twists, [a - b for a, b in zip(one, other, strict=True)]))


def claims_of(slow: Sets, chosen: Chosen, scale: float, model: Model) -> list[Claim]:
    """The claims among the chosen terms: each is taken away and judged on the untouched recordings.
    An unneeded one is removed and the rest fitted again, since a false spring makes a gap too
    narrow.

    An eccentric encoder disc may explain a short piece as well as a spring, so a spring is judged
    with and without it. Where the recordings of the fit cannot separate them, the claim says so.
    """
    found = _judged_each(slow, chosen, scale, model)
    idle = [t for t in chosen.terms if t not in {claim.name for claim in found}]
    if not idle:
        return found
    terms = _without(chosen.terms, idle[-1])
    again = fitted(slow.fit, terms, chosen.off_centre, scale)
    if not physical(terms, again, scale):
        return [claim for claim in found if claim.name in terms]
    return claims_of(slow, replace(chosen, terms=terms, fit=again), scale, model)


def _without(terms: Sequence[str], term: str) -> tuple[str, ...]:
    """The terms without one, and without those that only modify it."""
    gone = (term, *BEND.get(term, ()))
    return tuple(t for t in terms if t not in gone)


def _judged_each(slow: Sets, chosen: Chosen, scale: float, model: Model) -> list[Claim]:
    alike = "spring" in chosen.terms and _like_a_disc(slow, scale, model)
    out = []
    for term in chosen.terms:
        claim = _judged(slow, chosen, term, scale, model)
        if claim is None and term == "spring" and may_be_off(slow):
            off = not chosen.off_centre
            other = replace(chosen, off_centre=off, fit=fitted(slow.fit, chosen.terms, off, scale))
            if physical(other.terms, other.fit, scale):
                claim = _judged(slow, other, term, scale, model)
        if claim is not None:
            same = ["encoder_eccentricity"] if alike and term == "spring" else []
            same += [AS_EFFECT[INSTEAD[term]]] if term in chosen.unsure else []
            out.append(replace(claim, same=tuple(same)))
    return out


def _judged(slow: Sets, chosen: Chosen, term: str, scale: float, model: Model) -> Claim | None:
    with_all = applied(slow.test, chosen.terms, chosen.off_centre, scale, chosen.fit.x)
    left = unexplained(with_all, slow.test)
    rest = _without(chosen.terms, term)
    without = min(
        (
            applied(slow.test, rest, off, scale, fitted(slow.fit, rest, off, scale).x)
            for off in {chosen.off_centre, False}
        ),
        key=lambda residual: rms(judged(slow.test, residual)),
    )
    found, log_e = evidence(without, with_all, slow.test)
    size = apart(slow.test, without, with_all)
    value, spread = numbers_of(chosen.terms, chosen.fit, scale)[term]
    sure = log_e > needed(model.joints) and found.z > PLAIN and abs(value) > SURE * spread
    if not sure or size <= ENOUGH * left:
        return None
    if term == "gap" and "spring" not in chosen.terms:  # the contact's yielding is in its width
        both = fitted(slow.fit, ("spring", "gap"), chosen.off_centre, scale)
        if physical(("spring", "gap"), both, scale):
            spread = math.hypot(spread, numbers_of(("spring", "gap"), both, scale)[term][0] - value)
    damping = (0.0, 0.0)
    if term == "spring":
        # its damping comes second, as a spring is the first term of any choice. A torque late by a
        # row looks like damping; for a gap the rows that would show it are crossings
        std = math.hypot(math.sqrt(float(chosen.fit.covariance[1, 1])), slow.test[0].row)
        std = math.inf if "gap" in chosen.terms else std / abs(value)
        damping = float(chosen.fit.x[1]) / value, std
    return Claim(term, value, spread, found, log_e, size, left, damping=damping)


def _like_a_disc(slow: Sets, scale: float, model: Model) -> bool:
    """Whether an eccentric disc alone explains the fit recordings as well as a spring beside it."""
    if not may_be_off(slow):
        return False
    disc, both = (fitted(slow.fit, terms, True, scale) for terms in ((), ("spring",)))
    _, log_e = evidence(disc.residual, both.residual, slow.fit)
    return log_e < needed(model.joints) or both.x[0] >= 0
