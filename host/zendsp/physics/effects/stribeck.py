"""Stribeck effect: friction falls from breakaway to the Coulomb level as speed grows (Stribeck
1902; Armstrong-Hélouvry 1994).
"""

from __future__ import annotations

import math

from zendsp.physics.effects.axes import of_speed
from zendsp.physics.effects.base import Effect, Numbers, Parameter


def _steepest(p: Numbers) -> float:
    """The slope at the inflection, where (|v|/vs)^δ = 1 - 1/δ; that at rest where δ is at most 1.
    """
    d = p["exponent"]
    steps = max(1.0 - 1.0 / d, 0.0)
    slope = d * steps**steps * math.exp(-steps) if steps else 1.0
    return p["breakaway"] * slope / p["velocity"]


EFFECT = Effect(
    name="stribeck",
    site="dry",
    mechanism="dry_friction",
    parameters=(
        Parameter(
            "breakaway", "torque", lower=0, above="coulomb",
            meaning="Fs, at rest; contains Fc, the level of the model's coulomb, but no"
            " coulomb_asymmetry's",
        ),
        Parameter(
            "velocity", "speed", lower=1e-06, limits=lambda f: (2e-3 * f.fastest, 2.0 * f.fastest),
            meaning="vs",
        ),
        Parameter("exponent", "number", lower=0.3, upper=4, default=2.0, fitted=False, meaning="δ"),
    ),
    c="return p[0] * exp(-pow(fabs(s->qd) / p[1], p[2]));",
    sentence=(
        "Friction of joint {joint} falls with speed (Stribeck): breakaway {breakaway},"
        " characteristic speed {velocity}."
    ),
    experiment=(
        "Many slow constant-speed moves below and above the characteristic speed; a slow multisine"
        " with many reversals."
    ),
    equation="(Fs - Fc) exp(-|q̇/vs|^δ) sign(q̇)",
    linear=("breakaway",),
    grid={"velocity": of_speed(0.01, 0.02, 0.05, 0.1, 0.2, 0.4)},
    needs=("coulomb",),
    rivals=("coulomb", "presliding"),
    hides=True,
    sized=True,
    # a fast observer has other valleys: from all of six speeds a fit under 64 rad/s, of a true
    # 0.162 rad/s, ended at 0.005 or nowhere, under 16 rad/s at 0.162
    slow=True,
    drops=_steepest,
    tries=({"exponent": 1.0},),
    compensable="p[0] * exp(-pow(fabs(qd) / p[1], p[2])) * sgn(qd)",
)
