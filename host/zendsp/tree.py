"""Rigid bodies in a tree of joints, and the torque of a motion (Newton-Euler)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
GRAVITY = (0.0, 0.0, -9.81)  # m/s^2
_ONE = np.eye(3)


@dataclass(frozen=True)
class Body:
    """A moving link with the joint that carries it; vectors in the joint's own frame."""

    parent: int  # -1: the base
    slides: bool
    axis: Array
    rotation: Array  # of the joint's frame at q = 0, in the parent's frame
    place: Array  # m
    mass: float  # kg
    com: Array  # m
    inertia: Array  # kg m^2, about the centre of mass
    name: str = ""  # of the link
    # what a gravity compensation carries of it: mass, kg, and where, m; one row a part
    lifted: tuple[tuple[float, Array], ...] = ()


@dataclass(frozen=True)
class LinkMotion:
    """How each link moves, in its own frame; every list has one entry a link, vectors are (3, n).
    """

    turn: list[Array]  # of the link in its parent's frame, (3, 3, n)
    place: list[Array]  # of its origin in its parent's frame, m
    spin: list[Array]  # rad/s
    spin_rate: list[Array]  # rad/s^2
    push: list[Array]  # acceleration of its origin less gravity, m/s^2


def link_motion(
    bodies: Sequence[Body], gravity: Array, q: Array, qd: Array, qdd: Array
) -> LinkMotion:
    """Motion of every link for a motion of the joints (n, joints); gravity in the base's frame,
    m/s^2.
    """
    m = LinkMotion([], [], [], [], [])
    zero = np.zeros((3, len(q)))
    for k, b in enumerate(bodies):
        turn, place = _carried_by(b, q[:, k])
        root = b.parent < 0
        w, wd = (zero, zero) if root else (m.spin[b.parent], m.spin_rate[b.parent])
        a = (zero - gravity[:, None]) if root else m.push[b.parent]
        a = a + cross(wd, place) + cross(w, cross(w, place))
        w, wd, a = (into(turn, v) for v in (w, wd, a))
        speed, rate = b.axis[:, None] * qd[:, k], b.axis[:, None] * qdd[:, k]
        if b.slides:
            a = a + rate + 2 * cross(w, speed)
        else:
            wd = wd + rate + cross(w, speed)
            w = w + speed
        m.turn.append(turn)
        m.place.append(place)
        m.spin.append(w)
        m.spin_rate.append(wd)
        m.push.append(a)
    return m


def _carried_by(b: Body, q: Array) -> tuple[Array, Array]:
    """Turn and place of a link in its parent's frame along a joint's motion (n,): (3, 3, n) and
    (3, n).
    """
    if b.slides:
        turn = np.broadcast_to(b.rotation[..., None], (3, 3, len(q)))
        return turn, b.place[:, None] + (b.rotation @ b.axis)[:, None] * q
    return axis_turn(b.axis, q, b.rotation), np.broadcast_to(b.place[:, None], (3, len(q)))


def own_inertias(bodies: Sequence[Body], q: Array) -> Array:
    """Inertia that each joint feels of itself along a motion, kg m² or kg, (n, joints): of all that
    it carries, put together from the last link on (Walker and Orin 1982).
    """
    out, still = np.empty_like(q), np.ones(len(q))
    mass = [b.mass for b in bodies]
    # moments, about the link's own origin
    first: list[Array] = [np.multiply.outer(b.mass * b.com, still) for b in bodies]
    second: list[Array] = [
        np.multiply.outer(about(b.mass, b.com, b.inertia), still) for b in bodies
    ]
    for k in reversed(range(len(bodies))):
        b = bodies[k]
        out[:, k] = mass[k] if b.slides else np.einsum("i,ijn,j->n", b.axis, second[k], b.axis)
        if b.parent < 0:
            continue
        turn, place = _carried_by(b, q[:, k])
        moment = _out_of(turn, first[k])
        # about the parent's origin: the parallel axes of a body whose moment is not zero
        twice = place[:, None] * (moment + 0.5 * mass[k] * place)
        twice = twice + np.swapaxes(twice, 0, 1)
        size = 0.5 * np.trace(twice)
        half = np.einsum("ijn,jkn->ikn", turn, second[k])
        moved = np.einsum("ijn,kjn->ikn", half, turn) + 2.0 * size * _ONE[..., None] - twice
        mass[b.parent] += mass[k]
        first[b.parent] = first[b.parent] + moment + mass[k] * place
        second[b.parent] = second[b.parent] + moved
    return out


def inverse_dynamics(
    bodies: Sequence[Body], gravity: Array, q: Array, qd: Array, qdd: Array
) -> Array:
    """Torque of each joint, N m or N, by recursive Newton-Euler; all of shape (n, joints)."""
    n, joints = q.shape
    m = link_motion(bodies, gravity, q, qd, qdd)
    F: list[Array] = []
    N: list[Array] = []
    for b, w, wd, a in zip(bodies, m.spin, m.spin_rate, m.push, strict=True):
        force = b.mass * (a + cross(wd, b.com) + cross(w, cross(w, b.com)))
        F.append(force)
        N.append(b.inertia @ wd + cross(w, b.inertia @ w) + cross(b.com, force))
    torque = np.empty((joints, n))
    for k in reversed(range(joints)):
        b = bodies[k]
        torque[k] = b.axis @ (F[k] if b.slides else N[k])
        if b.parent >= 0:
            turn, place = m.turn[k], m.place[k]
            force = _out_of(turn, F[k])
            F[b.parent] = F[b.parent] + force
            N[b.parent] = N[b.parent] + _out_of(turn, N[k]) + cross(place, force)
    if any(b.lifted for b in bodies):  # what carries a part of the weight acts as that part would
        still = np.zeros_like(q)
        torque -= inverse_dynamics([_carried(b) for b in bodies], gravity, q, still, still).T
    return torque.T


def torque_slope(
    bodies: Sequence[Body], gravity: Array, q: Array, qd: Array, qdd: Array, joint: int
) -> Array:
    """Change of a joint's torque with its own position along a motion (n, joints), (n,) N m/rad or
    N/m: the derivative of ``inverse_dynamics``. ``joint`` counts from 0.

    Only the links that the joint carries feel it, as if all before it turned the other way.
    """
    m = link_motion(bodies, gravity, q, qd, qdd)
    axis = bodies[joint].axis
    changes: dict[int, tuple[Array, Array, Array]] = {}  # of spin, its rate and push
    for k in range(joint, len(bodies)):
        b = bodies[k]
        if k == joint:
            changes[k] = _slope_at(b, qd[:, k], m, k)
        elif b.parent in changes:
            changes[k] = _slope_beyond(b, qd[:, k], changes[b.parent], m, k)
    forces: dict[int, Array] = {}
    moments: dict[int, Array] = {}
    for k, (dw, dwd, da) in changes.items():
        b, w = bodies[k], m.spin[k]
        whirl = cross(dw, cross(w, b.com)) + cross(w, cross(dw, b.com))
        forces[k] = b.mass * (da + cross(dwd, b.com) + whirl)
        gyro = cross(dw, b.inertia @ w) + cross(w, b.inertia @ dw)
        moments[k] = b.inertia @ dwd + gyro + cross(b.com, forces[k])
    for k in reversed(list(changes)[1:]):
        up, turn = bodies[k].parent, m.turn[k]
        force = _out_of(turn, forces[k])
        forces[up] = forces[up] + force
        moments[up] = moments[up] + _out_of(turn, moments[k]) + cross(m.place[k], force)
    slope: Array = axis @ (forces if bodies[joint].slides else moments)[joint]
    if any(b.lifted for b in bodies):
        still = np.zeros_like(q)
        slope -= torque_slope([_carried(b) for b in bodies], gravity, q, still, still, joint)
    return slope


def _slope_at(b: Body, qd: Array, m: LinkMotion, k: int) -> tuple[Array, Array, Array]:
    """How the motion of a link changes with the position of its own joint: spin, rate, push."""
    if b.slides:
        w, wd = m.spin[k], m.spin_rate[k]
        none = np.zeros_like(w)
        return none, none, cross(wd, b.axis) + cross(w, cross(w, b.axis))
    dw = cross(m.spin[k], b.axis)
    way = b.axis[:, None] * qd
    before = m.spin_rate[k] - cross(m.spin[k], way)  # but for what is along the axis
    return dw, cross(before, b.axis) + cross(dw, way), cross(m.push[k], b.axis)


def _slope_beyond(
    b: Body, qd: Array, change: tuple[Array, Array, Array], m: LinkMotion, k: int
) -> tuple[Array, Array, Array]:
    """How the motion of a link changes with that of its parent: spin, rate, push."""
    dw, dwd, da = change
    w, place, turn = m.spin[b.parent], m.place[k], m.turn[k]
    da = da + cross(dwd, place) + cross(dw, cross(w, place)) + cross(w, cross(dw, place))
    dw, dwd, da = (into(turn, v) for v in (dw, dwd, da))
    way = b.axis[:, None] * qd
    return (dw, dwd, da + 2.0 * cross(dw, way)) if b.slides else (dw, dwd + cross(dw, way), da)


def into(turn: Array, v: Array) -> Array:
    """Vectors (3, n) in the frame that ``turn`` (3, 3, n) places in theirs."""
    return np.asarray(np.einsum("jin,jn->in", turn, v))


def _out_of(turn: Array, v: Array) -> Array:
    """The opposite of ``into``."""
    return np.asarray(np.einsum("ijn,jn->in", turn, v))


def _carried(b: Body) -> Body:
    """The part of a link whose weight is compensated, as a point mass."""
    bare = replace(b, mass=0.0, com=np.zeros(3), inertia=np.zeros((3, 3)), lifted=())
    for mass, place in b.lifted:
        bare = joined(bare, mass, place, np.zeros((3, 3)))
    return bare


def mass_matrices(bodies: Sequence[Body], q: Array) -> Array:
    """Inertia that each joint feels of each, kg m² or kg, (n, joints, joints) along (n, joints)."""
    still, unit = np.zeros_like(q), np.eye(q.shape[1])
    columns = [inverse_dynamics(bodies, np.zeros(3), q, still, still + e) for e in unit]
    return np.stack(columns, axis=2)


def forward_dynamics(
    bodies: Sequence[Body], gravity: Array, q: Array, qd: Array, tau: Array
) -> Array:
    """Acceleration of each joint in one state; all of shape (joints,)."""
    joints = len(bodies)
    at, speed = np.tile(q, (joints + 1, 1)), np.tile(qd, (joints + 1, 1))
    unit = np.vstack([np.zeros(joints), np.eye(joints)])
    rows = inverse_dynamics(bodies, gravity, at, speed, unit)
    return np.asarray(np.linalg.solve((rows[1:] - rows[0]).T, tau - rows[0]))


def joined(b: Body, mass: float, com: Array, inertia: Array) -> Body:
    """A link with another body fixed to it; its inertia is about its own centre of mass."""
    total = b.mass + mass
    if total <= 0.0:
        return b
    centre = (b.mass * b.com + mass * com) / total
    both = about(b.mass, b.com - centre, b.inertia) + about(mass, com - centre, inertia)
    return replace(b, mass=total, com=centre, inertia=both)


def about(mass: float, d: Array, inertia: Array) -> Array:
    """Inertia about a point that is ``d`` away from the centre of mass; ``inertia`` is about that
    centre.
    """
    return np.asarray(inertia + mass * (float(d @ d) * _ONE - d[:, None] * d))


def axis_turn(axis: Array, angle: Array, before: Array) -> Array:
    """Rotation matrices about a unit axis for angles (n,), in the frame that ``before`` (3, 3)
    places: (3, 3, n).
    """
    x, y, z = axis
    turned = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    parts = np.stack([before, before @ turned, before @ turned @ turned], axis=2)
    along = np.stack([np.ones_like(angle), np.sin(angle), 1.0 - np.cos(angle)])
    return np.asarray(parts @ along)


def cross(a: Array, b: Array) -> Array:
    """As ``np.cross`` of vectors (3, n); one of them may be (3,)."""
    x, y, z = a
    u, v, w = b
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
