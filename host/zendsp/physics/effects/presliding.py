"""Pre-sliding: dry friction acts through bristles that bend before they slide (Dahl 1968; Canudas
de Wit 1995).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.physics.effects.axes import bristle_limits
from zendsp.physics.effects.base import Effect, Facts, Numbers, Parameter

DEFLECTIONS = (10.0, 30.0, 100.0, 300.0, 1000.0)  # of which one makes up the motion's range


def _starts(facts: Facts) -> Sequence[Numbers]:
    level = facts.friction or 0.2 * facts.scale.torque
    stiffness = [number * level / facts.scale.position for number in DEFLECTIONS]
    return [{"stiffness": k, "damping": 0.1 * math.sqrt(k * facts.inertia)} for k in stiffness]


EFFECT = Effect(
    name="presliding",
    site="setup",
    mechanism="dry_friction",
    parameters=(
        Parameter(
            "stiffness", "torque/position", lower=1e-09, limits=bristle_limits,
            meaning="σ0, of the bristles",
        ),
        Parameter("damping", "torque/speed", lower=0, default=0.0, meaning="σ1"),
    ),
    c="s0 = p[0]; s1 = p[1];",
    sentence=(
        "Dry friction of joint {joint} builds up over a bristle deflection: stiffness {stiffness}."
    ),
    experiment="Small slow torque cycles below breakaway, with a fine position sensor.",
    equation="σ0 z + σ1 ż, ż = q̇ - σ0 |q̇| z / F(q̇)",
    over="position",
    scan=_starts,
    hidden=True,
    essence=("stiffness",),
    needs=("dry",),
    family="presliding",
    sole=True,
    rivals=("hysteresis", "stribeck", "backlash"),
    why_not="it depends on a deflection that is not measured",
)
