"""Circle of the tip in the plane, as in the fast-prototyping paper's control experiments."""

from __future__ import annotations

import numpy as np

from zendsp.reference.core import Reference
from zendsp.reference.kind import ELBOW, TIME_LAW, Kind, Parameter
from zendsp.reference.kinematics import Elbow, cartesian_to_joint
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import Law, make_grid, rest_to_rest


def make_circle(
    machine: Machine,
    *,
    radius: float,
    x: float = 0.5,
    y: float = 0.0,
    duration: float = 4.5,
    turns: int = 1,
    phase: float = 0.0,
    elbow: Elbow = "positive",
    law: Law = "quintic",
    blend: float = 0.15,
    sample_time: float | None = None,
) -> Reference:
    """Tip at (x + r cos(phase + 2 pi turns s), y + r sin(…)), s from 0 to 1, rest to rest.

    Parameters
    ----------
    machine : Machine
        A planar2r machine.
    radius : float
        m.
    x, y : float
        Centre, m.
    duration : float
        Of all turns together, s.
    turns : int
        Counterclockwise; negative clockwise.
    phase : float
        Where it starts, rad from the x axis.
    elbow : {"positive", "negative"}
        Sign of q2.
    law : {"quintic", "trapezoid"}
        Time law along the circle.
    blend : float
        Share of each ramp of the trapezoid.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "circle", cyclic.

    Raises
    ------
    ReferenceError_
        The circle leaves the reach of the arm.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_circle(load_machine("imi_planar"), radius=0.1)
    >>> ref.duration, bool(abs(ref.q[0] - ref.q[-1]).max() < 1e-9)
    (4.5, True)
    """
    dt = sample_time or machine.sample_time
    t = make_grid(duration, dt)
    s, sd, sdd = rest_to_rest(t, duration, law, blend)
    angle, w, wd = phase + 2 * np.pi * turns * s, 2 * np.pi * turns * sd, 2 * np.pi * turns * sdd
    c, sn = np.cos(angle), np.sin(angle)
    xy = np.stack([x + radius * c, y + radius * sn], axis=1)
    v = radius * np.stack([-sn * w, c * w], axis=1)
    a = radius * np.stack([-c * w**2 - sn * wd, -sn * w**2 + c * wd], axis=1)
    q, qd, qdd = cartesian_to_joint(machine, xy, v, a, elbow)
    used = {
        "radius": radius, "x": x, "y": y, "duration": duration, "turns": turns, "phase": phase,
        "elbow": elbow, "law": law, "blend": blend,
    }
    # a circle around the base turns the first joint once more each time: then the ends do not meet
    meets = bool(np.abs(q[-1] - q[0]).max() < 1e-9)
    return Reference(
        q, dt, qd, qdd, kind="circle", parameters=used, machine=machine.name, cyclic=meets
    )


KIND = Kind(
    "circle",
    "Circle of the tip",
    "The tip goes round a circle, at rest at both ends (about 4.5 s in the paper).",
    (
        Parameter("radius", "float", "m", 0.15, "Radius.", 1e-4, 0.35),
        Parameter("x", "float", "m", 0.5, "Centre, x."),
        Parameter("y", "float", "m", 0.0, "Centre, y."),
        Parameter("duration", "float", "s", 4.5, "Time of all turns together.", 0.05, 3600.0),
        Parameter(
            "turns", "int", "", 1, "Counterclockwise turns; negative: clockwise.", -1000, 1000
        ),
        Parameter("phase", "float", "rad", 0.0, "Where it starts, from the x axis."),
        ELBOW,
        TIME_LAW,
        Parameter("blend", "float", "", 0.15, "Share of each ramp (trapezoid).", 0.01, 0.5),
    ),
    make_circle,
    machine_kinds=("planar2r",),
)
