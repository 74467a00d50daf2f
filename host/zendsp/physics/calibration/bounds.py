"""Bounds of a parameter in a given recording, which cannot show physics outside them."""

from __future__ import annotations

from zendsp.physics.calibration.joint import JointRecord, facts
from zendsp.physics.effects import get_effect


def parameter_bounds(effect_name: str, name: str, record: JointRecord) -> tuple[float, float]:
    """The lower and upper bound of a parameter, SI, from its definition and from what the recording
    can show.

    Parameters
    ----------
    effect_name, name : str
        Effect and parameter.
    record : JointRecord
        Any recording of the joint.
    """
    parameter = get_effect(effect_name).parameter(name)
    if parameter.limits is None:
        return parameter.lower, parameter.upper
    low, high = parameter.limits(facts(record))
    return max(parameter.lower, low), min(parameter.upper, high)
