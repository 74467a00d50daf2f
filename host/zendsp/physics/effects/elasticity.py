"""A spring and damper between motor and load (flexible joint; Spong 1987)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="elasticity",
    site="setup",
    parameters=(
        Parameter("stiffness", "torque/position", lower=1e-09),
        Parameter("damping", "torque/speed", lower=0),
        Parameter("load_inertia", "inertia", lower=1e-12),
    ),
    c="two_mass = 1; k_spring = p[0]; c_spring = p[1]; j_load = p[2];",
    sentence=("Joint {joint} is elastic: stiffness {stiffness} between motor and load of {load_inertia}."),
    experiment=("Chirp or multisine around the resonance; steps and listen to the ringing."),
    equation="k (qm - ql) + c (q̇m - q̇l)",
    starts=(
        {"stiffness": -8.0, "load_inertia": 0.4},
        {"stiffness": -20.0, "load_inertia": 0.4},
        {"stiffness": -45.0, "load_inertia": 0.4},
    ),
    family="transmission",
    rivals=("backlash", "delay"),
)
