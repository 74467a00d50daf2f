"""The actuator saturates below its stated limit."""

from __future__ import annotations

from zendsp.physics.effects.axes import command_limits, of_command
from zendsp.physics.effects.base import Effect, Facts, Parameter


def _least(facts: Facts) -> dict[str, float]:
    """The lowest limit, command units, that is one. Of commands that nearly all pass it only their
    sign is left, and below the dry friction a drive moves nothing; a friction that no model had
    was both at once, at 0.0. One command in twenty has to be below it: a true limit that 85 % of
    the commands passed is found (``tests/diagnosis/test_diagnosis.py``).
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
