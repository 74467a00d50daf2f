"""Coulomb friction, Fc sign(q̇), with exact sticking (Coulomb 1785)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="coulomb",
    site="dry",
    mechanism="dry_friction",
    parameters=(Parameter("level", "torque", lower=0, meaning="Fc"),),
    c="return p[0];",
    sentence=(
        "Joint {joint} lacks Coulomb friction of {level}: the torque opposes the motion whatever"
        " the speed."
    ),
    experiment=(
        "Slow moves both ways with reversals: the torque steps by twice the level at each reversal."
    ),
    equation="Fc sign(q̇)",
    linear=("level",),
    odds=0.01,
    common=True,
    sized=True,
    rivals=("viscous", "stribeck"),
    compensable="p[0] * sgn(qd)",
)
