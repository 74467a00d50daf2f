"""A rigid body that a link carries and the model does not know: a tool, a load."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="payload",
    site="body",
    mechanism="inertia",
    parameters=(
        Parameter("mass", "mass", lower=0.0, meaning="m"),
        *(
            Parameter(
                f"com_{axis}", "length", lower=-3, upper=3, default=0.0,
                meaning="c, centre of mass in the link's frame",
            )
            for axis in "xyz"
        ),
        Parameter(
            "inertia", "body_inertia", lower=0.0, default=0.0,
            meaning="J, about its centre of mass, the same about every axis",
        ),
    ),
    c="",
    sentence=(
        "The link of joint {joint} carries {mass} that the model lacks, with its centre at"
        " {com_x}, {com_y}, {com_z} in the link's frame."
    ),
    experiment=("Weigh the tool, or repeat the motion without it: all joints change together."),
    equation="m, c, J fixed to a link: Y(q, q̇, q̈) φ(m, c, J) at every joint that moves it",
    over="position",
    why_not="it acts on all joints: the improved model in C has it (zendsp model2c)",
    rivals=("body", "torque_gain"),
)  # fmt: skip
