"""Optimal swing of the pendulum, with friction in its model: direct collocation with CasADi, solved
by IPOPT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.extras import need
from zendsp.reference.core import Array, Mode, Reference
from zendsp.reference.dynamics import G, predict_motion
from zendsp.reference.kind import Kind, Parameter
from zendsp.reference.machine import Machine

Objective = Literal["time", "energy"]
DEGREE = 3  # Radau points an interval: stiff decay at standstill, where tanh(beta qd) is steep
# Friction is smoothed at first and sharpened step by step, each solution the first guess of the
# next.
SLOPES = (0.1, 0.3, 1.0)
BELOW = 0.97  # of the limit of acceleration: the simulation's is up to 1.9 % larger
INTERRUPTED = "NonIpopt_Exception_Thrown"  # Ctrl-C, which the solver takes for an error
NEAR = 0.05  # rad: most that the simulated motion may miss its goal by
FINER = (1.5, 2.0)  # times the intervals, where it misses it
LONGEST_S = 30.0  # of the processor, one solution: where none is, restoration takes minutes
MORE_INTERVALS = 4  # than the least time asks for


@dataclass(frozen=True)
class _Problem:
    """One optimal control problem: numbers of the model, ends, bounds."""

    theta1: float
    gravity: float  # theta2 g, N m
    friction: float  # theta3, N m
    viscous: float
    beta: float
    q0: float
    q1: float
    torque: float  # bound, N m
    k_a: float
    R_a: float
    supply: float  # bound of |k_a qd + R_a tau / k_a|, V
    speed: float
    acceleration: float  # rad/s^2; inf where the machine has no limit
    intervals: int


def _collocate(
    p: _Problem, beta: float, duration: float | None, guess: dict[str, Array] | None
) -> dict[str, Array]:
    """Solve on Radau points with the torque held over each interval; ``duration`` None minimises
    the time.
    """
    ca = need("casadi", "swing", "the optimal swing", ReferenceError_)

    taus = np.append(0.0, ca.collocation_points(DEGREE, "radau"))
    basis = [np.poly1d([1.0]) for _ in taus]
    for j, tj in enumerate(taus):
        for r, tr in enumerate(taus):
            if r != j:
                basis[j] = basis[j] * np.poly1d([1.0, -tr]) / (tj - tr)
    # slope[j, k]: d basis_j / ds at point k
    slope = np.array([[np.polyder(b)(t) for t in taus] for b in basis])

    opti: Any = ca.Opti()
    n = p.intervals
    x = opti.variable(2, n * DEGREE + 1)
    u = opti.variable(1, n)
    total = opti.variable() if duration is None else duration
    h = total / n

    # one column an interval: what an interval begins with, and its collocation points
    points = [x[:, k : n * DEGREE - DEGREE + 1 + k : DEGREE] for k in range(DEGREE + 1)]

    def turned(at: Any) -> Any:
        """The acceleration at these states under the torque of their intervals."""
        resist = p.friction * ca.tanh(beta * at[1, :]) + p.viscous * at[1, :]
        return (u - p.gravity * ca.sin(at[0, :]) - resist) / p.theta1

    for k in range(1, DEGREE + 1):
        rate = ca.vertcat(points[k][1, :], turned(points[k]))
        opti.subject_to(sum(slope[j, k] * points[j] for j in range(DEGREE + 1)) == h * rate)
    energy = h * ca.sumsqr(u)
    opti.subject_to(x[:, 0] == ca.vertcat(p.q0, 0))
    opti.subject_to(x[:, -1] == ca.vertcat(p.q1, 0))
    opti.subject_to(opti.bounded(-p.torque, u, p.torque))
    opti.subject_to(opti.bounded(-p.speed, x[1, :], p.speed))
    opti.subject_to(opti.bounded(-p.supply, p.k_a * points[0][1, :] + p.R_a / p.k_a * u, p.supply))
    if math.isfinite(p.acceleration):
        for at in points:
            opti.subject_to(opti.bounded(-p.acceleration, turned(at), p.acceleration))
    if duration is None:
        opti.subject_to(opti.bounded(0.02, total, 20.0))
    # Time alone leaves the torque undetermined where nothing binds: a trace of energy settles it.
    opti.minimize(total + 1e-3 * energy / p.torque**2 if duration is None else energy / p.torque**2)

    # beside a solution the barrier begins low, or it is left again
    barrier = 1e-4 if guess else 0.1
    guess = guess or _first_guess(p, duration)
    opti.set_initial(x, guess["x"])
    opti.set_initial(u, guess["u"])
    if duration is None:
        opti.set_initial(total, guess["total"])
    quiet = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 400,
        "ipopt.max_cpu_time": LONGEST_S,
        "ipopt.tol": 1e-7,
        "ipopt.mu_init": barrier,
        "ipopt.acceptable_tol": 1e-5,
        "ipopt.acceptable_iter": 10,
    }
    opti.solver("ipopt", quiet)
    try:
        solution = opti.solve()
    except RuntimeError as error:
        if opti.return_status() == INTERRUPTED:
            raise KeyboardInterrupt from error
        raise ReferenceError_(
            f"no swing found from {p.q0:g} to {p.q1:g} rad with |torque| <= {p.torque:g} N m"
            f"{'' if duration is None else f' in {duration:g} s'} ({opti.return_status()}): "
            "allow more torque, more time or a nearer goal"
        ) from error
    return {
        "x": np.array(solution.value(x)),
        "u": np.atleast_1d(solution.value(u)),
        "total": np.array(float(solution.value(total))),
    }


def _first_guess(p: _Problem, duration: float | None) -> dict[str, Array]:
    """A smooth way from end to end; where gravity is too strong for that, a growing swing."""
    s = np.linspace(0.0, 1.0, p.intervals * DEGREE + 1)
    total = duration or 2.0
    way = p.q1 - p.q0
    if p.torque > p.gravity + p.friction or abs(way) < 1.0:
        q = p.q0 + way * (10 * s**3 - 15 * s**4 + 6 * s**5)
    else:
        period = 2 * math.pi * math.sqrt(p.theta1 / p.gravity)
        total = duration or 4 * period
        q = p.q0 + way * s**2 * np.cos(2 * np.pi * (s - 1.0) * total / (1.4 * period))
    v = np.gradient(q, s) / total
    # Push in the direction of motion, half as hard as allowed: how a swing is pumped.
    u = 0.5 * p.torque * np.sign(v[: -1 : DEGREE])
    return {"x": np.stack([q, v]), "u": u, "total": np.array(total)}


def _sharpen(
    p: _Problem, duration: float | None, guess: dict[str, Array] | None, slopes: tuple[float, ...]
) -> dict[str, Array]:
    """Solve with ever steeper friction; where the steepest does not converge the one before stands.

    Near standstill the slopes differ by a torque over a few milliseconds; the simulation that
    follows measures what that costs.
    """
    for factor in slopes:
        try:
            guess = _collocate(p, factor * p.beta, duration, guess)
        except ReferenceError_:
            if guess is None:
                raise
    assert guess is not None
    return guess


def _solve(p: _Problem, objective: Objective, duration: float, dt: float) -> tuple[Array, float]:
    """Torque of each interval, N m, and its length, s: a whole number of samples."""
    if objective == "energy":
        hold = math.ceil(duration / (p.intervals * dt) - 1e-9) * dt
        return _sharpen(p, hold * p.intervals, None, SLOPES)["u"], hold
    found = _sharpen(p, None, None, SLOPES)
    least = float(found["total"])
    hold = math.ceil(least / (p.intervals * dt) - 1e-9) * dt
    # As many intervals as the least time needs: with all of them the swing would be longer by up to
    # intervals * dt.
    first = math.ceil(least / hold - 1e-9)
    for n in range(first, first + MORE_INTERVALS):
        try:
            return (
                _sharpen(replace(p, intervals=n), hold * n, _resampled(found, n), SLOPES[-1:])["u"],
                hold,
            )
        except ReferenceError_:
            continue  # the least time of held torques is a little longer
    return _sharpen(p, hold * p.intervals, found, SLOPES[-1:])["u"], hold


def _resampled(guess: dict[str, Array], intervals: int) -> dict[str, Array]:
    """A solution as the first guess of another number of intervals."""
    x, u = guess["x"], guess["u"]
    old, new = np.linspace(0.0, 1.0, x.shape[1]), np.linspace(0.0, 1.0, intervals * DEGREE + 1)
    middle = (np.arange(intervals) + 0.5) / intervals
    return {
        "x": np.stack([np.interp(new, old, row) for row in x]),
        "u": np.interp(middle, (np.arange(len(u)) + 0.5) / len(u), u),
        "total": guess["total"],
    }


def make_swing(
    machine: Machine,
    *,
    start: float = 0.0,
    goal: float = math.pi,
    objective: Objective = "energy",
    duration: float = 0.8,
    torque_limit: float = 0.5,
    friction: float | None = None,
    intervals: int = 100,
    mode: Mode = "torque",
    sample_time: float | None = None,
) -> Reference:
    """Torque and motion that bring the pendulum from rest to rest in least time or with least ∫
    tau^2 dt.

    The model is theta1 qdd + theta2 g sin q + theta3 tanh(beta qd) + viscous qd = tau, with |tau|
    <= torque_limit and
    |k_a qd + R_a tau / k_a| <= supply, within the machine's limits of speed and acceleration. The
    torque is constant over each interval, an interval is a whole number of samples, so what is
    optimised is what a sampled controller plays. Torque in, motion out: the
    motion is the simulation of the model under that torque.

    Parameters
    ----------
    machine : Machine
        A pendulum.
    start, goal : float
        rad, hanging down is 0.
    objective : {"time", "energy"}
        Least time, or least squared torque within ``duration``.
    duration : float
        s, of objective "energy".
    torque_limit : float
        N m.
    friction : float, optional
        theta3 of the model, N m; the machine's nominal value where not given. 0 plans as if there
        were none.
    intervals : int
        Number of torque levels; up to twice as many where the motion misses its goal with these.
    mode : {"torque", "position"}
        Play the torque open loop, or follow the motion with the torque fed forward.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "swing", tau included; ``parameters["miss"]`` is |q(end) - goal| of the simulation,
        rad.

    Raises
    ------
    ReferenceError_
        Not a pendulum, or no such swing exists.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_swing(load_machine("pendulum"), goal=1.0, duration=0.5, intervals=50)
    >>> abs(float(ref.q[-1, 0]) - 1.0) < 0.01
    True
    """
    if machine.kind != "pendulum":
        raise ReferenceError_(
            f"{machine.name} is no pendulum: the optimal swing is planned for pendulums only"
        )
    dt = sample_time or machine.sample_time
    n = dict(machine.parameters)
    if friction is not None and friction >= 0.0:
        n["theta3"] = friction
    problem = _Problem(
        theta1=n["theta1"], gravity=n["theta2"] * G, friction=n["theta3"],
        viscous=n.get("viscous", 0.0), beta=n["beta"], q0=start, q1=goal, torque=torque_limit,
        k_a=n["k_a"], R_a=n["R_a"], supply=n["supply"], speed=float(machine.allowed.speed[0]),
        acceleration=BELOW * float(machine.allowed.acceleration[0]), intervals=intervals,
    )
    model = machine.dynamics if friction is None or friction < 0.0 else type(machine.dynamics)(n)  # type: ignore[call-arg]
    for many in (intervals, *(math.ceil(more * intervals) for more in FINER)):
        u, hold = _solve(replace(problem, intervals=many), objective, duration, dt)
        tau = np.append(np.repeat(u, round(hold / dt)), 0.0)[:, None]
        q, qd, qdd = predict_motion(model, tau, dt, np.array([start]))
        miss = abs(float(q[-1, 0]) - goal)
        if miss <= NEAR:
            break
    else:
        raise ReferenceError_(
            f"the swing found misses its goal by {miss:.3g} rad when simulated at {dt:g} s: raise"
            f" intervals (now {many})"
        )
    used = {
        "start": start,
        "goal": goal,
        "objective": objective,
        "duration": hold * len(u),
        "torque_limit": torque_limit,
        "friction": n["theta3"],
        "intervals": many,
        "mode": mode,
        "miss": miss,
    }
    return Reference(
        q, dt, qd, qdd, tau, kind="swing", parameters=used, machine=machine.name, mode=mode
    )


KIND = Kind(
    "swing",
    "Optimal swing",
    "Least time or least squared torque from rest to rest, with friction in the model (optimal"
    " control).",
    (
        Parameter("start", "float", "rad", 0.0, "Start; hanging down is 0."),
        Parameter("goal", "float", "rad", math.pi, "Goal; upright is pi."),
        Parameter(
            "objective", "choice", "", "energy", "What is minimised.", choices=("time", "energy")
        ),
        Parameter("duration", "float", "s", 0.8, "Duration (objective energy).", 0.02, 30.0),
        Parameter("torque_limit", "float", "N m", 0.5, "Largest torque.", 1e-3, 100.0),
        Parameter(
            "friction", "float", "N m", -1.0,
            "Friction level of the model; negative: the machine's.", -1.0, 100.0,
        ),
        Parameter("intervals", "int", "", 100, "Number of torque levels.", 10, 1000),
        Parameter(
            "mode",
            "choice",
            "",
            "torque",
            "Play open loop, or follow with feed-forward.",
            choices=("torque", "position"),
        ),
    ),
    make_swing,
    machine_kinds=("pendulum",),
    takes="takes 3 to 30 s",
)
