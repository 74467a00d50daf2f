"""A base that does not stand as the model says: gravity points elsewhere in its frame."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="base_tilt",
    site="body",
    mechanism="inertia",
    parameters=(
        Parameter(
            "angle_x", "angle", lower=-1.6, upper=1.6, default=0.0,
            meaning="of gravity about the base's x axis",
        ),
        Parameter(
            "angle_y", "angle", lower=-1.6, upper=1.6, default=0.0, meaning="then about its y axis"
        ),
    ),
    c="",
    sentence=(
        "Gravity does not point where the model says: it is turned by {angle_x} about the base's x"
        " axis and by {angle_y} about its y axis."
    ),
    experiment="Lay a spirit level on the base, or hold the arm still in poses all around it.",
    equation="g = Ry(angle_y) Rx(angle_x) g₀, in the base's frame",
    over="position",
    why_not="it acts on all joints: the improved model in C has it (zendsp model2c)",
    rivals=("body", "gravity", "torque_offset"),
)
