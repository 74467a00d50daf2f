"""How often a finding like this one is right: a logistic function of its evidence, its constants read off concealed cases.

What tells right findings from wrong ones there is, first, whether the model with the finding predicts with a slow observer (nothing else
is missing), then by how much the nearest other explanation is worse, and whether the finding stands among many.
"""

from __future__ import annotations

import math

from zendsp.diagnosis.verdict import JointOutcome

SLOW, FAST = 16.0, 48.0  # rad/s: observers that follow little, and nearly everything


def confidence(
    loss: float, z: float, margin: float, result: JointOutcome, bandwidth: float, beside: int
) -> float:
    """Probability that the finding is right.

    Parameters
    ----------
    loss : float
        Deviance lost without the effect.
    z : float
        Held-out z of the effect.
    margin : float
        Deviance by which the nearest distinguishable rival is worse; infinite where none was near.
    result : JointOutcome
        What remains at the joint.
    bandwidth : float
        Of the observer that the final model needs, rad/s.
    beside : int
        Number of other findings at the joint.

    Returns
    -------
    float
        Between 0.05 and 0.98.
    """
    settled = min(
        1.0, max(0.0, (math.log(FAST) - math.log(max(bandwidth, 1.0))) / (math.log(FAST) - math.log(SLOW)))
    )
    relative = min(1.0, min(margin, loss) / max(loss, 1e-300))
    score = (
        -0.7
        + 3.2 * settled
        + 1.9 * min(1.0, 2.0 * relative)
        + 0.5 * min(z, 6.0) / 6.0
        - 0.9 * max(0, beside - 1)
    )
    score -= 2.4 * result.after.state_share * (result.after.relative > 0.02)
    return min(0.98, max(0.05, 1.0 / (1.0 + math.exp(-score))))
