"""The torque of a joint's laws: which a model keeps, how large they are, what they may leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zendsp.diagnosis.decide.claims import Known, Piece
from zendsp.diagnosis.decide.findings import new_terms
from zendsp.diagnosis.decide.thresholds import LEFT_BY_A_LAW
from zendsp.diagnosis.measure.curve import DRY, FRICTION
from zendsp.diagnosis.measure.discrepancy import difference, mean_square
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.observed import trace
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model, Term, per_joint


def kept_laws(given: Model, final: Model, joint: int, mechanism: str) -> list[Term]:
    """The terms of the given model at a joint that are of a mechanism's kind and remain in the
    final one.
    """
    new = new_terms(given, final, joint)
    return [
        t
        for t in final.at(joint)
        if not any(t is n for n in new) and mechanism_of(t.effect) in kind_of(mechanism)
    ]


def torque_of(test: Data, terms: Sequence[Term], model: Model, joint: int) -> float:
    """RMS torque of some terms of a model along recordings, as a part of the RMS torque; 1 where
    the model without them does not follow the recordings.
    """
    if not terms:
        return 0.0
    apart = model.with_terms(tuple(t for t in model.terms if t not in terms))
    return min(1.0, difference(test, apart, model, joint))


def dry_torque(data: Data, model: Model, joint: int) -> float:
    """RMS of a model's dry friction at a joint along recordings, N m or N; 0 where it has none."""
    dry = tuple(t for t in model.at(joint) if mechanism_of(t.effect) == DRY)
    records = [rec[joint - 1] for rec in data.records]
    along = np.concatenate([trace(r, model, dry, 0.0) for r in records])
    return float(np.sqrt(np.mean(along**2)))


def rubs(model: Model, joint: int) -> bool:
    """Whether a model has dry friction at a joint."""
    return has(model, DRY, joint)


def has(model: Model, mechanism: str, joint: int) -> bool:
    """Whether a model has a law of a mechanism at a joint."""
    return any(mechanism_of(t.effect) == mechanism for t in model.at(joint))


def kind_of(mechanism: str) -> frozenset[str]:
    """The mechanisms that are functions of the same variables as this one."""
    return frozenset(FRICTION) if mechanism in FRICTION else frozenset({mechanism})


def may_leave(piece: Piece) -> float:
    """The torque over its own variables that a mechanism's laws may leave, as a part of the RMS
    torque.

    A law of several free numbers can imitate another one, so it may leave less. (An exponent,
    fitted only at the end, does not count.)
    """
    laws = [t for t in piece.terms if mechanism_of(t.effect) == piece.mechanism]
    return law_leaves(piece.size, laws or piece.terms)


def law_leaves(size: float, laws: Sequence[Term]) -> float:
    """The same for a mechanism of some size, by the least free of its ``laws``."""
    freedom = min(
        sum(
            q.free and get_effect(t.effect).parameter(key).fitted
            for key, q in t.parameters.items()
        )
        for t in laws
    )
    return LEFT_BY_A_LAW * size / max(freedom, 1) ** 2


def known_discrepancy(given: Model, test: Data, joint: int) -> Known:
    """The discrepancy that an earlier diagnosis of this machine left."""
    left = (given.discrepancy.torque, given.discrepancy.state)
    return Known(*(per_joint(values, joint, 0.0) / rms_torque(test, joint) for values in left))


def rms_torque(data: Data, joint: int) -> float:
    """RMS torque at a joint over recordings, N m or N."""
    return float(np.sqrt(mean_square(data, joint)))
