"""Pre-sliding: dry friction acts through bristles that bend before they slide (Dahl 1968; Canudas de Wit 1995)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="presliding",
    site="setup",
    parameters=(
        Parameter("stiffness", "torque/position", lower=1e-09),
        Parameter("damping", "torque/speed", lower=0, default=0.0),
    ),
    c="s0 = p[0]; s1 = p[1];",
    sentence=("Dry friction of joint {joint} builds up over a bristle deflection: stiffness {stiffness}."),
    experiment=("Small slow torque cycles below breakaway, with a fine position sensor."),
    equation="σ0 z + σ1 ż, ż = q̇ - σ0 |q̇| z / F(q̇)",
    starts=({"stiffness": 30.0}, {"stiffness": 150.0}, {"stiffness": 800.0}),
    needs=("coulomb",),
    family="presliding",
    rivals=("hysteresis", "stribeck", "backlash"),
)
