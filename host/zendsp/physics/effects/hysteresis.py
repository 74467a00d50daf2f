"""Bouc-Wen hysteresis: a restoring force that remembers (Bouc 1967; Wen 1976)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="hysteresis",
    site="setup",
    parameters=(
        Parameter("force", "torque", lower=0),
        Parameter("stiffness", "torque/position", lower=1e-09),
        Parameter("exponent", "number", lower=0.5, upper=6, default=1.0, fitted=False),
    ),
    c="bw_force = p[0]; bw_a = p[0] > 0 ? p[1] / p[0] : 0; bw_n = p[2];",
    sentence=(
        "A hysteretic restoring force of {force} with initial stiffness {stiffness} acts on joint {joint}."
    ),
    experiment=("Slow cycles of several amplitudes: loops that close."),
    equation="F z, ż = A q̇ - β |q̇||z|ⁿ⁻¹z - γ q̇|z|ⁿ",
    starts=(
        {"force": 0.2, "stiffness": 3.0},
        {"force": 0.2, "stiffness": 20.0},
        {"force": 0.2, "stiffness": 120.0},
    ),
    family="presliding",
    rivals=("presliding", "coulomb", "stiffness"),
)
