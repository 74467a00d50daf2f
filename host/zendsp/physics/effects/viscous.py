"""Viscous friction, b q̇ (Newton)."""

from __future__ import annotations

from zendsp.physics.effects.axes import viscous_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="viscous",
    site="viscous",
    mechanism="fluid_friction",
    parameters=(Parameter(
        "coefficient", "torque/speed", lower=0, limits=viscous_limits,
        meaning="b",
    ),),
    c="return p[0] * s->qd;",
    sentence=("Joint {joint} lacks viscous friction of {coefficient}."),
    experiment=("Constant-speed moves at several speeds over a decade, both ways."),
    equation="b q̇",
    linear=("coefficient",),
    common=True,
    sized=True,
    rivals=("coulomb", "quadratic_drag"),
    compensable="p[0] * qd",
)
