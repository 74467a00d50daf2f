"""No torque for small commands."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="dead_zone",
    site="actuator",
    mechanism="actuator",
    parameters=(
        # a drive that gives nothing for most of its commands does not drive its joint
        Parameter(
            "width", "command", lower=0, limits=lambda f: (0.0, f.scale.command), meaning="d"
        ),
    ),
    c="return u > p[0] ? u - p[0] : u < -p[0] ? u + p[0] : 0.0;",
    sentence=("The actuator of joint {joint} gives no torque for commands below {width}."),
    experiment=("Slow torque ramps through zero."),
    equation="u - d sign(u), 0 for |u| < d",
    over="command",
    grid={"width": (0.02, 0.05, 0.1, 0.2, 0.4)},
    shown_by=("current",),
    sized=True,
    rivals=("coulomb", "backlash"),
    inverse="wanted + p[0] * gain * tanh(wanted / (0.05 * p[0] * gain + 1e-12))",
)
