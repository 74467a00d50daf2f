"""The actuator gives (1 + ε) of the command."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="torque_gain",
    site="actuator",
    mechanism="actuator",
    parameters=(Parameter("ratio", "ratio", lower=-0.9, upper=5.0, meaning="ε"),),
    c="return u * (1.0 + p[0]);",
    sentence="The actuator of joint {joint} gives {relative} torque than the command says.",
    experiment=(
        "A known mass or a force gauge: no motion record alone can tell a gain from inertia,"
        " gravity and friction together."
    ),
    equation="(1 + ε) u",
    over="command",
    linear=("ratio",),
    sized=True,
    rivals=("inertia",),
    # no drive's torque is known better; a payload's rest was -0.0033 of a wrist's
    least=lambda f: {"ratio": 0.005},
    inverse="wanted / (1.0 + p[0])",
)
