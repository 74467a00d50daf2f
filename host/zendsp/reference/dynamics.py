"""Nominal dynamics of the three machines, for torque limits and for predicting what an open-loop
torque does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array
from zendsp.tree import Body, forward_dynamics, inverse_dynamics

G = 9.81  # m/s^2
State = Sequence[float]
SIGN_SLOPE = 100.0  # s/rad: sign(qd) is replaced by tanh(100 qd), as in the pendulum paper


class Dynamics(Protocol):
    """A rigid-body model with friction."""

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque of a motion, N m; all of shape (N, joints)."""
        ...

    def acceleration(self, q: State, qd: State, tau: State) -> State:
        """Acceleration of one state under a torque, rad/s^2; one number per joint."""
        ...


class Planar2R(Dynamics):
    """M(q) qdd + C(q, qd) + viscous qd + coulomb sign(qd) = tau of two joints on vertical axes.

    M = [[p1 + 2 p3 cos q2, p2 + p3 cos q2], [p2 + p3 cos q2, p2]], C = p3 sin q2 [-qd2 (2 qd1 +
    qd2), qd1^2].
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.p1, self.p2, self.p3 = (float(parameters[k]) for k in ("p1", "p2", "p3"))
        self.viscous = np.asarray(parameters["viscous"], dtype=np.float64)
        self.coulomb = np.asarray(parameters["coulomb"], dtype=np.float64)
        # plain floats: a prediction takes 10^5 evaluations, and NumPy would spend 20 us on each
        self._viscous, self._coulomb = self.viscous.tolist(), self.coulomb.tolist()

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        s, c = self.p3 * np.sin(q[:, 1]), self.p3 * np.cos(q[:, 1])
        m11, m12, m22 = self.p1 + 2 * c, self.p2 + c, self.p2
        a1, a2, v1, v2 = qdd[:, 0], qdd[:, 1], qd[:, 0], qd[:, 1]
        rigid = np.stack(
            [m11 * a1 + m12 * a2 - s * v2 * (2 * v1 + v2), m12 * a1 + m22 * a2 + s * v1**2], axis=1
        )
        return np.asarray(rigid + self.viscous * qd + self.coulomb * np.tanh(SIGN_SLOPE * qd))

    def acceleration(self, q: State, qd: State, tau: State) -> State:
        s, c = self.p3 * math.sin(q[1]), self.p3 * math.cos(q[1])
        m11, m12, m22 = self.p1 + 2 * c, self.p2 + c, self.p2
        (b1, b2), (f1, f2), (v1, v2) = self._viscous, self._coulomb, qd
        r1 = tau[0] + s * v2 * (2 * v1 + v2) - b1 * v1 - f1 * math.tanh(SIGN_SLOPE * v1)
        r2 = tau[1] - s * v1 * v1 - b2 * v2 - f2 * math.tanh(SIGN_SLOPE * v2)
        det = m11 * m22 - m12 * m12
        return (m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det


class Pendulum(Dynamics):
    """theta1 qdd + theta2 g sin q + theta3 tanh(beta qd) + viscous qd = tau (Hardware 2025, 3(3),
    11, with a viscous term).
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.theta1, self.theta2, self.theta3 = (
            float(parameters[k]) for k in ("theta1", "theta2", "theta3")
        )
        self.beta, self.viscous = float(parameters["beta"]), float(parameters.get("viscous", 0.0))

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        resist = (
            self.theta2 * G * np.sin(q) + self.theta3 * np.tanh(self.beta * qd) + self.viscous * qd
        )
        return np.asarray(self.theta1 * qdd + resist)

    def acceleration(self, q: State, qd: State, tau: State) -> State:
        resist = (
            self.theta2 * G * math.sin(q[0])
            + self.theta3 * math.tanh(self.beta * qd[0])
            + self.viscous * qd[0]
        )
        return ((tau[0] - resist) / self.theta1,)


class Tree(Dynamics):
    """A tree of rigid bodies, as a URDF has it."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.bodies: Sequence[Body] = parameters["bodies"]
        self.gravity = np.array(parameters["gravity"], dtype=np.float64)
        self.viscous = np.asarray(parameters["viscous"], dtype=np.float64)
        self.coulomb = np.asarray(parameters["coulomb"], dtype=np.float64)

    def _friction(self, qd: Array) -> Array:
        return np.asarray(self.viscous * qd + self.coulomb * np.tanh(SIGN_SLOPE * qd))

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        return inverse_dynamics(self.bodies, self.gravity, q, qd, qdd) + self._friction(qd)

    def acceleration(self, q: State, qd: State, tau: State) -> State:
        v = np.array(qd, dtype=np.float64)
        free = np.array(tau, dtype=np.float64) - self._friction(v)
        at = np.array(q, dtype=np.float64)
        answer: list[float] = forward_dynamics(self.bodies, self.gravity, at, v, free).tolist()
        return answer


class DHArm(Tree):
    """A serial arm given by standard Denavit–Hartenberg frames."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        super().__init__({**parameters, "bodies": make_bodies(parameters["link"])})


def make_bodies(links: Sequence[Mapping[str, Any]]) -> list[Body]:
    """The links of a serial arm in standard (distal) Denavit–Hartenberg convention.

    Frame k is fixed to link k; joint k turns about z of frame k-1. The constant part
    Trans(0, 0, d) Trans(a, 0, 0) Rot(x, alpha) of link k places joint k+1 and link k's inertia.

    Parameters
    ----------
    links : sequence of mapping
        Tables with a, alpha_deg, d, mass, com, inertia.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> len(make_bodies(load_machine("wam7").parameters["link"]))
    7
    """
    bodies: list[Body] = []
    rotation, place, axis = np.eye(3), np.zeros(3), np.array([0.0, 0.0, 1.0])
    for k, link in enumerate(links):
        alpha = np.deg2rad(link["alpha_deg"])
        # cos and sin of a right angle exactly, so that two builds of the arm agree to the last bits
        c, s = np.round(np.cos(alpha), 15), np.round(np.sin(alpha), 15)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        at = np.array([link["a"], 0.0, link["d"]], dtype=np.float64)
        xx, yy, zz, xy, xz, yz = link["inertia"]
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        com = at + turn @ np.array(link["com"], dtype=np.float64)
        bodies.append(Body(k - 1, False, axis, rotation, place, float(link["mass"]), com,
                           turn @ about_com @ turn.T))  # fmt: skip
        rotation, place = turn, at
    return bodies


def make_dynamics(kind: str, parameters: Mapping[str, Any]) -> Dynamics:
    """The dynamics of one kind of mechanism.

    Parameters
    ----------
    kind : str
        "planar2r", "pendulum", "dh" or "tree".
    parameters : mapping
        Numbers of the model.

    Returns
    -------
    Dynamics
        Inverse and forward dynamics.

    Raises
    ------
    ReferenceError_
        No such kind.

    Examples
    --------
    >>> import numpy as np
    >>> arm = make_dynamics("planar2r", dict(p1=3.0, p2=0.2, p3=0.2, viscous=[0, 0], coulomb=[0, 0]))
    >>> arm.inverse(np.zeros((1, 2)), np.zeros((1, 2)), np.array([[1.0, 0.0]])).tolist()
    [[3.4, 0.4]]
    """  # noqa: E501
    kinds: dict[str, Callable[[Mapping[str, Any]], Dynamics]] = {
        "planar2r": Planar2R, "pendulum": Pendulum, "dh": DHArm, "tree": Tree,
    }
    if kind not in kinds:
        raise ReferenceError_(f'machine kind "{kind}" is unknown; expected {", ".join(kinds)}')
    return kinds[kind](parameters)


def predict_motion(
    dynamics: Dynamics, tau: Array, sample_time: float, q0: Array
) -> tuple[Array, Array, Array]:
    """Where an open-loop torque, held over each sample, takes the nominal machine.

    Parameters
    ----------
    dynamics : Dynamics
        Nominal model.
    tau : ndarray, shape (N, joints)
        Command, N m; row k acts from sample k to k+1.
    sample_time : float
        s.
    q0 : ndarray, shape (joints,)
        Start, at rest, rad.

    Returns
    -------
    q, qd, qdd : ndarray, shape (N, joints)
        Motion at the samples; classical Runge–Kutta with four steps a sample.

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> q, qd, qdd = predict_motion(load_machine("pendulum").dynamics, np.zeros((3, 1)), 0.001, np.zeros(1))
    >>> float(abs(q).max())
    0.0
    """  # noqa: E501
    steps = 4
    h = sample_time / steps
    q, qd = [float(x) for x in q0], [0.0] * len(q0)
    rows: list[list[list[float]]] = []
    for u in tau.tolist():
        rows.append([q, qd, list(dynamics.acceleration(q, qd, u))])
        for _ in range(steps):
            q, qd = _runge_kutta(dynamics, q, qd, u, h)
    table = np.array(rows)
    return table[:, 0], table[:, 1], table[:, 2]


def _runge_kutta(
    dynamics: Dynamics, q: list[float], qd: list[float], u: State, h: float
) -> tuple[list[float], list[float]]:
    """One classical step of h seconds."""
    half = 0.5 * h
    a1 = dynamics.acceleration(q, qd, u)
    v2 = [v + half * a for v, a in zip(qd, a1, strict=True)]
    a2 = dynamics.acceleration([x + half * v for x, v in zip(q, qd, strict=True)], v2, u)
    v3 = [v + half * a for v, a in zip(qd, a2, strict=True)]
    a3 = dynamics.acceleration([x + half * v for x, v in zip(q, v2, strict=True)], v3, u)
    v4 = [v + h * a for v, a in zip(qd, a3, strict=True)]
    a4 = dynamics.acceleration([x + h * v for x, v in zip(q, v3, strict=True)], v4, u)
    after = [
        x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip(q, qd, v2, v3, v4, strict=True)
    ]
    return after, [
        v + h / 6 * (a + 2 * b + 2 * c + d)
        for v, a, b, c, d in zip(qd, a1, a2, a3, a4, strict=True)
    ]
