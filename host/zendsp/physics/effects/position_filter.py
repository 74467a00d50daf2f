"""The position column is low-passed: the drive's filter, or one in whatever wrote the recording."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="position_filter",
    site="setup",
    mechanism="measurement",
    parameters=(
        Parameter(
            "time_constant", "time", lower=1e-5, upper=0.2,
            limits=lambda f: (0.1 * f.sample_time, 0.2),
            meaning="T",
        ),
        Parameter(
            "computed", "number", lower=0, upper=1, default=0.0, fitted=False,
            meaning=(
                "all the time, as in a circuit or a drive that is faster than the rows, or once a"
                " row of h s: y + (1 - exp(-h/T)) (q - y), which is late by half a row less"
            ),
            choices=("always", "per_row"),
        ),
    ),
    c=(
        "filter = p[0]; if (p[1] > 0.5)"
        " { keep = exp(-row / p[0]); filter = row * keep / (1 - keep); }"
    ),
    sentence=(
        "The position of joint {joint} is recorded through a low-pass filter with a time "
        "constant of {time_constant} if it is computed {computed}, and half a row more or less if "
        "computed otherwise."
    ),
    experiment="Fast motion beside a second sensor, or the unfiltered channel of the drive.",
    equation="T y' + y = q",
    over="acceleration",
    linear=("time_constant",),
    grid={"computed": (0.0, 1.0)},
    tries=({"computed": 0.0}, {"computed": 1.0}),
    column=lambda along, p: p["time_constant"] * along.qd,
    on_position=True,
    hidden=True,
    family="timing",
    rivals=("delay", "lag", "column_shift"),
    why_not="it is in the sensor: correct the recorded position, or take the unfiltered channel",
)
