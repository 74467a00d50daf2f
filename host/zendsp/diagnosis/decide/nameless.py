"""Which mechanism acts without a law, from the variables that predict the missing torque."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from itertools import combinations

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.confidence import confidence
from zendsp.diagnosis.decide.law_torque import kind_of
from zendsp.diagnosis.decide.pieces import beside_unknown
from zendsp.diagnosis.decide.thresholds import (
    A_PART,
    COMMANDED,
    FINEST,
    GROWN,
    LAW_ERROR,
    LEFT_BY_A_LAW,
    MACHINE,
    PREDICTED,
    RIVAL,
    SIMULATORS_DIFFER,
    SOFT,
    STATED_ALONE,
    STEEP,
    SURE,
    UNLIKELY,
)
from zendsp.diagnosis.measure.curve import DRY, FLUID, FRICTION
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import STRUCTURED, TAKEN, structure
from zendsp.physics.calibration.observed import trace
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model, Term


def only_mechanism(parts: Parts, given: Model, out: Decision, turning: bool) -> Claim | None:
    """The one mechanism whose own variables predict most of the missing torque, and most of what
    any function of the state predicts; None where several do, or none.
    """
    joint, base = out.joint, out.base
    alone = {m: structure(parts.each, base.model, joint, [m], turning) for m in STRUCTURED}
    order = sorted(alone, key=lambda m: -alone[m].size)
    best = alone[order[0]]
    least = PREDICTED * max(out.state.size, out.before.value) ** 2
    if best.z < SURE or best.size**2 < least or best.share < _least(order[0]):
        return None
    others = [m for m in order[1:] if m not in kind_of(order[0])]
    # the command follows whatever a joint bears, so an actuator is no rival unless it may be blamed
    rivals = [alone[m] for m in others if alone[m].share >= _least(m)]
    if order[0] == "actuator":
        # in a loop the command follows a torque over two of them, such as place and direction
        pairs = combinations(others, 2)
        rivals += [structure(parts.each, base.model, joint, pair, turning) for pair in pairs]
    if any(r.size**2 > RIVAL * best.size**2 for r in rivals):
        return None
    evidence = Evidence(0.0, best.z, np.zeros(1))
    term = Term("unknown", joint, {})
    claim = Claim(
        "unknown", order[0], term, best.size, evidence, 0.0, {"unknown": 1.0}, (), (), (), best
    )
    return by_its_variables(claim, out, parts, given)


def without_law(claim: Claim, decision: Decision) -> Claim:
    """A claim of the mechanism without a law. Its laws keep their likelihood; a law that leaves too
    much in its own variables is unlikely.
    """
    most = UNLIKELY if claim.effect == "unknown" else STATED_ALONE
    sure = min(confidence(replace(claim, effect=claim.term.effect), decision), most)
    laws = {name: sure * weight for name, weight in claim.laws.items()}
    return replace(claim, effect="unknown", laws={**laws, "unknown": 1.0 - sure})


def by_its_variables(
    claim: Claim, decision: Decision, parts: Parts, given: Model, laws: Collection[str] = ()
) -> Claim:
    """A friction without a law as dry or fluid, by the variables that predict it beside the named
    ``laws`` and what calibration absorbed: fluid where no step at standstill is needed, which
    reversals show. A steep rise looks like a step, and a soft step like none, so neither is sure.
    Unchanged where its own law, though not named, leaves nothing, or little more than any function
    of the other friction's variables does.
    """
    if claim.effect != "unknown" or claim.mechanism not in FRICTION:
        return claim
    if claim.term.effect != "unknown" and decision.bare.value < LAW_ERROR * claim.size:
        return claim  # one of its laws leaves nothing, though no name: its numbers may be at an end
    if _has_memory(claim, decision):
        return claim
    model, joint = beside_laws(claim, decision, given, laws), decision.joint
    of = {m: structure(parts.each, model, joint, [m, TAKEN]) for m in FRICTION}
    steps = of[FLUID].size < (1.0 - LAW_ERROR) * of[DRY].size and not _rises(given, decision)
    name = DRY if steps else FLUID
    # of what its own law leaves a free function has to predict most, too
    law_leaves = (decision.bare.value / claim.size) ** 2
    if claim.term.effect != "unknown" and 1.0 - of[name].share > (1.0 - PREDICTED) * law_leaves:
        name = claim.mechanism
    claim = replace(claim, most=min(claim.most, STEEP if name == DRY else SOFT))
    if name == claim.mechanism:
        return claim
    return replace(claim, mechanism=name, laws={"unknown": 1.0})


def _rises(given: Model, decision: Decision) -> bool:
    """Whether calibration drove a dry friction to zero and made a viscous one several times larger.
    A line fitted to a torque that rises faster than the speed is negative at standstill.
    """
    now = {t.effect: t for t in decision.base.model.at(decision.joint)}

    def moved(mechanism: str) -> list[tuple[float, float]]:
        """The given and the calibrated value of a number."""
        known = [t for t in given.at(decision.joint) if t.effect in now]
        return [
            (t.value(key), now[t.effect].value(key))
            for t in known
            if mechanism_of(t.effect) == mechanism
            for key in [get_effect(t.effect).parameters[0].name]
        ]

    gone = any(new < FINEST * decision.scale < old for old, new in moved(DRY))
    return gone and any(new > GROWN * old for old, new in moved(FLUID))


def beside_laws(
    claim: Claim, decision: Decision, given: Model, laws: Collection[str]
) -> Model:
    """The model that lacks a mechanism without a law and nothing else: with the named ``laws``;
    where there are none, the calibrated one.
    """
    if not laws:
        return decision.base.model
    return beside_unknown(given, decision.final.model, decision.joint, claim.mechanism, laws)


def told_apart(
    claim: Claim, decision: Decision, parts: Parts, given: Model, laws: Collection[str]
) -> bool:
    """Whether this mechanism's variables predict the missing torque beside the named ``laws`` as
    well as those of every other mechanism. Where its own laws leave nothing over the state, they
    may predict a little less. A mechanism without a law is known by its variables alone; one that
    has none, as a measurement, by what it leaves. A constant, a function of any variable, is none.
    """
    if claim.mechanism not in STRUCTURED:
        return decision.after.value < max(SIMULATORS_DIFFER, LEFT_BY_A_LAW * claim.size)
    if _has_memory(claim, decision):
        return True
    if _hardly_varies(claim, decision, parts):
        return False
    if _drawn_by_its_laws(claim, decision):
        return True
    if decision.after.value < SIMULATORS_DIFFER:
        return True
    model, joint = beside_laws(claim, decision, given, laws), decision.joint
    of = {m: structure(parts.each, model, joint, [m]) for m in STRUCTURED}
    own = of[claim.mechanism]
    if own.share < _least(claim.mechanism):
        return False
    others = max(of[m].size for m in STRUCTURED if m not in kind_of(claim.mechanism))
    more = A_PART if decision.state.size < SIMULATORS_DIFFER else 0.0
    return others**2 <= (1.0 + more) * own.size**2


def _has_memory(claim: Claim, decision: Decision) -> bool:
    """Whether no function of the state predicts the missing torque, and the mechanism's laws do,
    the first of which has states of its own, as bristles have: what they leave tells the mechanism.
    """
    law = claim.term.effect
    remembers = law != "unknown" and get_effect(law).hidden
    return remembers and _only_laws_explain(claim, decision)


def _hardly_varies(claim: Claim, decision: Decision, parts: Parts) -> bool:
    """Whether the laws that draw a mechanism draw mostly a constant, of which no one knows on what
    it depends, and what varies beside it is little.
    """
    laws = tuple(t for t in decision.drawn_by(claim) if not get_effect(t.effect).hidden)
    if not laws:
        return False
    model, joint = decision.final.model, decision.joint
    drawn = [trace(rec[joint - 1], model, laws, 0.0) for rec in parts.test.records]
    torque = np.concatenate(drawn)
    mean, whole = float(np.mean(torque)), float(np.mean(torque**2))
    varies = math.sqrt(max(whole - mean**2, 0.0)) / decision.scale
    little = varies < max(MACHINE, decision.after.value / LEFT_BY_A_LAW)
    return little and mean**2 > PREDICTED * whole


def _drawn_by_its_laws(claim: Claim, decision: Decision) -> bool:
    """Whether laws of one mechanism, and nothing else, explain what no function of the state
    predicts, since calibration had taken a part of it.
    """
    mechanisms = {c.mechanism for c in (*decision.claims, *decision.refinements)}
    return mechanisms == {claim.mechanism} and _only_laws_explain(claim, decision)


def _only_laws_explain(claim: Claim, decision: Decision) -> bool:
    """Whether no function of the state predicts what lacks, and the laws surely leave no more of it
    than one law may.
    """
    left = LEFT_BY_A_LAW * claim.size
    return decision.state.share < PREDICTED and decision.after.high < left


def _least(mechanism: str) -> float:
    """The part of the missing torque's energy that the variables of a mechanism without a law have
    to predict.
    """
    return COMMANDED if mechanism == "actuator" else PREDICTED
