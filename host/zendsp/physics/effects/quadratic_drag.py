"""Quadratic drag, c q̇ |q̇| (air, fluid)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="quadratic_drag",
    site="torque",
    mechanism="fluid_friction",
    parameters=(Parameter("coefficient", "torque/speed2", lower=0, meaning="c"),),
    c="return p[0] * s->qd * fabs(s->qd);",
    sentence=("Joint {joint} lacks quadratic drag of {coefficient}."),
    experiment=("Two clearly different speed levels, both ways."),
    equation="c q̇ |q̇|",
    linear=("coefficient",),
    common=True,
    sized=True,
    rivals=("viscous",),
    compensable="p[0] * qd * fabs(qd)",
)
