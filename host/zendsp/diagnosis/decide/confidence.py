"""The probability that a finding is right.

A logistic regression, learned on findings of known truth from makers of cases that share no code.
Its features: what a law leaves unexplained relative to its size, how many free numbers it has (a
wave that comes out as a whole number a turn has one less), and how small a part it is of the
missing torque that larger ones do not explain. Its reliability was
judged on makers left out of the regression (docs/measurements/diagnosis_choices.md). To repeat it:
`python benchmarks/confidence.py`.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.thresholds import (
    FALSE_DISCOVERIES,
    PLAIN,
    SIMULATORS_DIFFER,
    STATED_ALONE,
    STATED_BESIDE,
)
from zendsp.diagnosis.measure.discrepancy import beyond
from zendsp.diagnosis.measure.significance import deviation
from zendsp.diagnosis.measure.structure import STRUCTURED
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Term

NAMES = ("constant", "unknown", "left", "free", "small")
WEIGHTS = (-0.52, 3.04, 2.40, -0.69, -2.02)
SUREST = 0.97  # of 114 findings with 0.9 and more, on makers left out, 97 % were right
FINEST_KNOWN = 1e-4  # of the RMS torque: no discrepancy is known to be smaller


def sure_by(size: float, left: float) -> float:
    """The probability that a body or a transmission is one, by its size and by what stays
    unexplained beside it, in the same unit; one of them is above 0.
    """
    larger = math.pow(size, 1.5)
    return min(SUREST, larger / (larger + 0.5 * math.pow(left, 1.5)))


def stated(claim: Claim, decision: Decision) -> bool:
    """Whether a law is likely enough to be named. Laws that every machine has need only the
    evidence for their mechanism: a real pendulum had dry friction and drag of 0.7 and 0.3 % of its
    torque beside 0.8 % unexplained.
    """
    common = get_effect(claim.effect).common
    return common or confidence(claim, decision) > _needed(claim.effect, decision)


def likely_enough(name: str, ahead: float, decision: Decision) -> bool:
    """Whether a law that predicts better than its neighbours by so many standard deviations is as
    likely as one has to be that is named.
    """
    return NormalDist().cdf(ahead) > _needed(name, decision)


def _needed(name: str, decision: Decision) -> float:
    """Probability above which an effect's law is named."""
    effect = get_effect(name)
    of_state = mechanism_of(name) in STRUCTURED and effect.family != "timing"
    bends = effect.coupled or (of_state and effect.over != "time")
    return STATED_BESIDE if bends and _left(decision) > SIMULATORS_DIFFER else STATED_ALONE


def least_stated(name: str, decision: Decision) -> float:
    """The least size, as a part of the RMS torque, with which an effect would be named beside what
    this decision leaves, if nothing else were missing.
    """
    effect = get_effect(name)
    if effect.common:
        return 0.0
    constant, _, left, free, _ = WEIGHTS
    needed = _needed(name, decision)
    others = min(max(sum(p.fitted for p in effect.parameters), 1), 3) - 1.0
    decades = (math.log(needed / (1.0 - needed)) - constant - free * others) / left
    return float(10.0 ** max(decades, 0.0) * max(_left(decision), FINEST_KNOWN))


def _left(decision: Decision) -> float:
    """The torque that the claims leave, and the part that depends on the state, beyond the known
    discrepancy of the machine: the best estimate, since the lower end of an interval is the smaller
    the less is known. (A wrong law was 0.71 sure where 0.3 to 0.7 % was left, and 0.97 where 0 to
    2.2 % was.)
    """
    known = math.hypot(decision.known.all, decision.known.of_state)
    return beyond(math.hypot(decision.bare.value, decision.state.size), known)


def features(claim: Claim, decision: Decision) -> tuple[float, ...]:
    """The features of the regression, in the order of ``NAMES``.

    Parameters
    ----------
    decision : Decision
        The decision about its joint.
    """
    if claim.effect == "unknown":
        return (1.0, 1.0, 0.0, 0.0, 0.0)
    left = max(_left(decision), FINEST_KNOWN)
    size = max(claim.size, FINEST_KNOWN)
    larger = sum(c.size**2 for c in decision.claims if c.size > claim.size)
    lacking = math.sqrt(max(decision.before.value**2 - larger, FINEST_KNOWN**2))
    if larger:  # of one that is taken away other numbers may take up a part
        smaller = (c.size for c in decision.claims if c.size < claim.size)
        lacking = min(lacking, math.hypot(size, *smaller, decision.bare.value))
    effect = get_effect(claim.term.effect)
    free = sum(
        q.free and effect.parameter(key).fitted for key, q in claim.term.parameters.items()
    )
    free -= whole_turns(claim.term, decision)
    return (
        1.0,
        0.0,
        min(max(math.log10(size / left), 0.0), 2.0),
        min(max(free, 1), 3) - 1.0,
        min(max(math.log10(lacking / size), 0.0), 1.5),
    )


def whole_turns(term: Term, decision: Decision) -> bool:
    """Whether a wave is a whole number a turn, and that is known so well that it is not by chance:
    a wrong law has any number.
    """
    if "order" not in term.parameters or decision.base.model.joint_kind(term.joint) == "linear":
        return False
    order, unsure = term.value("order"), deviation(decision.final.fit, term, "order")
    window = PLAIN * unsure
    by_chance = 2.0 * window
    return bool(abs(order - round(order)) <= window and 0.0 < by_chance <= FALSE_DISCOVERIES)


def confidence(claim: Claim, decision: Decision) -> float:
    """Probability that a finding is right: its mechanism, and its law where one is stated.

    Parameters
    ----------
    decision : Decision
        The decision about its joint.

    Returns
    -------
    float
        Between 0.05 and ``SUREST``.
    """
    value = float(np.dot(WEIGHTS, features(claim, decision)))
    # no surer than that it predicts better than its neighbours
    most = min(SUREST, claim.most, NormalDist().cdf(claim.ahead))
    return float(max(0.05, min(most, 1.0 / (1.0 + math.exp(-value)))))
