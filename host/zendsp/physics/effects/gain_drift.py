"""The actuator's gain drifts in time, as magnets and amplifiers warm up."""

from __future__ import annotations

from zendsp.physics.effects.axes import slow_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="gain_drift",
    site="actuator",
    mechanism="actuator",
    parameters=(
        Parameter("ratio", "ratio", lower=-0.9, upper=5.0, meaning="r, the change in the end"),
        Parameter(
            "time_constant", "time", lower=0.05, upper=10000.0, limits=slow_limits,
            meaning="T",
        ),
    ),
    c="return u * (1.0 + p[0] * (1.0 - exp(-s->t / p[1])));",
    sentence=(
        "The torque that the actuator of joint {joint} gives drifts by {ratio} of itself with a"
        " time constant of {time_constant}."
    ),
    experiment="A long record at constant excitation, starting cold.",
    equation="u (1 + r (1 - exp(-t/T)))",
    essence=("ratio", "time_constant"),  # in no time it is a constant factor
    over="time",
    linear=("ratio",),
    sized=True,
    grid={"time_constant": (0.1, 0.3, 1.0)},
    shape="time_constant",
    loosens_inertia=True,
    rivals=("friction_drift", "torque_gain"),
    why_not="it changes with time: identify the gain again when the machine is warm",
)
