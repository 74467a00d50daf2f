"""Dry friction whose level varies with position (bent shaft, seal, worn spot)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.physics.effects.axes import HARMONICS
from zendsp.physics.effects.base import Effect, Facts, Parameter

FINEST = 0.02  # of the travel


def _periods(facts: Facts) -> Sequence[float]:
    """Parts of a turn; of the travel of a linear axis, so finely that none falls between two."""
    span = facts.scale.position
    turns = [2 * math.pi / m for m in range(1, HARMONICS + 1)]
    parts = [2 * span / i for i in range(1, round(2 / FINEST) + 1)]
    return parts if facts.slides else [p for p in turns if p <= 2 * span] or parts


def _limits(facts: Facts) -> tuple[float, float]:
    """Down to a part of the travel, or of a turn; up to twice the travel."""
    span = facts.scale.position
    least = FINEST * span if facts.slides else min(FINEST * span, math.pi / HARMONICS)
    return least, 2.0 * span


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
            limits=_limits,
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
    sized=True,
    rivals=("ripple", "coulomb"),
    repeatable=True,
    compensable="p[0] * sin(6.283185307179586 * q / p[1] + p[2]) * sgn(qd)",
)
