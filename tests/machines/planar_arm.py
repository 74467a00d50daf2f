"""The planar arm by its equations, with what an effect adds, and an integrator for both: what the
machine in C is held against.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from plants import Plant

from zendsp_target.concealed.sealed import Concealed, ConcealedEffect

Array = np.ndarray  # type: ignore[type-arg]
P1, P2, P3 = 3.473, 0.196, 0.242
VISCOUS, COULOMB = np.array([5.3, 1.1]), np.array([8.45, 2.35])
# N m/rad, of imi_planar.c with plain friction: a sliding bristle is bent by the Coulomb level
BRISTLE = 2000.0 * np.array([12000.0, 1500.0])
SAMPLES, PERIOD, STEPS = 500, 0.001, 4

# rad/s: both joints slide from the first instant on, so that sign(qd) = 1 throughout
START = np.array([0.8, 1.2])


def command(t: float) -> Array:
    """Torques that keep both joints moving one way, N m."""
    return np.array([26.0 + 6.0 * math.sin(9.0 * t), 6.4 + 0.9 * math.sin(14.0 * t)])


# plain friction and no electronics: nothing but the equations
BARE = "friction = plain\nideal = 1\n"


def lines(hidden: Concealed) -> str:
    return "ideal = 1\n" + "".join(f"{k} = {v}\n" for k, v in hidden.config().items())


def config(effect: str, joint: int, **parameters: float) -> str:
    hidden = Concealed(
        "imi_planar", (ConcealedEffect(effect, joint, parameters),), "test", friction="plain"
    )
    return lines(hidden)


def run_plant(text: str) -> Array:
    with Plant("imi_planar", text) as plant:
        rows = []
        for j in range(2):
            plant.truth.qd[j] = START[j]
            plant.truth.z[j] = COULOMB[j] / BRISTLE[j]
        for k in range(SAMPLES):
            rows.append(plant.q)
            plant.torque(command(k * PERIOD))
        return np.array(rows)


Extra = Callable[[float, Array, Array, Array, Array], Array]
Case = Callable[[], Array]  # joint positions of the reference


def run_reference(
    torque: Extra | None = None,
    mass: Array | Callable[[Array], Array] | None = None,
    actuator: Callable[[float], Array] = command,
    states: Callable[[float, Array, Array, Array], Array] | None = None,
    x0: tuple[float, ...] = (),
) -> Array:
    """RK4 of M qdd + c + viscous qd + coulomb + extra = tau held over each sample; extra may have
    states x of its own.
    """

    def added(q: Array) -> Array:
        return np.zeros((2, 2)) if mass is None else mass(q) if callable(mass) else mass

    def rate(t: float, y: Array, tau: Array) -> Array:
        q, qd, x = y[:2], y[2:4], y[4:]
        c, s = P3 * math.cos(q[1]), P3 * math.sin(q[1])
        m = np.array([[P1 + 2 * c, P2 + c], [P2 + c, P2]]) + added(q)
        bias = gyroscopic(added, q, qd) if callable(mass) else np.zeros(2)
        bias += np.array([-s * qd[1] * (2 * qd[0] + qd[1]), s * qd[0] ** 2])
        bias += VISCOUS * qd + COULOMB
        extra = np.zeros(2) if torque is None else torque(t, q, qd, tau, x)
        qdd = np.linalg.solve(m, tau - bias - extra)
        return np.concatenate([qd, qdd, np.zeros(0) if states is None else states(t, q, qd, x)])

    y, rows, h = np.concatenate([np.zeros(2), START, x0]), [], PERIOD / STEPS
    for k in range(SAMPLES):
        rows.append(y[:2])
        tau = actuator(k * PERIOD)
        for i in range(STEPS):
            t = k * PERIOD + i * h
            k1 = rate(t, y, tau)
            k2 = rate(t + h / 2, y + h / 2 * k1, tau)
            k3 = rate(t + h / 2, y + h / 2 * k2, tau)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, y + h * k3, tau))
    return np.array(rows)


def gyroscopic(mass: Callable[[Array], Array], q: Array, qd: Array) -> Array:
    """The torque C qd of a mass matrix that changes with position (Lagrange, by differences)."""
    step = 1e-6 * np.eye(2)
    # [k, i, j] = dM_ij / dq_k
    slope = np.array([(mass(q + h) - mass(q - h)) / 2e-6 for h in step])
    return np.einsum("kij,k,j->i", slope, qd, qd) - 0.5 * np.einsum("ijk,j,k->i", slope, qd, qd)


def point_mass(kg: float, x: float, y: float, link: int) -> Callable[[Array], Array]:
    """Mass matrix of a point at (x, y) on a link: m J^T J of its place on the table."""

    def place(q: Array) -> Array:
        if link == 1:
            a, base = q[0], np.zeros(2)
        else:
            a, base = q[0] + q[1], 0.36 * np.array([math.cos(q[0]), math.sin(q[0])])
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.asarray(base + turn @ np.array([x, y]))

    def matrix(q: Array) -> Array:
        J = np.array([(place(q + h) - place(q - h)) / 2e-4 for h in 1e-4 * np.eye(2)])
        return np.asarray(kg * J @ J.T)

    return matrix


def on(joint: int, value: float) -> Array:
    out = np.zeros(2)
    out[joint - 1] = value
    return out


def entry(row: int, column: int, value: float) -> Array:
    out = np.zeros((2, 2))
    out[row - 1, column - 1] = value
    return out


def lagged(t: float) -> Array:
    """Joint 2 through a lag of 10 ms, from zero: mean over the sample of the exact answer."""
    T, u = 0.010, 0.0
    for k in range(round(t / PERIOD)):
        u += (command(k * PERIOD)[1] - u) * (1 - math.exp(-PERIOD / T))
    h = PERIOD / T
    goal = command(t)
    return np.array([goal[0], u + (goal[1] - u) * (1 - (1 - math.exp(-h)) / h)])


def run_behind(k: float, c: float, gap: float, load: float) -> Array:
    """RK4 of both links, the second behind a spring or gap: motor (y[1], y[3]) and link (y[4:])."""

    def push(bend: float, rate: float) -> float:
        inside = abs(bend) - gap / 2
        if gap == 0.0:
            return k * bend + c * rate
        if inside <= 0.0:
            return 0.0
        return math.copysign(max(0.0, k * inside + c * rate * math.copysign(1, bend)), bend)

    def rate(y: Array, tau: Array) -> Array:
        (_, motor, v1, vm, link, vl), turned = y, P2 - load
        cos, sin = P3 * math.cos(link), P3 * math.sin(link)
        m = np.array([[P1 + 2 * cos, P2 + cos], [P2 + cos, P2 - turned]])
        bias = np.array([-sin * vl * (2 * v1 + vl), sin * v1**2])
        held = push(motor - link, vm - vl)
        a1, al = np.linalg.solve(m, [tau[0] - VISCOUS[0] * v1 - COULOMB[0], held] - bias)
        am = (tau[1] - VISCOUS[1] * vm - COULOMB[1] - held) / turned
        return np.array([v1, vm, a1, am, vl, al])

    y, rows, h = np.array([0.0, 0.0, *START, 0.0, 0.0]), [], PERIOD / STEPS
    for n in range(SAMPLES):
        rows.append(y[:2])
        tau = command(n * PERIOD)
        for _ in range(STEPS):
            k1 = rate(y, tau)
            k2 = rate(y + h / 2 * k1, tau)
            k3 = rate(y + h / 2 * k2, tau)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3, tau))
    return np.array(rows)


def bouc_wen(
    force: float, stiffness: float
) -> tuple[Extra, Callable[[float, Array, Array, Array], Array]]:
    A = stiffness / force

    def states(t: float, q: Array, qd: Array, x: Array) -> Array:
        return np.array([A * (qd[1] - 0.5 * (abs(qd[1]) * x[0] + qd[1] * abs(x[0])))])

    return (lambda t, q, qd, tau, x: on(2, force * x[0])), states


TWO_PI = 2 * math.pi


def torque(joint: int, law: Callable[[float, Array, Array, Array], float]) -> Case:
    """The reference with one more torque that resists; the law is one of t, q, qd and tau."""
    return lambda: run_reference(lambda t, q, qd, tau, x: on(joint, law(t, q, qd, tau)))


def driven(actuator: Callable[[float], Array]) -> Case:
    return lambda: run_reference(actuator=actuator)


def swell(t: float) -> float:
    """A push between 0.2 and 0.5 s."""
    return math.sin(math.pi * (t - 0.2) / 0.3) ** 2 if 0.2 < t < 0.5 else 0.0


def late(t: float) -> Array:
    """Joint 1 by 8 ms."""
    return np.array([command(t - 0.008)[0] if t > 0.0079 else 0.0, command(t)[1]])
