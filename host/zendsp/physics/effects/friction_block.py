"""The friction block of the planar-arm paper: polynomials of speed, one for low and one for high
speed (Bona, Indri, Smaldone).

With ``presliding`` beside it, it has the paper's three regions: spring-like at rest, cubic,
parabola. It is measured by experiments and simulated; a diagnosis does not propose it (``needs``
names what no model has), for it would fit what other laws explain.
"""

from zendsp.physics.effects.base import Effect, Parameter

_LOW = "p[0] + {v} * (p[1] + {v} * (p[2] + {v} * p[3] / p[4]))"
_HIGH = (
    "p[0] + p[4] * (p[1] + p[4] * (p[2] + p[3])) + {w} * (p[1] + p[4] * (2.0 * p[2] + 3.0 * p[3]) +"
    " {w} * p[5])"
)

EFFECT = Effect(
    name="friction_block",
    site="dry",
    mechanism="dry_friction",
    parameters=(
        Parameter("level", "torque", lower=0, default=0.0, meaning="c0"),
        Parameter("slope", "torque/speed", default=0.0, meaning="c1"),
        Parameter("curve", "torque/speed2", default=0.0, meaning="c2"),
        Parameter("cubic", "torque/speed2", default=0.0, meaning="c3"),
        Parameter(
            "split", "speed", lower=1e-6, default=1.0,
            meaning="s, the speed at which the two meet",
        ),
        Parameter("high_curve", "torque/speed2", default=0.0, meaning="h2"),
    ),
    c=(
        f"double v = fabs(s->qd); double w = v - p[4]; return w <= 0 ? {_LOW.format(v='v')} :"
        f" {_HIGH.format(w='w')};"
    ),
    sentence=(
        "Joint {joint} has friction of {level} at rest that follows two polynomials of speed,"
        " joined at {split}."
    ),
    experiment="Constant speeds above, slow triangular speeds below the split, both ways.",
    equation=(
        "sign(q̇) (c0 + c1|q̇| + c2 q̇² + c3|q̇|³/s) for |q̇| < s, its tangent + h2 (|q̇| - s)²"
        " above"
    ),
    needs=("friction_block",),
    compensable=(
        f"(fabs(qd) <= p[4] ? {_LOW.format(v='fabs(qd)')} : {_HIGH.format(w='(fabs(qd) - p[4])')})"
        " * sgn(qd)"
    ),
)
