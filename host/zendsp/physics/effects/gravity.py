"""A gravity-like torque: unbalance, or a tilted base."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="gravity",
    site="load",
    mechanism="position_torque",
    parameters=(
        Parameter("torque", "torque", lower=0, meaning="G"),
        Parameter("angle", "angle", lower=-6.5, upper=6.5, meaning="φ, where it hangs"),
    ),
    c="return p[0] * sin(s->q - p[1]);",
    sentence=("A gravity torque of {torque} acts on joint {joint}, balanced at {angle}."),
    experiment=("Slow motion over a wide range, beyond ±90°."),
    equation="G sin(q - φ)",
    over="position",
    turns=True,
    linear=("torque",),
    grid={"angle": (0.0, -1.5707963267948966)},
    shape="angle",
    sized=True,
    rivals=("stiffness", "torque_offset"),
    compensable="p[0] * sin(q - p[1])",
)
