"""How often a finding like this one is right: a logistic function of its evidence, fitted on concealed cases."""

from __future__ import annotations

import math

from zendsp.diagnosis.verdict import JointOutcome


def confidence(loss: float, z: float, margin: float, result: JointOutcome, bandwidth: float) -> float:
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

    Returns
    -------
    float
        Between 0.05 and 0.99.
    """
    relative = min(margin, loss) / max(loss, 1e-300)
    left = min(1.0, result.after.size / max(result.before.size, 1e-300))
    score = 1.2 + 1.0 * math.log10(max(loss, 1.0) / 100.0) + 2.0 * relative + 0.4 * min(z, 8.0) / 8.0 - 1.5 * left * result.after.state_share
    return min(0.99, max(0.05, 1.0 / (1.0 + math.exp(-score))))
