"""Creep of dry friction: at a small speed it grows with the speed in place of holding, as
simulators smooth its sign, and as greased joints do.

A search does not propose it (``needs`` names what no model has): how a known dry friction turns
round is no missing physics. Where a search leaves something, it is made once more with it.
"""

from zendsp.physics.effects.base import Effect, Parameter

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
    ),
    c="creep = p[0];",
    sentence=(
        "Dry friction of joint {joint} does not hold: around {speed} it grows with speed."
    ),
    experiment="Slow moves with reversals; a torque below breakaway, held for a minute.",
    equation="|F(q̇)| tanh(q̇/v)",
    over="velocity",
    hidden=True,
    essence=("speed",),
    needs=("creep",),
    family="presliding",
    why_not="how friction turns round at rest is smoothed in every compensation",
)
