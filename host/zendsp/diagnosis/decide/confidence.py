"""How often a finding like this one is right.

The mechanism is as sure as its size beyond the discrepancy says; the law as the race of the laws of
its mechanism left it. Both are held below what was tested: no figure above ``MOST`` has been
(docs/diagnosis.md, confidence).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zendsp.diagnosis.decide.decide import Claim, Decision

MOST = 0.97


def confidence(claim: Claim, decision: Decision) -> float:
    """Probability that a finding is right: its mechanism and its law.

    Parameters
    ----------
    claim : Claim
    decision : Decision
        What its joint came to.

    Returns
    -------
    float
        Between 0.05 and ``MOST``.
    """
    largest = max((c.size for c in decision.claims), default=claim.size)
    rest = math.hypot(decision.after.value, decision.state.size, 0.02 * largest)
    ratio = claim.size / max(rest, 1e-9)
    mechanism = ratio**1.5 / (0.5 + ratio**1.5)
    law = claim.laws.get(claim.effect, 0.5)
    if claim.effect == "unknown":
        law = 1.0
    if claim.same:
        law = min(law, 0.5 + 0.5 / (1 + len(claim.same)))
    return float(min(MOST, max(0.05, mechanism * (0.3 + 0.7 * law))))
