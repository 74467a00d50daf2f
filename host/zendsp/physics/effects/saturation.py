"""The actuator saturates below its stated limit."""

from __future__ import annotations

from zendsp.physics.effects.axes import command_limits, of_command
from zendsp.physics.effects.base import Effect, Facts, Parameter


def _least(facts: Facts) -> dict[str, float]:
    """A limit that all commands pass leaves their sign only, and a drive whose limit is below the
    dry friction moves nothing: both at once are any torque that the motion follows.
    """
    return {"level": max(facts.weak, facts.friction / abs(facts.gain or 1.0))}


EFFECT = Effect(
    name="saturation",
    site="actuator",
    mechanism="actuator",
    parameters=(Parameter(
        "level", "command", lower=1e-09, limits=command_limits,
        meaning="largest command that acts",
    ),),
    c="return u > p[0] ? p[0] : u < -p[0] ? -p[0] : u;",
    sentence=("The actuator of joint {joint} saturates at {level}."),
    experiment=("Fast accelerations to the stated limit."),
    equation="clip(u, ±level)",
    over="command",
    grid={"level": of_command(0.06, 0.12, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)},
    least=_least,
    loosens_inertia=True,
    shown_by=("current",),
    why_not="no command passes the limit: plan below it",
)
