"""Which of the chosen terms the untouched recordings need, and what they would have shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.decide.claims import LAWS_OF
from zendsp.diagnosis.decide.thresholds import FALSE_DISCOVERIES, PLAIN, SURE
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.transmission.sets import Sets
from zendsp.diagnosis.transmission.terms import Chosen, applied, fitted, may_be_off, physical
from zendsp.diagnosis.transmission.torsion import (
    Array,
    Twist,
    columns_of,
    evidence,
    judged,
    regress,
    rms,
)
from zendsp.physics.model import Model

POWER = 1.28  # standard deviations: nine in ten
ENOUGH = 1.0  # of what stays unexplained: what is less is no finding


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


def needed(model: Model) -> float:
    return math.log(model.joints * len(LAWS_OF) / FALSE_DISCOVERIES)


def unexplained(residual: Sequence[Array], twists: Sequence[Twist]) -> float:
    noise = max(t.noise for t in twists)
    return math.sqrt(max(rms(judged(twists, residual)) ** 2 - noise**2, 0.0))


def apart(twists: Sequence[Twist], one: Sequence[Array], other: Sequence[Array]) -> float:
    """RMS difference of two residuals where they are evidence."""
    return rms(judged(twists, [a - b for a, b in zip(one, other, strict=True)]))


def claims_of(slow: Sets, chosen: Chosen, scale: float, model: Model) -> list[Claim]:
    """The chosen terms, each taken away and judged on the untouched recordings.

    A disc off centre may explain a short piece as well as a spring does: the spring is judged with
    it and without. Where the recordings of the fit do not tell them apart, that is said.
    """
    alike = "spring" in chosen.terms and _like_a_disc(slow, scale, model)
    out = []
    for term in chosen.terms:
        claim = _judged(slow, chosen, term, scale, model)
        if claim is None and term == "spring" and may_be_off(slow):
            off = not chosen.off_centre
            other = replace(chosen, off_centre=off, fit=fitted(slow.fit, chosen.terms, off, scale))
            if physical(other.terms, other.fit.x):
                claim = _judged(slow, other, term, scale, model)
        if claim is not None:
            same = ("encoder_eccentricity",) if alike and term == "spring" else ()
            out.append(replace(claim, same=same))
    return out


def _judged(slow: Sets, chosen: Chosen, term: str, scale: float, model: Model) -> Claim | None:
    with_all = applied(slow.test, chosen.terms, chosen.off_centre, scale, chosen.fit.x)
    left = unexplained(with_all, slow.test)
    gone = ("spring", "cubic") if term == "spring" else (term,)
    rest = tuple(t for t in chosen.terms if t not in gone)
    again = fitted(slow.fit, rest, chosen.off_centre, scale)
    without = applied(slow.test, rest, chosen.off_centre, scale, again.x)
    found, log_e = evidence(without, with_all, slow.test)
    size = apart(slow.test, without, with_all)
    at = sum(2 if t == "spring" else 1 for t in chosen.terms[: chosen.terms.index(term)])
    x, std = chosen.fit.x, np.sqrt(np.maximum(np.diag(chosen.fit.covariance), 0.0))
    value, spread = float(x[at]), float(std[at])
    sure = log_e > needed(model) and found.z > PLAIN and abs(value) > SURE * spread
    if not sure or size <= ENOUGH * left:
        return None
    damping = (0.0, 0.0)
    if term == "spring":
        damping = float(x[at + 1]) / value, float(std[at + 1]) / abs(value)
    return Claim(term, value, spread, found, log_e, size, left, damping=damping)


def _like_a_disc(slow: Sets, scale: float, model: Model) -> bool:
    """Whether a disc off centre explains the fit recordings as well as a spring beside it does."""
    if not may_be_off(slow):
        return False
    disc, both = (fitted(slow.fit, terms, True, scale) for terms in ((), ("spring",)))
    _, log_e = evidence(disc.residual, both.residual, slow.fit)
    return log_e < needed(model) or both.x[0] >= 0


def least_compliance(slow: Sets, chosen: Chosen, scale: float, model: Model) -> float:
    """The smallest compliance that would have been claimed, with 90 % probability."""
    columns = [columns_of(t, ("spring",), scale)[:, :1] for t in slow.test]
    alone = regress(slow.test, columns, chosen.off_centre)
    nothing = regress(slow.test, columns, chosen.off_centre, np.zeros(1))
    unit = regress(
        [replace(t, torsion=t.torque) for t in slow.test], columns, chosen.off_centre, np.zeros(1)
    )
    size = max(rms(unit.residual), 1e-300)
    count = sum(len(r) for r in alone.residual)
    error = math.hypot(
        math.sqrt(float(alone.covariance[0, 0])),
        max(t.noise for t in slow.test) / (size * math.sqrt(count)),
    )
    root = POWER + math.sqrt(POWER**2 + 2.0 * needed(model))
    left = unexplained(nothing.residual, slow.test)
    return max(root * error, left / size)
