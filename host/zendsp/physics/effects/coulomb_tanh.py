"""Coulomb friction with its sign smoothed by tanh, as in the pendulum paper (Hardware 2025, 3(3),
11): smooth, and never at rest.

A diagnosis does not propose it (``needs`` names what no model has): in recordings it is Coulomb
friction, which sticks.
"""

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="coulomb_tanh",
    site="viscous",
    mechanism="dry_friction",
    parameters=(
        Parameter("level", "torque", lower=0, meaning="Fc"),
        Parameter(
            "speed", "speed", lower=1e-6, default=0.01,
            meaning="v, over which the step at zero speed is spread",
        ),
    ),
    c="return p[0] * tanh(s->qd / p[1]);",
    sentence=(
        "Joint {joint} has smoothed Coulomb friction of {level}, half of it at about half of"
        " {speed}."
    ),
    experiment=(
        "Slow moves both ways with reversals: the torque steps by twice the level at each reversal."
    ),
    equation="Fc tanh(q̇/v)",
    needs=("coulomb_tanh",),
    compensable="p[0] * tanh(qd / p[1])",
)
