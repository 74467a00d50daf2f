"""Trapezoidal velocity there and back at a list of speeds: the moves of a friction map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter, on_joints, spread
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import integrate_velocity, make_grid


def make_trapezoid(
    machine: Machine,
    *,
    joint: int = 1,
    start: npt.ArrayLike,
    travel: float = 0.5,
    speeds: npt.ArrayLike = (0.1,),
    acceleration: float = 2.0,
    hold: float = 0.3,
    sample_time: float | None = None,
) -> Reference:
    """For each speed: ramp up, cruise, ramp down over ``travel``, rest, the same back, rest.

    Parameters
    ----------
    machine : Machine
        Whose joint moves.
    joint : int
        1-based; 0 moves all joints.
    start : array_like, shape () or (joints,)
        rad.
    travel : float
        Way of each move, rad; negative begins the other way.
    speeds : array_like
        Cruise speeds, rad/s, positive.
    acceleration : float
        Of the ramps, rad/s^2.
    hold : float
        Rest after each move, s.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "trapezoid", cyclic.

    Raises
    ------
    ReferenceError_
        A speed that the travel is too short to reach.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_trapezoid(load_machine("wam7"), joint=2, start=0.0, travel=0.4, speeds=[0.1, 0.2])
    >>> round(float(ref.qd[:, 1].max()), 6), round(float(ref.q[:, 1].max()), 6)
    (0.2, 0.4)
    """  # noqa: E501
    dt = sample_time or machine.sample_time
    a = spread(machine, "start", start)
    knots, values, now = [0.0], [0.0], 0.0
    for speed in np.atleast_1d(np.asarray(speeds, dtype=np.float64)):
        ramp = speed / acceleration
        cruise = abs(travel) / speed - ramp
        if speed <= 0.0 or cruise < 0.0:
            raise ReferenceError_(
                f"a travel of {abs(travel):g} rad with {acceleration:g} rad/s^2 reaches"
                f" {np.sqrt(abs(travel) * acceleration):.4g} rad/s, not {speed:g} rad/s: raise the"
                " acceleration or the travel"
            )
        for direction in (np.sign(travel), -np.sign(travel)):
            v = direction * speed
            knots += [
                now + ramp, now + ramp + cruise, now + 2 * ramp + cruise,
                now + 2 * ramp + cruise + hold,
            ]
            values += [v, v, 0.0, 0.0]
            now = knots[-1]
    t = make_grid(now, dt)
    motion = integrate_velocity(t, knots, values)
    q, qd, qdd = (on_joints(machine, joint, x) for x in motion)
    q += a
    used = {
        "joint": joint,
        "start": a.tolist(),
        "travel": travel,
        "speeds": np.ravel(speeds).tolist(),
        "acceleration": acceleration,
        "hold": hold,
    }
    return Reference(
        q, dt, qd, qdd, kind="trapezoid", parameters=used, machine=machine.name, cyclic=True
    )


KIND = Kind(
    "trapezoid",
    "Trapezoidal velocity",
    "Constant-speed moves there and back at a list of speeds, for friction maps.",
    (
        Parameter("joint", "int", "", 1, "Joint that moves; 0: all.", 0, 64),
        Parameter("start", "joints", "rad", None, "Start of every joint."),
        Parameter("travel", "float", "rad", 0.5, "Way of each move."),
        Parameter("speeds", "list", "rad/s", [0.1, 0.2, 0.4], "Cruise speeds.", 1e-6, 1000.0),
        Parameter("acceleration", "float", "rad/s^2", 4.0, "Of the ramps.", 1e-6, 1e5),
        Parameter("hold", "float", "s", 0.3, "Rest after each move.", 0.0, 600.0),
    ),
    make_trapezoid,
)
