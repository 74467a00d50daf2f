"""How often a finding like this one is right.

The mechanism is as sure as its size beyond the discrepancy says; the law as the race of the laws of
its mechanism left it. Both are held at what was measured: no more than ``MOST``
(docs/diagnosis.md, confidence).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zendsp.diagnosis.decide.decide import Claim, Decision

# What was stated at 0.9 and more was right in 76 of 99 findings on four makers' cases
# (docs/diagnosis.md, confidence); the known effects alone in more, foreign torques in less.
MOST = 0.85
UNNAMED = 0.85  # of a mechanism without a law


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
    law = claim.laws.get(claim.effect, 0.5)
    if claim.effect == "unknown":  # no law is stated; what is left is the mechanism itself
        return UNNAMED
    if claim.same:
        law = min(law, 0.5 + 0.5 / (1 + len(claim.same)))
    largest = max((c.size for c in decision.claims), default=claim.size)
    rest = math.hypot(decision.after.low, decision.state.size, 0.02 * largest)
    ratio = (claim.size / max(rest, 1e-9)) ** 1.5
    mechanism = ratio / (0.2 + ratio)
    return float(min(MOST, max(0.05, mechanism * (0.3 + 0.7 * law))))
