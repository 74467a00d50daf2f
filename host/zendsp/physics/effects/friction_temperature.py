"""Dry friction that changes with the temperature that is recorded beside it."""

from __future__ import annotations

from zendsp.physics.effects.base import Effect, Parameter

EFFECT = Effect(
    name="friction_temperature",
    site="dry_scale",
    mechanism="dry_friction",
    parameters=(
        Parameter("coefficient", "1/temperature", lower=-1.0, upper=1.0, meaning="c"),
        Parameter(
            "reference", "temperature", default=20.0, fitted=False,
            meaning="T0, at which F, the model's dry friction, holds",
        ),
    ),
    c="return 1.0 + p[0] * (s->temp - p[1]);",
    sentence=(
        "Dry friction of joint {joint} changes by {coefficient} of its level at {reference} "
        "with each degree."
    ),
    experiment="The same motion cold and warm, with the temperature recorded.",
    equation="F (1 + c (T - T0)) sign(q̇)",
    over="time",
    linear=("coefficient",),
    grid={"reference": lambda f: [f.temperature]},
    slow=True,
    reads=("temperature",),
    needs=("dry",),
    rivals=("friction_drift", "coulomb"),
    why_not="its temperature is not among the signals of the ISR",
)
