"""Friction that drifts in time, as a bearing warms up."""

from __future__ import annotations

from zendsp.physics.effects.axes import slow_limits
from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="friction_drift",
    site="scale",
    mechanism="dry_friction",
    parameters=(
        Parameter("ratio", "ratio", lower=-0.95, upper=20.0, meaning="r, the change in the end"),
        Parameter(
            "time_constant", "time", lower=0.05, upper=10000.0, limits=slow_limits,
            meaning="T",
        ),
    ),
    c="return 1.0 + p[0] * (1.0 - exp(-s->t / p[1]));",
    sentence=(
        "Friction of joint {joint} drifts by {ratio} of itself with a time constant of"
        " {time_constant}."
    ),
    experiment="A long record at constant excitation, starting cold.",
    equation="friction (1 + r (1 - exp(-t/T)))",
    essence=("ratio", "time_constant"),  # in no time it is a constant factor
    over="time",
    linear=("ratio",),
    sized=True,
    grid={"time_constant": (0.1, 0.3, 1.0)},
    needs=("friction",),
    rivals=("disturbance",),
    shape="time_constant",
    slow=True,
    why_not="it changes with time: identify friction again when the machine is warm",
)
