"""Cartesian point-to-point: the tip of the planar arm moves along a straight line."""

from __future__ import annotations

import numpy as np

from zendsp.reference.core import Array, Reference
from zendsp.reference.kind import BLEND, CALM_S, ELBOW, MOVE_TIME, TIME_LAW, Kind, Parameter
from zendsp.reference.kinds.point_to_point import fastest_duration
from zendsp.reference.kinematics import Elbow, cartesian_to_joint
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import Law, make_grid, rest_to_rest


def make_line(
    machine: Machine,
    *,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    duration: float | None = None,
    elbow: Elbow = "positive",
    law: Law = "quintic",
    blend: float = 0.25,
    sample_time: float | None = None,
) -> Reference:
    """Tip from (x0, y0) to (x1, y1) along a straight line, rest to rest.

    Parameters
    ----------
    machine : Machine
        A planar2r machine.
    x0, y0, x1, y1 : float
        Start and goal of the tip, m.
    duration : float, optional
        s; where not given, 2 s, or as long as the limits need. 0 takes the shortest that the
        joints' speed and acceleration limits allow.
    elbow : {"positive", "negative"}
        Sign of q2.
    law : {"quintic", "trapezoid"}
        Time law.
    blend : float
        Share of each ramp of the trapezoid.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "line".

    Raises
    ------
    ReferenceError_
        The line leaves the reach of the arm.

    Examples
    --------
    >>> from zendsp.reference import forward_kinematics, load_machine
    >>> arm = load_machine("imi_planar")
    >>> ref = make_line(arm, x0=0.5, y0=0.0, x1=0.3, y1=0.3, duration=1.0)
    >>> forward_kinematics(arm, ref.q[-1]).round(9).tolist()
    [0.3, 0.3]
    """
    dt = sample_time or machine.sample_time
    begin, way = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])

    def plan(t: Array, duration: float) -> tuple[Array, Array, Array]:
        s, sd, sdd = rest_to_rest(t, duration, law, blend)
        return cartesian_to_joint(
            machine, begin + np.outer(s, way), np.outer(sd, way), np.outer(sdd, way), elbow
        )

    if duration is None or duration <= 0.0:
        _, qd, qdd = plan(np.linspace(0.0, 1.0, 2001), 1.0)
        shortest = fastest_duration(machine, qd, qdd)
        duration = max(shortest, CALM_S if duration is None else 10 * dt)
    q, qd, qdd = plan(make_grid(duration, dt), duration)
    used = {
        "x0": x0, "y0": y0, "x1": x1, "y1": y1, "duration": duration, "elbow": elbow, "law": law,
        "blend": blend,
    }
    return Reference(q, dt, qd, qdd, kind="line", parameters=used, machine=machine.name)


KIND = Kind(
    "line",
    "Cartesian point-to-point",
    "The tip moves along a straight line, at rest at both ends.",
    (
        Parameter("x0", "float", "m", 0.5, "Start, x."),
        Parameter("y0", "float", "m", -0.2, "Start, y."),
        Parameter("x1", "float", "m", 0.3, "Goal, x."),
        Parameter("y1", "float", "m", 0.4, "Goal, y."),
        MOVE_TIME,
        ELBOW,
        TIME_LAW,
        BLEND,
    ),
    make_line,
    machine_kinds=("planar2r",),
)
