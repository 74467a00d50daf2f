"""The encoder disc is off centre: one error per turn."""

from __future__ import annotations

from zendsp.physics.effects.axes import off_centre
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="encoder_eccentricity",
    site="sensor",
    mechanism="measurement",
    parameters=(
        Parameter("amplitude", "position", lower=0, limits=off_centre, meaning="e"),
        Parameter("phase", "angle", lower=-6.5, upper=6.5, meaning="φ"),
    ),
    c="return p[0] * sin(s->q + p[1]);",
    sentence=("The encoder of joint {joint} is eccentric: {amplitude} once per turn."),
    experiment=("Constant speed over several turns, or a second sensor."),
    equation="q + e sin(q + φ)",
    over="position",
    turns=True,
    linear=("amplitude",),
    grid={"phase": (0.0, 1.5707963267948966)},
    sized=True,
    rivals=("ripple", "gravity"),
    why_not="it is in the sensor: correct the measured angle",
)
