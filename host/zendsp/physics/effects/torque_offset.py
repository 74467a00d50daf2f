"""A constant torque: amplifier offset, tilted table."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="torque_offset",
    site="torque",
    mechanism="actuator",
    parameters=(Parameter("level", "torque", meaning="τ0"),),
    c="return p[0];",
    sentence=("The drive of joint {joint} has to overcome a constant torque of {level}."),
    experiment=("The same poses reached from both sides."),
    equation="τ0",
    linear=("level",),
    odds=0.01,
    hides=True,
    sized=True,
    rivals=("coulomb_asymmetry", "gravity", "stiffness"),
    compensable="p[0]",
)
