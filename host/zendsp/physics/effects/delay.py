"""A pure delay of the command."""

from __future__ import annotations

import numpy as np

from zendsp.physics.effects.axes import late
from zendsp.physics.effects.base import Array, Effect, Numbers, Parameter


def _moved(command: Array, sample_time: float, p: Numbers) -> Array:
    """The mean of the delayed command over each sample, (n,)."""
    edges = np.arange(len(command) + 1) * sample_time
    total = np.r_[0.0, np.cumsum(command)] * sample_time
    late: Array = np.interp(edges - p["time"], edges, total, left=0.0)
    return np.diff(late) / sample_time


EFFECT = Effect(
    name="delay",
    site="setup",
    mechanism="actuator",
    parameters=(Parameter("time", "time", lower=0, upper=0.2, meaning="d"),),
    c="delay += p[0];",
    sentence=("The command reaches joint {joint} {time} late."),
    experiment=("Torque at high frequency: chirp or PRBS."),
    equation="u(t - d)",
    over="acceleration",
    linear=("time",),
    column=late,
    retime=_moved,
    hidden=True,
    family="timing",
    aliases=("column_shift",),  # a column that is early
    sized=True,
    rivals=("lag", "column_shift", "position_filter"),
    why_not="a torque cannot come sooner: lower the bandwidth, or predict the reference",
)
