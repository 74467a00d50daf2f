"""Forward and inverse kinematics of the planar two-joint arm, and Cartesian paths turned into joint
motion.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array
from zendsp.reference.machine import Machine

Elbow = Literal["positive", "negative"]  # sign of q2
# |sin q2| below which a Cartesian path is refused: joint speeds grow as its inverse
SINGULAR = 1e-3


def link_lengths(machine: Machine) -> tuple[float, float]:
    """(l1, l2) in m; raises ReferenceError_ for a machine that is not a planar two-joint arm.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> link_lengths(load_machine("imi_planar"))
    (0.36, 0.34)
    """
    if machine.kind != "planar2r":
        raise ReferenceError_(
            f"{machine.name} is no planar two-joint arm: Cartesian motions are planned for planar2r"
            " machines; use a joint-space kind such as point_to_point"
        )
    return float(machine.parameters["l1"]), float(machine.parameters["l2"])


def forward_kinematics(machine: Machine, q: Array) -> Array:
    """Tip position x = l1 cos q1 + l2 cos(q1 + q2), y = l1 sin q1 + l2 sin(q1 + q2).

    Parameters
    ----------
    machine : Machine
        A planar2r machine.
    q : ndarray, shape (..., 2)
        Joint angles, rad.

    Returns
    -------
    ndarray, shape (..., 2)
        x and y, m.

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> forward_kinematics(load_machine("imi_planar"), np.zeros(2)).round(3).tolist()
    [0.7, 0.0]
    """
    l1, l2 = link_lengths(machine)
    a, b = q[..., 0], q[..., 0] + q[..., 1]
    return np.stack([l1 * np.cos(a) + l2 * np.cos(b), l1 * np.sin(a) + l2 * np.sin(b)], axis=-1)


def inverse_kinematics(machine: Machine, xy: Array, elbow: Elbow) -> Array:
    """Joint angles that bring the tip to (x, y), one of the two elbow solutions.

    cos q2 = (x^2 + y^2 - l1^2 - l2^2) / (2 l1 l2), q1 = atan2(y, x) - atan2(l2 sin q2, l1 + l2 cos
    q2).

    Parameters
    ----------
    machine : Machine
        A planar2r machine.
    xy : ndarray, shape (..., 2)
        Tip position, m.
    elbow : {"positive", "negative"}
        Sign of q2.

    Returns
    -------
    ndarray, shape (..., 2)
        q1 in (-pi, pi] at the first row and continuous along the rows, q2; rad.

    Raises
    ------
    ReferenceError_
        A point out of reach (the message names it and the ring that can be reached).

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> arm = load_machine("imi_planar")
    >>> q = inverse_kinematics(arm, np.array([0.4, 0.2]), "positive")
    >>> forward_kinematics(arm, q).round(12).tolist()
    [0.4, 0.2]
    """
    l1, l2 = link_lengths(machine)
    if elbow not in ("positive", "negative"):
        raise ReferenceError_(
            f'elbow is "{elbow}"; expected "positive" or "negative" (the sign of q2)'
        )
    x, y = np.asarray(xy[..., 0]), np.asarray(xy[..., 1])
    cosine = (x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2)
    worst = np.unravel_index(int(np.argmax(np.abs(cosine))), np.shape(cosine))
    if abs(cosine[worst]) > 1.0 + 1e-12:
        raise ReferenceError_(
            f"point ({x[worst]:.4g}, {y[worst]:.4g}) m is {np.hypot(x[worst], y[worst]):.4g} m from"
            f" the base of {machine.name}, which reaches from {abs(l1 - l2):.4g} to {l1 + l2:.4g}"
            " m: move or shrink the path"
        )
    cosine = np.clip(cosine, -1.0, 1.0)
    sine = np.sqrt(1.0 - cosine**2) * (1.0 if elbow == "positive" else -1.0)
    q1 = np.arctan2(y, x) - np.arctan2(l2 * sine, l1 + l2 * cosine)
    q1 = np.arctan2(np.sin(q1), np.cos(q1))
    if np.ndim(q1):
        q1 = np.unwrap(q1)
    return np.stack([q1, np.arctan2(sine, cosine)], axis=-1)


def jacobian(machine: Machine, q: Array) -> Array:
    """d(x, y)/dq, m/rad, shape (N, 2, 2) for q of shape (N, 2).

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> jacobian(load_machine("imi_planar"), np.zeros((1, 2)))[0, 1].round(3).tolist()
    [0.7, 0.34]
    """
    l1, l2 = link_lengths(machine)
    a, b = q[:, 0], q[:, 0] + q[:, 1]
    x2, y2 = l2 * np.cos(b), l2 * np.sin(b)
    top = np.stack([-l1 * np.sin(a) - y2, -y2], axis=1)
    bottom = np.stack([l1 * np.cos(a) + x2, x2], axis=1)
    return np.stack([top, bottom], axis=1)


def cartesian_to_joint(
    machine: Machine, xy: Array, v: Array, a: Array, elbow: Elbow
) -> tuple[Array, Array, Array]:
    """Joint motion of a Cartesian path: qd = J^-1 v, qdd = J^-1 (a - Jd qd).

    Parameters
    ----------
    machine : Machine
        A planar2r machine.
    xy, v, a : ndarray, shape (N, 2)
        Position m, velocity m/s, acceleration m/s^2 of the tip.
    elbow : {"positive", "negative"}
        Sign of q2 along the path.

    Returns
    -------
    q, qd, qdd : ndarray, shape (N, 2)
        rad, rad/s, rad/s^2.

    Raises
    ------
    ReferenceError_
        The path leaves the reach or passes the outstretched or folded arm, where no joint speed
        follows it.

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> at_rest = np.zeros((2, 2))
    >>> q, qd, qdd = cartesian_to_joint(load_machine("imi_planar"), at_rest + 0.3, at_rest, at_rest, "positive")
    >>> float(abs(qd).max())
    0.0
    """  # noqa: E501
    q = inverse_kinematics(machine, xy, elbow)
    flat = int(np.argmin(np.abs(np.sin(q[:, 1]))))
    if abs(np.sin(q[flat, 1])) < SINGULAR:
        raise ReferenceError_(
            f"the path passes ({xy[flat, 0]:.4g}, {xy[flat, 1]:.4g}) m, where the arm of"
            f" {machine.name} is outstretched or folded and joint speeds grow without bound: keep"
            " away from the rim of its reach"
        )
    j = jacobian(machine, q)
    qd: Array = np.asarray(np.linalg.solve(j, v[:, :, None])[:, :, 0], dtype=np.float64)
    # Jd qd in closed form: the centripetal acceleration of the two links
    l1, l2 = link_lengths(machine)
    a1, a2 = q[:, 0], q[:, 0] + q[:, 1]
    w1, w2 = qd[:, 0] ** 2, (qd[:, 0] + qd[:, 1]) ** 2
    centripetal = -np.stack(
        [l1 * np.cos(a1) * w1 + l2 * np.cos(a2) * w2, l1 * np.sin(a1) * w1 + l2 * np.sin(a2) * w2],
        axis=1,
    )
    qdd: Array = np.asarray(
        np.linalg.solve(j, (a - centripetal)[:, :, None])[:, :, 0], dtype=np.float64
    )
    return q, qd, qdd
