"""Pieces, claims and decisions made by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from zendsp.diagnosis.decide.claims import Claim, Decision, Piece
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.physics.effects import mechanism_of
from zendsp.physics.model import Term

PARTS: Any = SimpleNamespace(fit="fit", choose="choose", test=SimpleNamespace(joints=1), each=())
WITHOUT: Any = object()


def claim_of(term: Term, size: float, evidence: Evidence | None = None) -> Claim:
    sure = evidence or Evidence(100.0, 15.0, np.zeros(1))
    mechanism = mechanism_of(term.effect)
    return Claim(term.effect, mechanism, term, size, sure, 0.5 * sure.gain, {}, (), (), ())


def of_one_claim(claim: Claim, before: float, left: float, base: Any = None) -> Decision:
    """A joint whose unexplained torque ``claim`` brings from ``before`` down to ``left``."""
    was, after = (Size(x, 0.9 * x, 1.1 * x) for x in (before, left))
    state = Structure(0.0, 0.0, 0.0)
    return Decision(1, "missing", (claim,), (), base, base, was, after, state, after, base, 1.0)


def piece(size: float, z: float, log_e: float, effect: str = "ripple") -> Piece:
    term = Term(effect, 1, {})
    evidence = Evidence(gain=2 * log_e, z=z, blocks=np.zeros(1))
    without: Any = SimpleNamespace(model=WITHOUT, deviance=100.0)
    return Piece(mechanism_of(effect), (term,), without, size, evidence, log_e)
