"""First-order lag of the actuator (current loop, drive filter)."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="lag",
    site="setup",
    parameters=(Parameter("time_constant", "time", lower=1e-05, upper=0.2),),
    c="lag_on = 1; lag = p[0];",
    sentence=("The actuator of joint {joint} lags the command with a time constant of {time_constant}."),
    experiment=("Torque at high frequency: chirp or PRBS."),
    equation="T τ' + τ = u",
    starts=({"time_constant": 0.003},),
    family="timing",
    rivals=("delay",),
)
