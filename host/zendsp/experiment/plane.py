"""Two joints that turn in one plane: their kinematics from a model, and a circle within their
ranges.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zendsp.errors import ModelError, ReferenceError_, Refused
from zendsp.experiment.joints import USED, Array, Axis, Known
from zendsp.physics.model import TREES, Model
from zendsp.physics.robots.robot import robot_tree
from zendsp.reference import Limits, Machine, Reference, make_circle
from zendsp.reference.kinematics import Elbow
from zendsp.tree import Body

PARALLEL = 1e-6  # sine of the angle between two axes that count as parallel
SHORTEST = 1e-3  # m, of a link
SIZE, THIN = 0.214, 0.4  # of both links together, and of the shorter one: the radius, at most
MARGIN = 0.05  # of a range, that a circle keeps from its ends
FAST = 0.5  # of the largest speed, that a circle may need
ELBOWS: tuple[Elbow, Elbow] = ("positive", "negative")
SMALLEST = 0.02  # of both links together: the least radius that is tried


@dataclass(frozen=True)
class Plane:
    """Two neighbouring joints with parallel axes.

    Attributes
    ----------
    joints : tuple of int
        1-based.
    lengths : tuple of float
        Of both links, m.
    sense, offset : float
        The second joint's position is sense · (angle between the links - offset).
    tip : str
        What the second link's length is, in words.
    """

    joints: tuple[int, int]
    lengths: tuple[float, float]
    sense: float = 1.0
    offset: float = 0.0
    tip: str = ""


class Place(NamedTuple):
    """Radius and centre of a circle, m, from the first axis, the first link at zero along x; and
    how the elbow bends.
    """

    radius: float
    x: float
    y: float
    elbow: Elbow


def plane_of(model: Model, name: str) -> Plane:
    """The two joints of a model that move in a plane.

    Raises
    ------
    ModelError
        It has none, or does not say how long the links are.
    """
    if model.kind == "planar2r":
        if not {"l1", "l2"} <= set(model.mechanism):
            raise ModelError(f"{name}: [mechanism.parameters] lacks l1 and l2, the links' lengths")
        l1, l2 = (model.mechanism[key][0].value for key in ("l1", "l2"))
        return Plane((1, 2), (l1, l2))
    if model.kind not in TREES:
        raise ModelError(
            f"{name}: kind = {model.kind!r} has no links; a circle needs planar2r, or a urdf or"
            " mjcf with two neighbouring joints whose axes are parallel"
        )
    bodies, _ = robot_tree(model)
    for k, body in enumerate(bodies):
        if body.parent >= 0 and (found := _pair(bodies, body.parent, k)) is not None:
            return found
    raise ModelError(
        f"{name}: no two neighbouring joints turn about parallel axes: a circle needs such a pair"
    )


def _pair(bodies: Sequence[Body], first: int, second: int) -> Plane | None:
    a, b = bodies[first], bodies[second]
    axis, other = a.axis, b.rotation @ b.axis
    if a.slides or b.slides or np.linalg.norm(np.cross(axis, other)) > PARALLEL:
        return None
    link = b.place - axis * (axis @ b.place)
    child = next((c for c in bodies if c.parent == second), None)
    at = b.rotation @ (child.place if child is not None else 2.0 * b.com)
    reach = at - axis * (axis @ at)
    words = "at the next joint" if child is not None else "twice as far as its centre of mass"
    if child is not None and np.linalg.norm(reach) < SHORTEST:
        at = b.rotation @ (2.0 * b.com)
        reach, words = at - axis * (axis @ at), "twice as far as its centre of mass"
    l1, l2 = float(np.linalg.norm(link)), float(np.linalg.norm(reach))
    if min(l1, l2) < SHORTEST:
        return None
    e1 = link / l1
    offset = float(np.arctan2(reach @ np.cross(axis, e1), reach @ e1))
    sense = float(np.sign(axis @ other))
    return Plane((first + 1, second + 1), (l1, l2), sense, offset, words)


def circle_machine(plane: Plane, period: float) -> Machine:
    """The two joints as a machine that a circle can be planned for; without limits."""
    none = np.full(2, np.inf)
    l1, l2 = plane.lengths
    return Machine(
        "", "two joints of a machine", "planar2r", 2, period, np.zeros(2),
        Limits(-none, none, none, none, none), {"l1": l1, "l2": l2},
    )  # fmt: skip


def fitting_circle(plane: Plane, known: Known, period: float) -> Place:
    """The largest circle within the joints' ranges, the nearest to where they stand.

    Raises
    ------
    Refused
        There is none.
    """
    l1, l2 = plane.lengths
    radius = min(SIZE * (l1 + l2), THIN * min(l1, l2))
    middle = float(np.hypot(l1, l2))
    axes = [known.axes[j] for j in plane.joints]
    while radius > SMALLEST * (l1 + l2):
        best: tuple[float, Place] | None = None
        for angle, elbow in itertools.product(
            np.linspace(-np.pi, np.pi, 24, endpoint=False), ELBOWS
        ):
            x, y = middle * float(np.cos(angle)), middle * float(np.sin(angle))
            place = Place(radius, x, y, elbow)
            q = _positions(plane, place, 4.5, period)
            if q is None or not _within(q, axes):
                continue
            way = float(np.abs(q[0] - known.pose[[j - 1 for j in plane.joints]]).max())
            if best is None or way < best[0]:
                best = way, place
        if best is not None:
            return best[1]
        radius *= 0.8
    raise Refused(
        f"circle: no circle of {SMALLEST * (l1 + l2):.2g} m or more lies within the ranges of"
        f" joints {plane.joints[0]} and {plane.joints[1]}"
    )


def _within(q: Array, axes: Sequence[Axis]) -> bool:
    for column, axis in zip(q.T, axes, strict=True):
        room = MARGIN * (axis.high - axis.low)
        if column.min() < axis.low + room or column.max() > axis.high - room:
            return False
    return True


def _positions(
    plane: Plane, place: Place, duration: float, period: float
) -> Array | None:
    """Positions of both joints on a circle; None where the links do not reach."""
    machine = circle_machine(plane, max(period, duration / 500.0))
    try:
        found = make_circle(
            machine, radius=place.radius, x=place.x, y=place.y, duration=duration, elbow=place.elbow
        )
    except ReferenceError_:
        return None
    second = plane.sense * (found.q[:, 1] - plane.offset)
    second -= 2.0 * np.pi * np.round(second.mean() / (2.0 * np.pi))
    return np.stack([found.q[:, 0], second], axis=1)


def circle_of(
    plane: Plane, known: Known, place: Place, timing: tuple[float, float]
) -> Reference:
    """The circle as a motion of all joints; ``timing``: its duration and the period, s."""
    duration, period = timing
    found = make_circle(
        circle_machine(plane, period), radius=place.radius, x=place.x, y=place.y,
        duration=duration, elbow=place.elbow,
    )  # fmt: skip
    j, k = (joint - 1 for joint in plane.joints)
    q = np.tile(known.pose, (found.samples, 1))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    second = plane.sense * (found.q[:, 1] - plane.offset)
    turns = 2.0 * np.pi * np.round(second.mean() / (2.0 * np.pi))
    q[:, j], qd[:, j], qdd[:, j] = found.q[:, 0], found.qd[:, 0], found.qdd[:, 0]
    q[:, k] = second - turns
    qd[:, k], qdd[:, k] = plane.sense * found.qd[:, 1], plane.sense * found.qdd[:, 1]
    return Reference(q, period, qd, qdd, kind="circle", parameters=place._asdict(), machine="")


def slow_enough(reference: Reference, known: Known) -> bool:
    """Whether no joint needs more than half of its speed, or most of its torque, friction aside."""
    if known.rigid is None:
        return True
    torque = known.rigid(reference.q, reference.qd, reference.qdd)
    return all(
        float(np.abs(reference.qd[:, j - 1]).max()) < FAST * axis.speed
        and float(np.abs(torque[:, j - 1]).max()) + 2.0 * axis.level < USED * axis.torque
        for j, axis in known.axes.items()
    )
