"""More or less inertia than the model has: a payload, or a wrong number in it."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="inertia",
    site="setup",
    mechanism="inertia",
    parameters=(Parameter("amount", "inertia", meaning="ΔJ"),),
    c="j_extra += p[0];",
    sentence=(
        "The inertia of joint {joint} is {compared} than the model's: a rotor that it lacks or a"
        " payload where it is larger, or a wrong number in the model."
    ),
    experiment="Fast accelerations with and without the suspected payload.",
    equation="ΔJ q̈",
    over="acceleration",
    linear=("amount",),
    column=lambda along, p: along.qdd * p["amount"],
    same_as=("inertia", "mass"),
    sized=True,
    rivals=("torque_gain",),
    compensable="p[0] * qdd",
)
