"""The load turns unevenly with the motor: eccentric or worn gears, a harmonic drive's two errors.

Beside a spring between motor and load the error bends it. Where the model has none, the
transmission is rigid and all inertia but added rotors is the load's: turned unevenly it takes
torque, the more the faster. A spring passes that on as far as motor and load swing against each
other (Spong 1987).
"""

from __future__ import annotations

import numpy as np

from zendsp.physics.effects.axes import off_centre, order_limits, orders
from zendsp.physics.effects.base import Along, Array, Effect, Numbers, Parameter

MOTOR = 0.02  # of the inertia: the kernel leaves the motor as much


def _column(along: Along, p: Numbers) -> Array:
    """What the load resists, to first order in the amplitude."""
    amplitude, order = p["amplitude"], p["order"]
    error, cosine = along.wave(order, p["phase"])
    slope = order * cosine
    load = along.spring[-1] if along.spring else along.inertia
    inert = load * (2 * slope * along.qdd - order**2 * error * along.qd**2)
    if along.gravity:
        sine, cosine = along.wave(1.0, 0.0)
        inert += along.gravity * (slope * sine + error * cosine)
    return np.asarray(amplitude * _through_spring(along, inert))


def _through_spring(along: Along, torque: Array) -> Array:
    """The torque on a rigid joint that moves the motor as a torque on its load does, N m or N:
    (c s + k) / (m s² + c s + k) of it, with m = motor load / (motor + load).
    """
    if not along.spring:
        return torque
    k, c, load = along.spring
    whole = float(np.mean(along.inertia))
    reduced = load * max(whole - load, MOTOR * whole) / whole
    # Tustin's rule, the coefficients of 1, 1/z and 1/z² (SciPy's way there takes 2 ms a torque)
    rate = 2.0 / along.sample_time
    above = np.array([k + c * rate, 2.0 * k, k - c * rate])
    below = above + reduced * rate**2 * np.array([1.0, -2.0, 1.0])
    above, below = above / below[0], below / below[0]
    driven = np.zeros(len(torque) + 1)  # its last number moves nothing any more
    driven[:-1] = above[0] * torque
    driven[1:-1] += above[1] * torque[:-1]
    driven[2:-1] += above[2] * torque[:-2]
    return along.swung(driven, 1.0, -below[1], -below[2])[1:]

EFFECT = Effect(
    name="transmission_error",
    site="setup",
    mechanism="transmission",
    parameters=(
        Parameter(
            "order", "order", lower=0, limits=order_limits(0.8, whole=False),
            meaning="n, periods a turn; on a linear axis 2π over the period",
        ),
        Parameter("amplitude", "position", lower=0, limits=off_centre, meaning="A"),
        Parameter("phase", "angle", lower=-6.5, upper=6.5, meaning="φ"),
    ),
    c="w_order = p[0]; w_amp = p[1]; w_phase = p[2];",
    sentence=(
        "The transmission of joint {joint} errs by {amplitude}, {repeats}: the load runs ahead "
        "of the motor and behind."
    ),
    experiment="Constant speeds over whole turns, slow and fast, or a second sensor on the load.",
    equation="ql = qm + A sin(n qm + φ)",
    over="position",
    linear=("amplitude",),
    grid={"order": lambda f: [1.0, *orders(f)], "phase": (0.0, 1.5707963267948966)},
    column=_column,
    hidden=True,
    rivals=("ripple", "sensor_harmonic", "elasticity"),
    shown_by=("position_load",),
    why_not="the load's motion is not the motor's: correct the reference by the error",
)
