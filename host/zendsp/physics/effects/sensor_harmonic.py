"""An error of the position sensor that repeats within a turn.

An oval track, two reading heads, the poles of a resolver.
"""

from __future__ import annotations

from zendsp.physics.effects.axes import even, off_centre, order_limits, orders
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="sensor_harmonic",
    site="sensor",
    mechanism="measurement",
    parameters=(
        Parameter(
            "order", "order", lower=2, limits=order_limits(1.2, whole=False),
            meaning="n, periods a turn; on a linear axis 2π over the period",
        ),
        Parameter("amplitude", "position", lower=0, limits=off_centre, meaning="e"),
        Parameter("phase", "angle", lower=-6.5, upper=6.5, meaning="φ"),
    ),
    c="return p[1] * sin(p[0] * s->q + p[2]);",
    sentence="The position sensor of joint {joint} errs by {amplitude}, {repeats}.",
    experiment="Constant speed over several turns, or a second sensor.",
    equation="q + e sin(n q + φ), n ≥ 2",
    over="position",
    linear=("amplitude",),
    grid={"order": orders, "phase": (0.0, 1.5707963267948966)},
    possible=even,
    rivals=("encoder_eccentricity", "ripple"),
    repeatable=True,
    why_not="it is in the sensor: correct the measured angle",
)
