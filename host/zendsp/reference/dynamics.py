"""Nominal dynamics of the three machines, for torque limits and for predicting what an open-loop torque does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array

G = 9.81  # m/s^2
SIGN_SLOPE = 100.0  # s/rad: sign(qd) is replaced by tanh(100 qd), as in the pendulum paper


class Dynamics(Protocol):
    """A rigid-body model with friction; every array has shape (N, joints)."""

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque of a motion, N m."""
        ...

    def forward(self, q: Array, qd: Array, tau: Array) -> Array:
        """Acceleration under a torque, rad/s^2."""
        ...


class Planar2R:
    """M(q) qdd + C(q, qd) + viscous qd + coulomb sign(qd) = tau of two joints on vertical axes.

    M = [[p1 + 2 p3 cos q2, p2 + p3 cos q2], [p2 + p3 cos q2, p2]], C = p3 sin q2 [-qd2 (2 qd1 + qd2), qd1^2].
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.p1, self.p2, self.p3 = (float(parameters[k]) for k in ("p1", "p2", "p3"))
        self.viscous = np.asarray(parameters["viscous"], dtype=np.float64)
        self.coulomb = np.asarray(parameters["coulomb"], dtype=np.float64)

    def _bias(self, q: Array, qd: Array) -> Array:
        s = self.p3 * np.sin(q[:, 1])
        c = np.stack([-s * qd[:, 1] * (2 * qd[:, 0] + qd[:, 1]), s * qd[:, 0] ** 2], axis=1)
        return np.asarray(c + self.viscous * qd + self.coulomb * np.tanh(SIGN_SLOPE * qd))

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        c2 = self.p3 * np.cos(q[:, 1])
        m11, m12, m22 = self.p1 + 2 * c2, self.p2 + c2, self.p2
        a1, a2 = qdd[:, 0], qdd[:, 1]
        return np.stack([m11 * a1 + m12 * a2, m12 * a1 + m22 * a2], axis=1) + self._bias(q, qd)

    def forward(self, q: Array, qd: Array, tau: Array) -> Array:
        c2 = self.p3 * np.cos(q[:, 1])
        m11, m12, m22 = self.p1 + 2 * c2, self.p2 + c2, self.p2
        r = tau - self._bias(q, qd)
        det = m11 * m22 - m12**2
        return np.stack([m22 * r[:, 0] - m12 * r[:, 1], m11 * r[:, 1] - m12 * r[:, 0]], axis=1) / det[:, None]


class Pendulum:
    """theta1 qdd + theta2 g sin q + theta3 tanh(beta qd) + viscous qd = tau (Hardware 2025, 3(3), 11, with a viscous term)."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.theta1, self.theta2, self.theta3 = (float(parameters[k]) for k in ("theta1", "theta2", "theta3"))
        self.beta, self.viscous = float(parameters["beta"]), float(parameters.get("viscous", 0.0))

    def _bias(self, q: Array, qd: Array) -> Array:
        return np.asarray(self.theta2 * G * np.sin(q) + self.theta3 * np.tanh(self.beta * qd) + self.viscous * qd)

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        return self.theta1 * qdd + self._bias(q, qd)

    def forward(self, q: Array, qd: Array, tau: Array) -> Array:
        return (tau - self._bias(q, qd)) / self.theta1


class DHArm:
    """A serial arm given by standard Denavit–Hartenberg frames; rigid-body terms by Pinocchio."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.model = make_pinocchio_model(parameters)
        self.data = self.model.createData()
        self.viscous = np.asarray(parameters["viscous"], dtype=np.float64)
        self.coulomb = np.asarray(parameters["coulomb"], dtype=np.float64)

    def _friction(self, qd: Array) -> Array:
        return np.asarray(self.viscous * qd + self.coulomb * np.tanh(SIGN_SLOPE * qd))

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        import pinocchio as pin

        rows = [np.array(pin.rnea(self.model, self.data, *row)) for row in zip(q, qd, qdd, strict=True)]
        return np.array(rows) + self._friction(qd)

    def forward(self, q: Array, qd: Array, tau: Array) -> Array:
        import pinocchio as pin

        free = tau - self._friction(qd)
        return np.array([np.array(pin.aba(self.model, self.data, *row)) for row in zip(q, qd, free, strict=True)])


def make_pinocchio_model(parameters: Mapping[str, Any]) -> Any:
    """A ``pinocchio.Model`` of a serial arm in standard (distal) Denavit–Hartenberg convention.

    Frame k is fixed to link k; joint k turns about z of frame k-1. Pinocchio's joint frame k is frame k-1 turned by
    q_k, so the constant part Trans(0, 0, d) Trans(a, 0, 0) Rot(x, alpha) of link k places joint k+1 and link k's inertia.

    Parameters
    ----------
    parameters : mapping
        ``gravity`` (3 numbers, m/s^2) and ``link``: a list of tables with a, alpha_deg, d, mass, com, inertia.

    Returns
    -------
    pinocchio.Model
        Revolute joints joint1 … jointN.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> make_pinocchio_model(load_machine("wam7").parameters).nq
    7
    """
    import pinocchio as pin

    model = pin.Model()
    model.gravity.linear = np.array(parameters["gravity"], dtype=np.float64)
    placement, parent = pin.SE3.Identity(), 0
    for k, link in enumerate(parameters["link"], start=1):
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{k}")
        alpha = np.deg2rad(link["alpha_deg"])
        # cos and sin of a right angle exactly, so that two builds of the arm agree to the last bits
        c, s = np.round(np.cos(alpha), 15), np.round(np.sin(alpha), 15)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        placement = pin.SE3(rotation, np.array([link["a"], 0.0, link["d"]]))
        xx, yy, zz, xy, xz, yz = link["inertia"]
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(link["mass"], np.array(link["com"]), about_com)
        model.appendBodyToJoint(parent, body, placement)
    return model


def make_dynamics(kind: str, parameters: Mapping[str, Any]) -> Dynamics:
    """The dynamics of one kind of mechanism.

    Parameters
    ----------
    kind : str
        "planar2r", "pendulum" or "dh".
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
    """
    kinds: dict[str, Callable[[Mapping[str, Any]], Dynamics]] = {"planar2r": Planar2R, "pendulum": Pendulum, "dh": DHArm}
    if kind not in kinds:
        raise ReferenceError_(f'machine kind "{kind}" is unknown; expected {", ".join(kinds)}')
    return kinds[kind](parameters)


def predict_motion(dynamics: Dynamics, tau: Array, sample_time: float, q0: Array) -> tuple[Array, Array, Array]:
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
    """
    steps = 4
    h = sample_time / steps
    q, qd = np.array(q0, dtype=np.float64)[None, :], np.zeros((1, len(q0)))
    rows_q, rows_qd, rows_qdd = [], [], []
    for u in tau:
        u = u[None, :]
        rows_q.append(q[0])
        rows_qd.append(qd[0])
        rows_qdd.append(dynamics.forward(q, qd, u)[0])
        for _ in range(steps):
            a1 = dynamics.forward(q, qd, u)
            a2 = dynamics.forward(q + h / 2 * qd, qd + h / 2 * a1, u)
            a3 = dynamics.forward(q + h / 2 * (qd + h / 2 * a1), qd + h / 2 * a2, u)
            a4 = dynamics.forward(q + h * (qd + h / 2 * a2), qd + h * a3, u)
            q = q + h * qd + h * h / 6 * (a1 + a2 + a3)
            qd = qd + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return np.array(rows_q), np.array(rows_qd), np.array(rows_qdd)
