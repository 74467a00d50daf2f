"""Rigid bodies in a tree of joints: read from a URDF, and the torque of a motion (Newton-Euler)."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError

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


def read_urdf(path: str, moving: Sequence[str] = ()) -> tuple[list[Body], Array]:
    """Moving links of a URDF and gravity; a parent before its children, siblings by joint name.

    Links on fixed joints become part of the link that carries them; so do those on joints that are
    not among the names ``moving``, held at 0 (empty: all joints move).

    Raises
    ------
    ModelError
        Not a URDF, or a moving joint that neither turns nor slides, or follows another one.
    """
    bodies, order = _opened(path, tuple(moving))
    if moving and list(moving) != order:
        unknown = [name for name in moving if name not in order]
        raise ModelError(
            f"{path}: [mechanism] joints = {list(moving)}: "
            + (
                f"no joint that moves is called {unknown[0]!r}; it has"
                f" {', '.join(urdf_joints(path))}"
                if unknown
                else f"expected each once, in the order of the chain: {order}"
            )
        )
    if not bodies:
        raise ModelError(f"{path}: has no joint that moves")
    return bodies, np.array(GRAVITY)


def urdf_joints(path: str) -> list[str]:
    """Names of the joints of a URDF that a recording may be of, a parent before its children: not
    those that follow another (``<mimic>``), nor those that are followed.
    """
    return _opened(path, None)[1]


def urdf_coupled(path: str) -> list[str]:
    """Names of the joints of a URDF that follow another (``<mimic>``) or are followed."""
    urdf_joints(path)  # refuses what is no URDF
    return sorted(_coupled(ET.parse(Path(path)).getroot().findall("joint")))


def _opened(path: str, moving: tuple[str, ...] | None) -> tuple[list[Body], list[str]]:
    """The moving links of a URDF, and the names of their joints. ``moving``: as of ``read_urdf``;
    None: all that move by themselves.
    """
    try:
        robot = ET.parse(Path(path)).getroot()
        every = robot.findall("joint")
        if moving is None:
            return _read(robot, path, tuple(_movable(every)))
        _refuse_followers(every, path, moving)
        return _read(robot, path, moving)
    except RecursionError:
        raise ModelError(
            f"{path}: its links hang on one another in a chain that is too long to be read: some"
            " hundreds are the limit. Make fixed joints of those that do not move, or cut it"
        ) from None
    except ModelError:
        raise
    except (ET.ParseError, OSError, ValueError, KeyError, AttributeError) as error:
        raise ModelError(f"{path}: is not a URDF that can be read: {error}") from error


def _read(
    robot: ET.Element, path: str, moving: tuple[str, ...]
) -> tuple[list[Body], list[str]]:
    if robot.tag != "robot":
        kind = '; a MuJoCo model is kind = "mjcf"' if robot.tag == "mujoco" else ""
        raise ModelError(f"{path}: is not a URDF: its root is <{robot.tag}>, not <robot>{kind}")
    if any("xacro" in part.tag or "${" in "".join(part.attrib.values()) for part in robot.iter()):
        raise ModelError(f"{path}: xacro has to make a URDF of it first: xacro {path} > arm.urdf")
    found = robot.findall("link")
    links = {str(link.attrib["name"]): link for link in found}
    if len(links) < len(found):
        raise ModelError(f"{path}: two of its {len(found)} links have the same name")
    joints = sorted(robot.findall("joint"), key=lambda joint: joint.attrib["name"])
    for one, other in itertools.pairwise(joint.attrib["name"] for joint in joints):
        if one == other:
            raise ModelError(f"{path}: two of its joints are called {one!r}")
    children: dict[str, list[ET.Element]] = {name: [] for name in links}
    carried = set()
    for joint in joints:
        parent, child = (joint.find(tag).attrib["link"] for tag in ("parent", "child"))  # type: ignore[union-attr]
        if parent not in links or child not in links or child in carried:
            raise ModelError(
                f"{path}: joint {joint.attrib['name']!r} joins {parent!r} and {child!r}: each must"
                " be a link of the file, and no link may hang on two joints"
            )
        children[parent].append(joint)
        carried.add(child)
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        raise ModelError(f"{path}: has {len(roots)} links without a parent; expected one")
    bodies: list[Body] = []
    order: list[str] = []
    loose = set(links)  # not yet found from the base outwards

    def visit(name: str, index: int, rotation: Array, place: Array) -> None:
        loose.discard(name)
        if index >= 0:
            bodies[index] = joined(bodies[index], *_inertial(links[name], rotation, place))
        for joint in children[name]:
            kind, child = joint.attrib["type"], joint.find("child").attrib["link"]  # type: ignore[union-attr]
            turn, at = _origin(joint)
            turn, at = rotation @ turn, place + rotation @ at
            name = joint.attrib["name"]
            if kind == "fixed" or (moving and name not in moving):
                visit(child, index, turn, at)
                continue
            axis, slides = _axis(joint, path), kind == "prismatic"
            none, flat = np.zeros(3), np.zeros((3, 3))
            order.append(name)
            bodies.append(Body(index, slides, axis, turn, at, 0.0, none, flat, child))
            visit(child, len(bodies) - 1, np.eye(3), np.zeros(3))

    visit(roots[0], -1, np.eye(3), np.zeros(3))
    if loose:
        names = ", ".join(sorted(loose)[:3])
        raise ModelError(f"{path}: links hang on one another in a loop, among them {names}")
    return bodies, order


def _movable(joints: Sequence[ET.Element]) -> list[str]:
    """Names of the joints that move by themselves, and that no other follows."""
    coupled = _coupled(joints)
    names = (j.attrib["name"] for j in joints if j.attrib["type"] != "fixed")
    return [name for name in names if name not in coupled]


def _coupled(joints: Sequence[ET.Element]) -> set[str]:
    """Names of the joints that follow another, and of those that are followed."""
    found = [(j, j.find("mimic")) for j in joints if j.attrib["type"] != "fixed"]
    pairs = ((j.attrib["name"], m.attrib.get("joint", "")) for j, m in found if m is not None)
    return {name for pair in pairs for name in pair}


def _refuse_followers(joints: Sequence[ET.Element], path: str, moving: tuple[str, ...]) -> None:
    """A joint that mimics one that moves."""
    for joint in joints:
        mimic, name = joint.find("mimic"), joint.attrib["name"]
        if mimic is None or joint.attrib["type"] == "fixed":
            continue
        leader = mimic.attrib.get("joint", "")
        if not moving or name in moving or leader in moving:
            kept = [n for n in moving or _movable(joints) if n not in (name, leader)]
            raise ModelError(
                f"{path}: joint {name!r} follows {leader!r} (<mimic>), which a tree of independent"
                f" joints cannot: name those that the recording has, [mechanism] joints = {kept};"
                " all others are held at 0"
            )


def _axis(joint: ET.Element, path: str) -> Array:
    """Unit vector of a joint that moves, (3,)."""
    name, kind = joint.attrib["name"], joint.attrib["type"]
    if kind not in ("revolute", "continuous", "prismatic"):
        raise ModelError(
            f"{path}: joint {name!r} is {kind}: only revolute, continuous and prismatic ones can be"
            " taken over; name those that the recording has, [mechanism] joints = [\"…\"], the"
            " others are held at 0"
        )
    found = joint.find("axis")
    axis = _numbers("1 0 0" if found is None else found.attrib["xyz"])
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise ModelError(f"{path}: joint {name!r} has an axis of no length")
    return np.asarray(axis / length)


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


def _inertial(link: ET.Element, rotation: Array, place: Array) -> tuple[float, Array, Array]:
    found = link.find("inertial")
    if found is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    turn, at = _origin(found)
    turn = rotation @ turn
    inertia, weighs = found.find("inertia"), found.find("mass")
    if inertia is None or weighs is None:
        raise ValueError(f"link {link.attrib['name']!r} has <inertial> without <mass> or <inertia>")
    i = {key: float(value) for key, value in inertia.attrib.items()}
    xy, xz, yz = (i.get(key, 0.0) for key in ("ixy", "ixz", "iyz"))
    own = np.array([[i["ixx"], xy, xz], [xy, i["iyy"], yz], [xz, yz, i["izz"]]])
    mass = float(weighs.attrib["value"])
    if not (0.0 <= mass < np.inf and np.isfinite(own).all()):
        raise ValueError(
            f"link {link.attrib['name']!r}: mass {mass:g} kg, inertia {list(i.values())} kg m^2:"
            " give finite numbers, and a mass of 0 or more"
        )
    return mass, place + rotation @ at, turn @ own @ turn.T


def _origin(element: ET.Element) -> tuple[Array, Array]:
    found = element.find("origin")
    words = {} if found is None else found.attrib
    r, p, y = _numbers(words.get("rpy", "0 0 0"))
    turn = np.eye(3)
    for axis, angle in (((0, 0, 1), y), ((0, 1, 0), p), ((1, 0, 0), r)):
        turn = axis_turn(np.array(axis, dtype=np.float64), np.array([angle]), turn)[..., 0]
    return turn, _numbers(words.get("xyz", "0 0 0"))


def _numbers(text: str) -> Array:
    values = np.array([float(word) for word in text.split()])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not three numbers")
    return values


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
