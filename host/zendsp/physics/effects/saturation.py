"""The actuator saturates below its stated limit."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="saturation",
    site="actuator",
    parameters=(Parameter("level", "command", lower=1e-09),),
    c="return u > p[0] ? p[0] : u < -p[0] ? -p[0] : u;",
    sentence=("The actuator of joint {joint} saturates at {level}."),
    experiment=("Fast accelerations to the stated limit."),
    equation="clip(u, ±level)",
    grid={"level": (0.9, 1.3, 1.8, 2.3, 2.8)},
)
