"""Each joint as a scalar system: its inertia, and torques computed from the measured motion of all
joints.

For joint i of M(q) q̈ + C q̇ + g = tau the terms in the other joints' accelerations, velocities and
positions are computed from the measured motion; what is left is inertia_i(t) q̈_i + bias_i(t) =
tau_i. Both are linear in the parameters of the mechanism.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.model import TREES, Model
from zendsp.physics.robots.robot import robot_tree
from zendsp.tree import Body, inverse_dynamics, own_inertias, torque_slope
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]


SMALL = 1e-4  # rad or m: a step of a derivative


@dataclass(frozen=True)
class Basis:
    """Coefficients of one mechanism parameter in one joint: inertia and bias along the record, each
    (n,).
    """

    inertia: Array
    bias: Array
    slope: Array | None = None  # of a simulator: of its whole torque, by the joint's own position

    def each(self, change: Callable[[Array], Array]) -> Basis:
        """The coefficients after a change of each series."""
        slope = None if self.slope is None else change(self.slope)
        return Basis(change(self.inertia), change(self.bias), slope)

    @cached_property
    def acts(self) -> tuple[bool, bool]:
        """Whether inertia and bias are anything but 0."""
        return bool(self.inertia.any()), bool(self.bias.any())


def bases(model: Model, motion: list[Array]) -> list[dict[str, Basis]]:
    """For each joint, the coefficient of each mechanism parameter.

    Parameters
    ----------
    motion : list of ndarray, shape (3, n)
        Smoothed q, qd, qdd of each joint.

    Returns
    -------
    list of dict
        Key: parameter name, ``"fixed"`` for what no parameter scales. Gravity of rotary joints is
        not in here: the simulation evaluates it on the predicted position.
    """
    if model.called is not None:
        return list(model.called.bases(motion))
    n = motion[0].shape[1]
    one, zero = np.ones(n), np.zeros(n)
    if model.kind == "rotary":
        return [{"inertia": Basis(one, zero)} for _ in motion]
    if model.kind == "linear":
        return [{"mass": Basis(one, zero)} for _ in motion]
    if model.kind == "planar2r":
        (_, qd1, qdd1), (q2, qd2, qdd2) = motion[0], motion[1]
        c, s = np.cos(q2), np.sin(q2)
        return [
            {
                "p1": Basis(one, zero),
                "p2": Basis(zero, qdd2),
                "p3": Basis(2 * c, c * qdd2 - s * (2 * qd1 * qd2 + qd2**2)),
            },
            {"p2": Basis(one, qdd1), "p3": Basis(zero, c * qdd1 + s * qd1**2)},
        ]
    if model.kind in TREES:
        return [{"fixed": basis} for basis in _tree_bases(model, motion)]
    raise ModelError(f"kind = {model.kind!r} has no rigid-body form")


def recorded_tree(model: Model, joints: int) -> tuple[list[Body], Array]:
    """Links and gravity of a robot whose recording has so many joints.

    Raises
    ------
    ModelError
        It has more, or fewer.
    """
    bodies, gravity = robot_tree(model)
    if len(bodies) != joints:
        raise ModelError(
            f"{model.file}: has {counted(len(bodies), 'joint')}, the recording {joints}:"
            " [mechanism] joints = […] names those that were recorded"
        )
    return bodies, gravity


def links_inertia(model: Model, joint: int) -> float:
    """What a joint of a robot's file turns with all joints at zero, its rotor aside, kg m^2 (kg).
    """
    bodies, _ = robot_tree(model)
    return float(own_inertias(bodies, np.zeros((1, len(bodies))))[0, joint - 1])


def bias_slope(
    model: Model, motion: list[Array], joint: int, values: Mapping[str, float]
) -> Array:
    """Change of a joint's bias with its own position, (n,) N m/rad or N/m.

    Parameters
    ----------
    motion : list of ndarray, shape (3, n)
        Smoothed q, qd, qdd of each joint.
    joint : int
        1-based.
    values : mapping
        Of the mechanism's parameters.
    """
    if model.kind in TREES:  # the inertia that a joint feels of itself is the same at all angles
        bodies, gravity = recorded_tree(model, len(motion))
        return torque_slope(bodies, gravity, *_side_by_side(motion), joint - 1)
    slope = np.zeros(motion[0].shape[1])
    for off in (-SMALL, SMALL):
        moved = [m.copy() for m in motion]
        moved[joint - 1][0] += off
        for key, basis in bases(model, moved)[joint - 1].items():
            slope += 0.5 * values[key] / off * basis.bias
    return slope


def _side_by_side(motion: list[Array]) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration of all joints, (n, joints) each."""
    q, qd, qdd = (np.ascontiguousarray(np.stack([m[i] for m in motion], axis=1)) for i in range(3))
    return q, qd, qdd


def tree_torques(model: Model, motion: list[Array]) -> Array:
    """Torque of each joint of a robot's links along a motion, (joints, n), gravity included."""
    bodies, gravity = recorded_tree(model, len(motion))
    return inverse_dynamics(bodies, gravity, *_side_by_side(motion)).T


def _tree_bases(model: Model, motion: list[Array]) -> list[Basis]:
    bodies, _ = recorded_tree(model, len(motion))
    inertias = own_inertias(bodies, _side_by_side(motion)[0]).T
    return [
        Basis(np.ascontiguousarray(inertia), torque - inertia * qdd)
        for inertia, torque, (_, _, qdd) in zip(
            inertias, tree_torques(model, motion), motion, strict=True
        )
    ]
