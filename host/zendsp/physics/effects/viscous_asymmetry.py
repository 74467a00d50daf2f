"""Viscous friction with a coefficient of its own for each direction."""

from __future__ import annotations

from zendsp.physics.effects.axes import viscous_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="viscous_asymmetry",
    site="viscous",
    mechanism="fluid_friction",
    parameters=(
        Parameter(
            "coefficient_pos", "torque/speed", lower=0, limits=viscous_limits,
            meaning="b+, for positive speed",
        ),
        Parameter(
            "coefficient_neg", "torque/speed", lower=0, limits=viscous_limits,
            meaning="b−, for negative speed",
        ),
    ),
    c="return s->qd > 0 ? p[0] * s->qd : p[1] * s->qd;",
    sentence=(
        "Viscous friction of joint {joint} differs with direction: {coefficient_pos} for positive,"
        " {coefficient_neg} for negative speed."
    ),
    experiment="Constant-speed moves, the same speeds both ways.",
    equation="b± q̇",
    linear=("coefficient_pos", "coefficient_neg"),
    replaces=("viscous",),
    symmetric="viscous",
    rivals=("coulomb_asymmetry",),
    compensable="qd > 0 ? p[0] * qd : p[1] * qd",
)
