"""A hardening spring."""

from __future__ import annotations

from zendsp.physics.effects.axes import around_centre, near, neutral_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="cubic_stiffness",
    site="load",
    mechanism="position_torque",
    parameters=(
        Parameter("coefficient", "torque/position3", meaning="k3"),
        Parameter("neutral", "position", default=0.0, limits=neutral_limits, meaning="q0"),
    ),
    c="double x = s->q - p[1]; return p[0] * x * x * x;",
    sentence=("A hardening spring of {coefficient} around {neutral} acts on joint {joint}."),
    experiment=("Slow motion over the whole range, to its ends."),
    equation="k3 (q - q0)³",
    over="position",
    linear=("coefficient",),
    grid={"neutral": around_centre(-0.5, 0.0, 0.5)},
    sized=True,
    rivals=("stiffness", "gravity"),
    compensable="p[0] * pow(q - p[1], 3)",
    restart=near(3),
)
