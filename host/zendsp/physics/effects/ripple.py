"""Torque that repeats with position: cogging, commutation ripple, once per screw turn."""

from __future__ import annotations

from zendsp.physics.effects.axes import order_limits, orders
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="ripple",
    site="torque",
    mechanism="position_torque",
    parameters=(
        Parameter(
            "order", "order", lower=0, limits=order_limits(1.2),
            meaning="n, periods a turn; on a linear axis 2π over the period",
        ),
        Parameter("amplitude", "torque", lower=0, meaning="A"),
        Parameter("phase", "angle", lower=-6.5, upper=6.5, meaning="φ"),
    ),
    c="return p[1] * sin(p[0] * s->q + p[2]);",
    sentence=("A torque ripple of {amplitude} acts on joint {joint}, {repeats}."),
    experiment=("A slow constant-speed pass over the whole range."),
    equation="A sin(n q + φ)",
    over="position",
    linear=("amplitude",),
    grid={"order": orders, "phase": (0.0, 1.5707963267948966)},
    sized=True,
    rivals=("position_friction", "encoder_eccentricity", "gravity"),
    repeatable=True,
    compensable="p[1] * sin(p[0] * q + p[2])",
)
