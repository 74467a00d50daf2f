"""A pure delay of the command."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="delay",
    site="setup",
    parameters=(Parameter("time", "time", lower=0, upper=0.2),),
    c="delay += p[0];",
    sentence=("The command reaches joint {joint} {time} late."),
    experiment=("Torque at high frequency: chirp or PRBS."),
    equation="u(t - d)",
    starts=({"time": 0.002},),
    family="timing",
    rivals=("lag",),
)
