"""Bouc-Wen hysteresis: a restoring force that remembers (Bouc 1967; Wen 1976)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from zendsp.physics.effects.axes import bristle_limits
from zendsp.physics.effects.base import Effect, Facts, Numbers, Parameter

FORCES = (0.05, 0.15, 0.5)  # shares of the torque
DEFLECTIONS = (3.0, 10.0, 30.0, 100.0, 300.0)  # of which one makes up the motion's range


def _starts(facts: Facts) -> Sequence[Numbers]:
    s = facts.scale
    points = itertools.product(FORCES, DEFLECTIONS)
    return [{"force": f * s.torque, "stiffness": n * f * s.torque / s.position} for f, n in points]


EFFECT = Effect(
    name="hysteresis",
    site="setup",
    mechanism="dry_friction",
    parameters=(
        Parameter("force", "torque", lower=0, meaning="F"),
        Parameter(
            "stiffness", "torque/position", lower=1e-09, limits=bristle_limits,
            meaning="A F, for small deflections; β = γ = A/2",
        ),
        Parameter("exponent", "number", lower=0.5, upper=6, default=1.0, fitted=False, meaning="n"),
    ),
    c="bw_force = p[0]; bw_a = p[0] > 0 ? p[1] / p[0] : 0; bw_n = p[2];",
    sentence=(
        "A hysteretic restoring force of {force} with initial stiffness {stiffness} acts on joint"
        " {joint}."
    ),
    experiment="Slow cycles of several amplitudes: loops that close.",
    equation="F z, ż = A q̇ - β |q̇||z|ⁿ⁻¹z - γ q̇|z|ⁿ",
    over="position",
    scan=_starts,
    tries=({"exponent": 2.0},),
    hidden=True,
    essence=("force", "stiffness"),
    family="presliding",
    sole=True,
    replaces=("presliding",),
    rivals=("presliding", "coulomb", "stiffness"),
    why_not="it depends on a state that is not measured",
)
