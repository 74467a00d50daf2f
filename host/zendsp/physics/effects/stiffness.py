"""A spring to the frame: cable, hose, belt."""

from __future__ import annotations

from zendsp.physics.effects.axes import near, neutral_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="stiffness",
    site="load",
    mechanism="position_torque",
    parameters=(
        Parameter("coefficient", "torque/position", lower=0, meaning="k"),
        Parameter("neutral", "position", default=0.0, limits=neutral_limits, meaning="q0"),
    ),
    c="return p[0] * (s->q - p[1]);",
    sentence=(
        "A spring of {coefficient} with its neutral point at {neutral} pulls on joint {joint}."
    ),
    experiment="Slow motion over the whole range.",
    equation="k (q - q0)",
    over="position",
    linear=("coefficient",),
    sized=True,
    rivals=("gravity", "cubic_stiffness", "torque_offset"),
    compensable="p[0] * (q - p[1])",
    restart=near(1),
)
