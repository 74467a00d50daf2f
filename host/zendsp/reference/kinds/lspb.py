"""Linear segment with parabolic blends, in the form of the seven-joint WAM paper."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter, spread
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import integrate_velocity, make_grid


def blend_acceleration(q_i: float, q_f: float, t_f: float, t_c: float) -> float:
    """Acceleration of the blends, 4 (q_f - q_i) / (t_f^2 - (-2 (t_c - 0.5 t_f))^2), rad/s^2.

    The WAM paper prints this as the cruise velocity, with the acceleration numerically equal to it:
    true at its blend time t_c = 1 s. In general it is the acceleration, and the cruise velocity is
    t_c times as much; so the position reached is q_f for any t_c.

    Parameters
    ----------
    q_i, q_f : float
        Start and goal, rad.
    t_f : float
        Duration, s.
    t_c : float
        Blend time, s.

    Returns
    -------
    float
        rad/s^2.

    Examples
    --------
    >>> round(blend_acceleration(-0.55, -0.05, 7.0, 1.0), 4)
    0.0833
    """
    return 4.0 * (q_f - q_i) / (t_f**2 - (-2.0 * (t_c - 0.5 * t_f)) ** 2)


def make_lspb(
    machine: Machine,
    *,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    duration: float = 7.0,
    blend_time: float = 1.0,
    hold: float = 0.0,
    back: bool = False,
    sample_time: float | None = None,
) -> Reference:
    """Parabola, straight line, parabola; joints whose start and goal agree stay where they are.

    Parameters
    ----------
    machine : Machine
        Whose joints move.
    start, goal : array_like, shape () or (joints,)
        rad.
    duration : float
        t_f of one way, s.
    blend_time : float
        t_c, s; at most half of the duration.
    hold : float
        Rest after each way, s.
    back : bool
        Return to the start the same way; then the reference is cyclic.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "lspb".

    Raises
    ------
    ReferenceError_
        The blends do not fit into the duration.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_lspb(load_machine("wam7"), start=-0.55, goal=-0.05)
    >>> round(float(ref.qd.max()), 4), round(float(ref.q[-1, 0]), 9)
    (0.0833, -0.05)
    """
    dt = sample_time or machine.sample_time
    if not 0.0 < blend_time <= 0.5 * duration:
        raise ReferenceError_(
            f"blend_time is {blend_time} s; with a duration of {duration} s it must be in 0 …"
            f" {duration / 2:g} s"
        )
    a, b = spread(machine, "start", start), spread(machine, "goal", goal)
    knots = [0.0, blend_time, duration - blend_time, duration]
    speeds = (
        np.array([0.0, 1.0, 1.0, 0.0])
        * blend_time
        * blend_acceleration(0.0, 1.0, duration, blend_time)
    )
    way = duration + hold
    if back:
        knots, speeds = knots + [way + k for k in knots], np.concatenate([speeds, -speeds])
    t = make_grid(2 * way if back else way, dt)
    s, sd, sdd = integrate_velocity(t, knots, speeds.tolist())
    used = {
        "start": a.tolist(), "goal": b.tolist(), "duration": duration, "blend_time": blend_time,
        "hold": hold, "back": back,
    }
    return Reference(
        a + s[:, None] * (b - a), dt, sd[:, None] * (b - a), sdd[:, None] * (b - a),
        kind="lspb", parameters=used, machine=machine.name, cyclic=back,
    )  # fmt: skip


KIND = Kind(
    "lspb",
    "LSPB",
    "Linear segment with parabolic blends, as in the WAM paper: 0.5 rad in 7 s cruises at 0.083"
    " rad/s.",
    (
        Parameter("start", "joints", "rad", None, "Start of every joint."),
        Parameter(
            "goal",
            "joints",
            "rad",
            0.5,
            "Goal of every joint.",
            by_machine={"wam7": [0.5, -1.4, 0.5, 2.5, 0.5, 0.5, 0.5]},
            keeps="goal",
        ),
        Parameter("duration", "float", "s", 7.0, "Time of one way.", 0.01, 3600.0),
        Parameter(
            "blend_time", "float", "s", 1.0, "Time of each parabola; at most half the duration.",
            1e-3, 1800.0,
        ),
        Parameter("hold", "float", "s", 0.0, "Rest after each way.", 0.0, 600.0),
        Parameter("back", "bool", "", False, "Return to the start the same way."),
    ),
    make_lspb,
)
