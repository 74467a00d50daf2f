"""First-order lag of the actuator (current loop, drive filter)."""

from __future__ import annotations

import math

import numpy as np

from zendsp.physics.effects.axes import late
from zendsp.physics.effects.base import Array, Effect, Numbers, Parameter


def _moved(command: Array, sample_time: float, p: Numbers) -> Array:
    """The command behind the lag, (n,)."""
    from scipy.signal import lfilter

    keep = math.exp(-sample_time / max(p["time_constant"], 1e-9))
    return np.asarray(lfilter([1 - keep], [1, -keep], command, zi=[keep * command[0]])[0])


EFFECT = Effect(
    name="lag",
    site="setup",
    mechanism="actuator",
    parameters=(Parameter("time_constant", "time", lower=1e-05, upper=0.2, meaning="T"),),
    c="lag_on = 1; lag = p[0];",
    sentence=(
        "The actuator of joint {joint} lags the command with a time constant of {time_constant}."
    ),
    experiment="Torque at high frequency: chirp or PRBS.",
    equation="T τ' + τ = u",
    over="acceleration",
    linear=("time_constant",),
    column=late,
    retime=_moved,
    hidden=True,
    family="timing",
    sized=True,
    rivals=("delay", "position_filter", "column_shift"),
    why_not="a torque cannot come sooner: lower the bandwidth, or predict the reference",
)
