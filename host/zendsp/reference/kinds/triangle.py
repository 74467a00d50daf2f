"""Triangular velocity, repeated: the low-speed friction experiment of the fast-prototyping paper.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter, on_joints, spread
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import integrate_velocity, make_grid


def make_triangle(
    machine: Machine,
    *,
    joint: int = 1,
    start: npt.ArrayLike,
    peak: float = 1.0,
    rise: float = 1.0,
    cycles: int = 4,
    sample_time: float | None = None,
) -> Reference:
    """Velocity 0 → peak → 0 → -peak → 0 in straight lines of ``rise`` seconds each, ``cycles``
    times.

    Parameters
    ----------
    machine : Machine
        Whose joint moves.
    joint : int
        1-based; 0 moves all joints.
    start : array_like, shape () or (joints,)
        Middle of the motion, rad: it begins peak·rise/2 before.
    peak : float
        Largest speed, rad/s.
    rise : float
        Time from 0 to the peak, s.
    cycles : int
        Repetitions, to be averaged.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "triangle", cyclic.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_triangle(load_machine("imi_planar"), start=0.0, cycles=1)
    >>> round(float(ref.q[:, 0].max()), 6), ref.duration
    (0.5, 4.0)
    """
    dt = sample_time or machine.sample_time
    a = spread(machine, "start", start)
    # one cycle is a whole number of samples, so that cycles can be averaged row by row
    rise = max(1, round(rise / dt)) * dt
    knots = (np.arange(4 * cycles + 1) * rise).tolist()
    values = [0.0, peak, 0.0, -peak] * cycles + [0.0]
    s, sd, sdd = integrate_velocity(make_grid(knots[-1], dt), knots, values)
    motion = s - 0.5 * peak * rise, sd, sdd
    q, qd, qdd = (on_joints(machine, joint, x) for x in motion)
    q += a
    used = {"joint": joint, "start": a.tolist(), "peak": peak, "rise": rise, "cycles": cycles}
    return Reference(
        q, dt, qd, qdd, kind="triangle", parameters=used, machine=machine.name, cyclic=True
    )


KIND = Kind(
    "triangle",
    "Triangular velocity",
    "Velocity up and down in straight lines, both ways, repeated: low-speed friction.",
    (
        Parameter("joint", "int", "", 1, "Joint that moves; 0: all.", 0, 64),
        Parameter("start", "joints", "rad", None, "Middle of the motion."),
        Parameter("peak", "float", "rad/s", 1.0, "Largest speed.", 1e-6, 1000.0),
        Parameter("rise", "float", "s", 1.0, "Time from rest to the peak.", 1e-3, 600.0),
        Parameter("cycles", "int", "", 4, "Repetitions.", 1, 10000),
    ),
    make_triangle,
)
