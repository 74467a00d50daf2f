"""Friction proportional to the torque that the joint transmits (gears, bearings under load): of the
drive, or what reaches the load (Hamon, Gautier and Garrec 2010).
"""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="load_friction",
    site="dry",
    mechanism="dry_friction",
    parameters=(
        Parameter("coefficient", "ratio", lower=0, upper=0.9, meaning="μ"),
        Parameter(
            "of", "number", lower=0, upper=1, default=0.0, fitted=False,
            meaning="which torque τ is: the drive's, or what of it reaches the load, less friction",
            choices=("drive", "load"),
        ),
    ),
    c="return p[0] * fabs(p[1] > 0.5 ? s->load : s->tau);",
    sentence=(
        "Friction of joint {joint} grows with the transmitted torque, that of the {of}: coefficient"
        " {coefficient}."
    ),
    experiment="The same slow move with and without a payload.",
    equation="μ |τ| sign(q̇)",
    over="command",
    linear=("coefficient",),
    grid={"of": lambda _facts: (0.0, 1.0)},
    tries=({"of": 0.0}, {"of": 1.0}),
    sized=True,
    rivals=("coulomb", "torque_gain"),
    compensable="p[0] * fabs(tau) * sgn(qd)",
)
