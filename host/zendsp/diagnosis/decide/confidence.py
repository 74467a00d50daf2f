"""How often a finding like this one is right.

A logistic regression on findings whose truth was known, of makers of cases that share no code:
what a law leaves unexplained beside its own size, how freely it can be bent, and how small a part
of the lacking torque it is. Its reliability was judged on makers left out of the regression
(docs/diagnosis.md, confidence; `python benchmarks/confidence.py` repeats it).
"""

from __future__ import annotations

import math

import numpy as np

from zendsp.diagnosis.decide.claims import Claim, Decision

NAMES = ("constant", "unknown", "left", "free", "small")
WEIGHTS = (-0.3, 2.05, 2.05, -1.05, -2.05)
MOST = 0.95  # of 186 stated at 0.9 and more, on makers left out, 94 of 100 were right
# A law less likely than this is not stated. Not a half: two effects at once were rare among the
# cases, so that the smaller of two is surer than this says.
STATED = 1 / 3
FINE = 1e-4  # of the RMS torque: nothing is known better


def features(claim: Claim, decision: Decision) -> tuple[float, ...]:
    """What the regression looks at, in the order of ``NAMES``.

    Parameters
    ----------
    claim : Claim
    decision : Decision
        What its joint came to.
    """
    if claim.effect == "unknown":
        return (1.0, 1.0, 0.0, 0.0, 0.0)
    left = max(math.hypot(decision.after.low, decision.state.size), FINE)
    size = max(claim.size, FINE)
    free = sum(q.free for q in claim.term.parameters.values())
    return (
        1.0,
        0.0,
        min(max(math.log10(size / left), 0.0), 2.0),
        min(max(free, 1), 3) - 1.0,
        min(max(math.log10(max(decision.before.value, FINE) / size), 0.0), 1.5),
    )


def confidence(claim: Claim, decision: Decision) -> float:
    """Probability that a finding is right: its mechanism, and its law where one is stated.

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
    value = float(np.dot(WEIGHTS, features(claim, decision)))
    return float(min(MOST, max(0.05, 1.0 / (1.0 + math.exp(-value)))))
