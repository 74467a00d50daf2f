"""How far a parameter may sensibly go in a given recording: physics outside these bounds cannot be seen in it."""

from __future__ import annotations

import numpy as np

from zendsp.physics.effects import get_effect
from zendsp.physics.joint import JointRecord


def parameter_bounds(effect_name: str, name: str, record: JointRecord) -> tuple[float, float]:
    """Lower and upper bound of a parameter, SI, from its definition and from what the recording can show.

    Parameters
    ----------
    effect_name, name : str
        Effect and parameter.
    record : JointRecord
        The longest recording of the joint.

    Returns
    -------
    tuple of float
    """
    parameter = get_effect(effect_name).parameter(name)
    low, high = parameter.lower, parameter.upper
    s, q = record.scale, record.motion.states[0]
    span, centre = s.position, 0.5 * (float(q.max()) + float(q.min()))
    top_speed = float(np.quantile(np.abs(record.motion.states[1]), 0.99))
    slowest, fastest = (
        2 * np.pi * 0.5,
        min(2 * np.pi * 200.0, 1.0 / record.sample_time),
    )  # rad/s of a resonance
    two_mass = effect_name in ("elasticity", "backlash")
    if name == "neutral":
        return centre - 3 * span, centre + 3 * span
    if name == "period":
        return max(low, 0.02 * span), 2.0 * span
    if name == "order":
        return max(low, 1.5 * 2 * np.pi / span if effect_name == "ripple" and span < 2 * np.pi else 1.2), high
    if effect_name == "encoder_eccentricity" and name == "amplitude":
        return low, 0.06  # 3.4 degrees: no encoder disc is further off centre
    if effect_name == "stribeck" and name == "velocity":
        return 2e-3 * top_speed, 2.0 * top_speed
    if name == "time_constant" and effect_name == "friction_drift":
        return 0.01 * s.seconds, 5.0 * s.seconds
    if name == "gap":
        return low, 0.5 * span
    if name == "stiffness" and two_mass:
        return 0.05 * s.inertia * slowest**2, 0.25 * s.inertia * fastest**2
    if name == "damping" and two_mass:
        return low, 2.0 * s.inertia * fastest * 0.2
    if name == "load_inertia":
        return 0.02 * s.inertia, 0.97 * s.inertia
    if name == "stiffness":
        return max(low, 0.05 * s.torque / span), 1e5 * s.torque / span
    if name in ("width", "level") and get_effect(effect_name).site == "actuator":
        return low, 1.2 * float(np.max(np.abs(record.command)))
    return low, high
