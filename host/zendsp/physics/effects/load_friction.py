"""Friction proportional to the torque that the joint transmits (gears, bearings under load)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="load_friction",
    site="dry",
    mechanism="dry_friction",
    parameters=(Parameter("coefficient", "ratio", lower=0, upper=0.9),),
    c="return p[0] * fabs(s->tau);",
    sentence=(
        "Friction of joint {joint} grows with the transmitted torque: coefficient {coefficient}."
    ),
    experiment="The same slow move with and without a payload.",
    equation="μ |τ| sign(q̇)",
    over="command",
    linear=("coefficient",),
    rivals=("coulomb", "torque_gain"),
    compensable="p[0] * fabs(tau) * sgn(qd)",
)
