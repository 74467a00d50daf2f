"""Torque from another joint's motion that the model lacks."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="coupling",
    site="torque",
    mechanism="inertia",
    parameters=(
        Parameter(
            "from_joint", "joint", lower=0, upper=8, fitted=False,
            meaning="the joint whose motion acts",
        ),
        Parameter(
            "law",
            "number",
            lower=0,
            upper=3,
            fitted=False,
            meaning=(
                "which motion acts: its acceleration, its speed squared, its speed, the direction"
                " of the two together"
            ),
            choices=("inertia", "coriolis", "viscous", "coulomb"),
        ),
        Parameter(
            "coefficient",
            "torque",
            sizes=("inertia", "torque/speed2", "torque/speed", "torque"),
            meaning="c",
        ),
        Parameter(
            "smooth", "speed", lower=1e-09, default=0.01, fitted=False,
            meaning="of the law coulomb: speed over which its step is spread",
        ),
    ),
    c=(
        "int law = (int)p[1]; return p[2] * (law == 0 ? s->oqdd : law == 1 ? s->oqd * s->oqd : law"
        " == 2 ? s->oqd : tanh((s->qd + s->oqd) / p[3]));"
    ),
    sentence=(
        "The motion of joint {from_joint} acts on joint {joint}: {law} coupling of {coefficient}."
    ),
    experiment="Move the other joint alone and hold this one.",
    equation="c q̈_from | c q̇_from² | c q̇_from | c sign(q̇ + q̇_from)",
    linear=("coefficient",),
    grid={
        "from_joint": lambda f: [float(j) for j in range(1, f.joints + 1) if j != f.joint],
        "law": lambda f: (0.0, 1.0, 2.0, 3.0),
        "smooth": (0.05,),
    },
    repeatable=True,
    across=(
        "p[2] * acc[{other}]", "p[2] * vel[{other}] * vel[{other}]", "p[2] * vel[{other}]",
        "p[2] * tanh((vel[{joint}] + vel[{other}]) / p[3])",
    ),
)
