"""Joint point-to-point: all joints start and stop together."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.reference.core import Array, Reference
from zendsp.reference.kind import BLEND, CALM_S, MOVE_TIME, TIME_LAW, Kind, Parameter, spread
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import Law, make_grid, rest_to_rest


def fastest_duration(machine: Machine, qd: Array, qdd: Array) -> float:
    """Shortest duration of a path within the speed and acceleration limits, s.

    Slowing a path down by r divides its speeds by r and its accelerations by r^2, so one plan tells
    the answer.

    Parameters
    ----------
    machine : Machine
        Its limits count.
    qd, qdd : ndarray, shape (N, joints)
        The path played in 1 s.

    Returns
    -------
    float
        s, with 1 % to spare.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> arm = load_machine("imi_planar")
    >>> round(fastest_duration(arm, np.array([[12.56, 0.0]]), np.zeros((1, 2))), 3)
    2.02
    """
    speed = float(np.max(np.abs(qd) / machine.pace.speed))
    acceleration = float(np.max(np.abs(qdd) / machine.pace.acceleration))
    return float(1.01 * max(speed, acceleration**0.5, 1e-3))


def make_point_to_point(
    machine: Machine,
    *,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    duration: float | None = None,
    law: Law = "quintic",
    blend: float = 0.25,
    sample_time: float | None = None,
) -> Reference:
    """Rest to rest along a straight line in joint space: q = start + s(t) (goal - start).

    Parameters
    ----------
    machine : Machine
        Whose joints move.
    start, goal : array_like, shape () or (joints,)
        rad.
    duration : float, optional
        s; where not given, 2 s, or as long as the limits need. 0 takes the shortest that the
        speed and acceleration limits allow.
    law : {"quintic", "trapezoid"}
        Time law, see `zendsp.reference.profiles.rest_to_rest`.
    blend : float
        Share of each ramp of the trapezoid.
    sample_time : float, optional
        s; the machine's where not given.

    Returns
    -------
    Reference
        Kind "point_to_point".

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_point_to_point(load_machine("imi_planar"), start=0.0, goal=[1.0, -0.5], duration=2.0)
    >>> ref.q[-1].tolist()
    [1.0, -0.5]
    """  # noqa: E501
    dt = sample_time or machine.sample_time
    a, b = spread(machine, "start", start), spread(machine, "goal", goal)
    if duration is None or duration <= 0.0:
        _, sd, sdd = rest_to_rest(np.linspace(0.0, 1.0, 2001), 1.0, law, blend)
        shortest = fastest_duration(machine, sd[:, None] * (b - a), sdd[:, None] * (b - a))
        duration = max(shortest, CALM_S if duration is None else 10 * dt)
    t = make_grid(duration, dt)
    s, sd, sdd = rest_to_rest(t, duration, law, blend)
    used = {
        "start": a.tolist(), "goal": b.tolist(), "duration": duration, "law": law, "blend": blend,
    }
    return Reference(
        a + s[:, None] * (b - a), dt, sd[:, None] * (b - a), sdd[:, None] * (b - a),
        kind="point_to_point", parameters=used, machine=machine.name,
    )  # fmt: skip


KIND = Kind(
    "point_to_point",
    "Joint point-to-point",
    "All joints move from start to goal together, at rest at both ends.",
    (
        Parameter("start", "joints", "rad", None, "Start of every joint."),
        Parameter(
            "goal",
            "joints",
            "rad",
            0.5,
            "Goal of every joint.",
            by_machine={"imi_planar": [1.0, -0.5], "wam7": [0.5, -1.4, 0.5, 2.5, 0.3, 0.3, 0.3]},
            keeps="goal",
        ),
        MOVE_TIME,
        TIME_LAW,
        BLEND,
    ),
    make_point_to_point,
)
