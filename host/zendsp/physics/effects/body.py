"""A link whose mass, centre of mass or inertia is not what the model's file says."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="body",
    site="body",
    mechanism="inertia",
    parameters=(
        Parameter(
            "mass", "mass", default=0.0, meaning="difference from the file, spread as the link is"
        ),
        *(
            Parameter(
                f"com_{axis}", "length", lower=-3, upper=3, default=0.0,
                meaning="difference, in the link's frame",
            )
            for axis in "xyz"
        ),
        Parameter(
            "inertia", "body_inertia", default=0.0,
            meaning="difference beyond that, about the centre of mass, the same about every axis",
        ),
    ),
    c="",
    sentence=(
        "The link of joint {joint} is not what the model's file says: add {mass} to its"
        " mass, and move its centre of mass by {com_x}, {com_y}, {com_z}."
    ),
    experiment="Weigh the link and find its balance, or look up its maker's figures.",
    equation="m, c, J of a link: Y(q, q̇, q̈) Δφ at every joint that moves it",
    over="position",
    why_not="it acts on all joints: the improved model in C has it (zendsp model2c)",
    rivals=("payload", "torque_gain"),
)  # fmt: skip
