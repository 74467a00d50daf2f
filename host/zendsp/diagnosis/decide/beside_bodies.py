"""Claims of single joints beside a claimed body: what may be the error of its weight is a
refinement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide_bodies import BodyClaim, like_bodies
from zendsp.diagnosis.decide.thresholds import DRAWN, LAW_ERROR, OWN_SHARE, SURE
from zendsp.diagnosis.measure.discrepancy import discrepancy, mean_square
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.observed import trace
from zendsp.physics.model import Model, Term

ENOUGH_ROWS = 2000  # samples of a recording, in which a torque is compared with others


def beside_bodies(
    claims: Sequence[BodyClaim], decisions: Sequence[Decision], test: Data
) -> list[Decision]:
    """The decisions, with claims turned into refinements where they may be the error of a body: a
    constant, a torque over the position that bodies can draw, or a gain of the torque, which is
    mostly weight, no larger than the uncertainty of its weight, and a small inertia or coupling as
    bodies have it. Where calibration could have absorbed the body but was held, any inertia counts.
    """
    out = []
    calibrates = any("calibration" in c.found.indistinguishable for c in claims)
    for decision in decisions:
        largest = max((c.sizes.get(decision.joint, 0.0) for c in claims), default=0.0)
        wrong = max((_wrong_by(c.found.term, decision.joint, test) for c in claims), default=0.0)
        unsure = max(LAW_ERROR * largest, SURE * wrong)
        weight = [
            c
            for c in decision.claims
            if (c.size < unsure and _may_be_weight(c, decision, test))
            or (c.effect == "inertia" and calibrates)
            or (
                (c.effect == "inertia" or c.is_rigid_coupling)
                and c.size**2 < OWN_SHARE * largest**2
            )
        ]
        keep = tuple(c for c in decision.claims if not any(c is w for w in weight))
        if weight:
            kind = decision.kind if keep else Verdict.COMPLETE
            # a refinement is a law of the improved model, whatever was claimed of it
            laws = [_as_law(c) for c in weight if c.term.effect != "unknown"]
            more = (*decision.refinements, *laws)
            decision = replace(decision, kind=kind, claims=keep, refinements=more)
        out.append(decision)
    return out


def undoubted(
    claims: Sequence[BodyClaim], decisions: Sequence[Decision], parts: Parts
) -> list[Decision]:
    """The decisions, complete where only the recordings of the fit show a law, as a body's weight
    acts, and lack no more than the body may be wrong by.
    """
    out = []
    for decision in decisions:
        joint, like = decision.joint, {effect for effect, _ in decision.doubted} & like_bodies()
        if like and claims:
            wrong = max(_wrong_by(c.found.term, joint, parts.test) for c in claims)
            if discrepancy(parts.fit, decision.base.model, joint).value < SURE * wrong:
                decision = replace(decision, kind=Verdict.COMPLETE, doubted=())
        out.append(decision)
    return out


def _may_be_weight(claim: Claim, decision: Decision, test: Data) -> bool:
    """Whether what a joint lacks may be the weight of a body that is not quite as found; also
    where it cannot be told from that, as a dead zone from a gain where the command has one sign.
    """
    if claim.is_constant or "torque_gain" in (claim.effect, *claim.same):
        return True
    if claim.mechanism != "position_torque":
        return False
    # a curve, of all laws that draw it
    laws = decision.drawn_by(claim) if claim.effect == "unknown" else (claim.term,)
    if not laws:
        return True
    return _drawn_by_bodies(laws, decision.final.model, decision.joint, test) > DRAWN


def _drawn_by_bodies(terms: tuple[Term, ...], model: Model, joint: int, test: Data) -> float:
    """The part of the squares of the torque of some terms that a constant and changes of the links
    beyond a joint can draw, along the measured motion.
    """
    left = whole = 0.0
    for rec in test.records:
        record = rec[joint - 1]
        links = record.links
        assert links is not None
        some = slice(None, None, max(1, record.n // ENOUGH_ROWS))
        torque = trace(record, model, terms, 0.0)[some]
        moved = [k for k in range(len(links.bodies)) if links.moves(joint - 1, k)]
        rows = [links.columns(joint - 1, k)[1][:, some] for k in moved]
        columns = np.concatenate([np.ones((1, len(torque))), *rows])
        coefficients = np.linalg.lstsq(columns.T, torque, rcond=1e-9)[0]
        left += float(np.sum((torque - coefficients @ columns) ** 2))
        whole += float(np.sum(torque**2))
    return 1.0 - left / max(whole, 1e-300)


def _as_law(claim: Claim) -> Claim:
    name = claim.term.effect
    return claim if claim.effect == name else replace(claim, effect=name)


def _wrong_by(term: Term, joint: int, test: Data) -> float:
    """The uncertainty of a body's torque at a joint (each number one standard deviation off), as a
    part of the RMS torque.
    """
    total = 0.0
    for key, q in term.parameters.items():
        off = replace(q, value=q.value + q.std)
        both = (replace(term, parameters={**term.parameters, key: off}), term)
        for rec in test.records if q.std > 0.0 else ():
            record = rec[joint - 1]
            assert record.links is not None
            there, here = (record.links.change([t], joint - 1) for t in both)
            pulled = (there.inertia - here.inertia) * record.others[joint - 1, 2]
            total += float(np.sum((there.bias - here.bias + pulled) ** 2))
    count = sum(rec[joint - 1].n for rec in test.records)
    return math.sqrt(total / max(count, 1) / mean_square(test, joint))
