"""A URDF read: the rigid bodies of a robot's links, and which joints move them."""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zendsp.errors import ModelError
from zendsp.tree import GRAVITY, Array, Body, axis_turn, joined

# of the sum of a link's moments of inertia: files round them to some digits
ROUNDED = 0.01


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


def urdf_friction(path: str) -> dict[str, tuple[float, float]]:
    """``damping`` (N m s/rad or N s/m) and ``friction`` (N m or N) that a URDF states, by joint:
    those that are numbers above 0, 0 in place of the others.
    """
    urdf_joints(path)  # refuses what is no URDF
    stated = {}
    for joint in ET.parse(Path(path)).getroot().findall("joint"):
        words = found.attrib if (found := joint.find("dynamics")) is not None else {}
        damping, friction = (_above_zero(words.get(key, "")) for key in ("damping", "friction"))
        if damping or friction:
            stated[joint.get("name", "")] = damping, friction
    return stated


def _above_zero(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0.0 < value < math.inf else 0.0


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
        said = f"{len(roots)} of its links hang on no joint ({', '.join(roots[:3])})"
        if not roots:
            said = "its links hang on one another in a loop" if links else "has no <link>"
        raise ModelError(f"{path}: {said}: one has to be the base")
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


def _inertial(link: ET.Element, rotation: Array, place: Array) -> tuple[float, Array, Array]:
    found = link.find("inertial")
    if found is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    try:
        turn, at = _origin(found)
        mass, own = _mass(found)
    except (ValueError, KeyError) as error:
        raise ValueError(f"link {link.attrib['name']!r}: <inertial> {error}") from error
    turn = rotation @ turn
    return mass, place + rotation @ at, turn @ own @ turn.T


def _mass(found: ET.Element) -> tuple[float, Array]:
    """Mass, kg, and inertia, (3, 3) kg m², of an <inertial>."""
    inertia, weighs = found.find("inertia"), found.find("mass")
    if inertia is None or weighs is None:
        raise ValueError("is without <mass> or <inertia>")
    i = {key: float(value) for key, value in inertia.attrib.items()}
    xy, xz, yz = (i.get(key, 0.0) for key in ("ixy", "ixz", "iyz"))
    own = np.array([[i["ixx"], xy, xz], [xy, i["iyy"], yz], [xz, yz, i["izz"]]])
    mass = float(weighs.attrib["value"])
    if not (0.0 <= mass < np.inf and np.isfinite(own).all() and (np.diag(own) >= 0.0).all()):
        raise ValueError(
            f"of {mass:g} kg and {list(i.values())} kg m^2: give finite numbers, and mass, ixx,"
            " iyy and izz of 0 or more"
        )
    least = float(np.linalg.eigvalsh(own)[0])
    if least < -ROUNDED * float(np.trace(own)):
        raise ValueError(
            f"{list(i.values())} kg m^2 has a principal moment of {least:.3g} kg m^2: ixy, ixz and"
            " iyz are too large for ixx, iyy and izz, or of another sign or unit"
        )
    return mass, own


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
