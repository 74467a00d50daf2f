"""Dry friction whose level varies with position (bent shaft, seal, worn spot)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.physics.effects.base import Effect, Facts, Parameter

SHARES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.3, 1.7, 2.5)


def _periods(facts: Facts) -> Sequence[float]:
    """Parts of a turn, or shares of the travel on a linear axis."""
    span = facts.scale.position
    turns = (
        []
        if facts.slides
        else [2 * math.pi / m for m in range(1, 25) if 2 * math.pi / m > 0.03 * span]
    )
    return turns or [share * span for share in SHARES]


EFFECT = Effect(
    name="position_friction",
    site="dry",
    mechanism="dry_friction",
    parameters=(
        Parameter("amplitude", "torque", lower=0, meaning="A"),
        Parameter(
            "period",
            "position",
            lower=1e-09,
            limits=lambda f: (0.02 * f.scale.position, 2.0 * f.scale.position),
            meaning="P",
        ),
        Parameter("phase", "angle", lower=-6.5, upper=6.5, meaning="φ"),
    ),
    c="return p[0] * sin(6.283185307179586 * s->q / p[1] + p[2]);",
    sentence=(
        "Dry friction of joint {joint} varies along the travel by {amplitude}, period {period}."
    ),
    experiment="One slow pass over the whole range in each direction.",
    equation="A sin(2π q/P + φ) sign(q̇)",
    over="position",
    linear=("amplitude",),
    grid={"period": _periods, "phase": (0.0, 1.5707963267948966)},
    rivals=("ripple", "coulomb"),
    repeatable=True,
    compensable="p[0] * sin(6.283185307179586 * q / p[1] + p[2]) * sgn(qd)",
)
