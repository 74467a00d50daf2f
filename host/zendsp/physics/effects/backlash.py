"""A gap between motor and load, with contact stiffness beyond it."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="backlash",
    site="setup",
    parameters=(
        Parameter("gap", "position", lower=1e-09),
        Parameter("stiffness", "torque/position", lower=1e-09),
        Parameter("load_inertia", "inertia", lower=1e-12),
        Parameter("damping", "torque/speed", lower=0, default=0.0, meaning="of the contact; 0: a tenth of critical"),
    ),
    c="two_mass = 1; gap = p[0]; k_spring = p[1]; j_load = p[2]; c_spring = p[3] > 0 ? p[3] : 0.1 * sqrt(p[1] * p[2]);",
    sentence=("Joint {joint} has backlash of {gap} between motor and load."),
    experiment=("Small reversals around zero load torque."),
    equation="k dz(qm - ql, gap)",
    starts=(
        {"gap": 0.005, "stiffness": -25.0, "load_inertia": 0.4},
        {"gap": 0.02, "stiffness": -25.0, "load_inertia": 0.4},
        {"gap": 0.08, "stiffness": -25.0, "load_inertia": 0.4},
    ),
    family="transmission",
    rivals=("elasticity", "presliding"),
)
