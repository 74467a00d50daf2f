"""Coulomb friction with a level of its own for each direction."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="coulomb_asymmetry",
    site="dry",
    mechanism="dry_friction",
    parameters=(
        Parameter("level_pos", "torque", lower=0, meaning="Fc+, for positive speed"),
        Parameter("level_neg", "torque", lower=0, meaning="Fc−, for negative speed"),
    ),
    c="return dir > 0 ? p[0] : p[1];",
    sentence=(
        "Dry friction of joint {joint} differs with direction: {level_pos} for positive,"
        " {level_neg} for negative speed."
    ),
    experiment="The same slow poses passed in both directions.",
    equation="Fc± sign(q̇)",
    linear=("level_pos", "level_neg"),
    replaces=("coulomb",),
    symmetric="coulomb",
    sums=("coulomb", "torque_offset"),
    rivals=("torque_offset",),
    compensable="qd > 0 ? p[0] : qd < 0 ? -p[1] : 0.0",
)
