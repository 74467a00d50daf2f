"""Creep of dry friction: at a small speed it grows with the speed in place of holding, as
simulators smooth its sign, and as greased joints do.

Round: as a hyperbolic tangent. Straight: in proportion, up to the friction's level; MuJoCo's sees
the speed that the joint will have after a lead, and so begins to turn before the joint does. (Its
constraint is f = -clip(m (a + b v), F), a the acceleration, m and b of solimp and solref: the lead
is 1 / b, the speed F / (m b).)

A search does not propose it (``needs`` names what no model has): how a known dry friction turns
round is no missing physics. Where a search leaves something, it is made once more with it.
"""

from zendsp.physics.effects.base import Effect, Parameter

ROUND, STRAIGHT = 0.0, 1.0  # shapes
LONGEST = 0.1  # s: ten times the lead of MuJoCo as it comes (9.5 ms)

EFFECT = Effect(
    name="creep",
    site="setup",
    mechanism="dry_friction",
    parameters=(
        # of the fastest 1 % of the motion: below, it holds for any sensor; above, it is viscous
        Parameter(
            "speed", "speed", lower=0, limits=lambda f: (1e-5 * f.fastest, 0.3 * f.fastest),
            meaning="v; F is the model's dry friction",
        ),
        Parameter(
            "lead", "time", lower=0, default=0.0, limits=lambda f: (0.0, LONGEST),
            meaning="T, of a straight one",
        ),
        Parameter(
            "shape", "number", lower=0, upper=1, default=0.0, fitted=False,
            choices=("round", "straight"),
            meaning="how it grows: as a hyperbolic tangent, or in proportion up to its level",
        ),
    ),
    c="creep = p[0]; creep_lead = p[1]; straight = p[2] > 0;",
    sentence=(
        "Dry friction of joint {joint} does not hold: around {speed} it grows with speed."
    ),
    experiment="Slow moves with reversals; a torque below breakaway, held for a minute.",
    equation="|F(q̇)| tanh(q̇/v) | |F(q̇)| clip((q̇ + T q̈)/v, ±1)",
    over="velocity",
    hidden=True,
    essence=("speed",),
    needs=("creep",),
    family="presliding",
    why_not="how friction turns round at rest is smoothed in every compensation",
)
