"""The mechanism of a draft whose bodies stand in a URDF or an MJCF: which of its joints the columns
of a recording are.
"""

from __future__ import annotations

import json
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zendsp.errors import ModelError
from zendsp.physics.files.draft_data import Group, best_group, is_behind, one_or_each
from zendsp.physics.files.draft_tables import Page, put_effects
from zendsp.physics.robots.urdf import urdf_coupled, urdf_friction, urdf_joints
from zendsp.recording.roles import Role
from zendsp_protocol.texts import counted, units_of

KINDS = {".urdf": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}


def joints_in(robot: Path) -> list[str]:
    """Names of the joints of a URDF or an MJCF that turn or slide, in the file's order. Of a URDF
    those that follow another, and those that are followed, are not among them.

    Raises
    ------
    ModelError
        Neither of both, or a file that cannot be taken over.
    """
    kind = KINDS.get(robot.suffix.lower())
    if kind is None:
        raise ModelError(f"{robot}: expected a URDF or an MJCF: {', '.join(KINDS)}")
    if kind == "urdf":
        return urdf_joints(str(robot))
    from zendsp.physics.robots.mjcf import compiled, library

    model, joint = compiled(str(robot)), library().mjtJoint
    single = (int(joint.mjJNT_HINGE), int(joint.mjJNT_SLIDE))
    every = (model.joint(k) for k in range(model.njnt) if int(model.jnt_type[k]) in single)
    return [str(one.name) for one in every]


def _motors(robot: Path) -> tuple[list[bool], list[bool]]:
    """Of each joint of a robot, whether it slides, and whether it has an actuator of its own; no
    URDF says the latter of any.
    """
    joints = joints_in(robot)
    if KINDS[robot.suffix.lower()] == "urdf":
        kinds = {j.get("name"): j.get("type") for j in ET.parse(robot).getroot().iter("joint")}
        return [kinds[joint] == "prismatic" for joint in joints], [False] * len(joints)
    from zendsp.physics.robots.mjcf import actuators_of, compiled, library

    model, slide = compiled(str(robot)), int(library().mjtJoint.mjJNT_SLIDE)
    at = [int(model.joint(joint).id) for joint in joints]
    return [int(model.jnt_type[k]) == slide for k in at], [bool(actuators_of(model, k)) for k in at]


def all_positions(groups: dict[Role, list[Group]], robot: Path) -> Group | None:
    """The positions of all joints of a robot in its order, where their columns have nothing in
    common, as ``x`` and ``phi`` of a cart and its pole; None where there are not as many.
    """
    joints, (slides, _) = joints_in(robot), _motors(robot)
    some = [g for g in groups.get(Role.POSITION, []) if not is_behind(g)]
    columns = [(name, g.values[:, k], units_of(g.unit, len(g.names))[k])
               for g in some if len(g.names) == g.values.shape[1]
               for k, name in enumerate(g.names)]  # fmt: skip
    if len(some) < 2 or len(columns) != len(joints):
        return None
    left, ordered = list(columns), []
    for wanted in ("m" if one else "rad" for one in slides):
        ordered += [next((c for c in left if c[2] in (wanted, "")), left[0])]
        left = [c for c in left if c is not ordered[-1]]
    names, values, units = zip(*ordered, strict=True)
    return Group(names, np.column_stack(values), one_or_each(units))


def all_commands(groups: dict[Role, list[Group]], robot: Path) -> Group | None:
    """The commands of a robot that has joints without any, which have an empty name and zeros; None
    where nothing tells which joints the columns drive.
    """
    joints, (slides, motors) = joints_in(robot), _motors(robot)
    group = best_group(groups, Role.COMMAND) or best_group(groups, Role.CURRENT)
    if group is None or not len(group.names) == group.values.shape[1] < len(joints):
        return None
    group, named = by_joints(group, joints)
    force = [slide == (group.unit == "N") for slide in slides if group.is_torque]
    for driven in ([j in named for j in joints], motors, force):
        if sum(driven) == len(group.names):
            break
    else:
        return None
    names, units, rows = [], [], np.zeros((len(group.values), len(joints)))
    columns = iter(enumerate(group.names))
    own = units_of(group.unit, len(group.names))
    for j, drives in enumerate(driven):
        if drives:
            k, name = next(columns)
            rows[:, j] = group.values[:, k]
        names.append(name if drives else "")
        free = ("N" if slides[j] else "N m") if group.is_torque else own[0]
        units.append(own[k] if drives else free)
    return Group(tuple(names), rows, one_or_each(units))


def of_arm(groups: dict[Role, list[Group]], robot: Path) -> dict[Role, list[Group]]:
    """The columns by their role, less those of joints that a model of the robot can only hold: a
    driver publishes both fingers of a gripper, of which one follows the other.
    """
    joints = joints_in(robot)
    held = urdf_coupled(str(robot)) if KINDS[robot.suffix.lower()] == "urdf" else []

    def left(group: Group) -> Group | None:
        named = [_named(name, [*joints, *held]) for name in group.names]
        kept = [k for k, joint in enumerate(named) if joint not in held]
        if len(kept) == len(group.names) or group.values.shape[1] != len(group.names):
            return group
        units = group.unit.split(", ")
        unit = one_or_each([units[k % len(units)] for k in kept]) if kept else ""
        names = tuple(group.names[k] for k in kept)
        return Group(names, group.values[:, kept], unit) if kept else None

    return {
        role: [group for one in found if (group := left(one)) is not None]
        for role, found in groups.items()
    }


def by_joints(group: Group, joints: Sequence[str]) -> tuple[Group, list[str]]:
    """A group with its columns in the order of a robot's joints, and the joints that they name;
    none where the columns do not name one each.
    """
    found = [_named(name, joints) for name in group.names]
    if not all(found) or len(set(found)) < len(found) or len(found) != group.values.shape[1]:
        return group, []
    order = sorted(range(len(found)), key=lambda k: joints.index(found[k]))
    units = group.unit.split(", ")
    unit = ", ".join(units[k] for k in order) if len(units) == len(order) else group.unit
    ordered = Group(tuple(group.names[k] for k in order), group.values[:, order], unit)
    return ordered, [found[k] for k in order]


def _named(column: str, joints: Sequence[str]) -> str:
    """The joint that a column names, the longest one of wrist and wrist_2; empty: none."""
    return max((j for j in joints if _says(column, j)), key=len, default="")


def _says(column: str, joint: str) -> bool:
    around = rf"(?<![a-z0-9]){re.escape(joint.lower())}(?![a-z0-9])"
    return bool(joint) and re.search(around, column.lower()) is not None


def put_robot(page: Page, robot: Path, folder: Path, position: Group, unit: str) -> None:
    """The lines of the mechanism. ``folder``: where the model file will lie; ``unit``: the question
    after the unit of the position.
    """
    joints, count = joints_in(robot), position.values.shape[1]
    if len(joints) < count:
        raise ModelError(
            f"{robot}: has {counted(len(joints), 'joint')} ({', '.join(joints)}), the recording"
            f" {counted(count, 'position')}: {', '.join(position.names)}"
        )
    _, named = by_joints(position, joints)
    file = Path(os.path.relpath(robot, folder)).as_posix()
    page.line("[mechanism]")
    page.line(f"kind = {json.dumps(KINDS[robot.suffix.lower()])}", ask=unit)
    page.line(f"file = {json.dumps(file, ensure_ascii=False)}")
    ask = ""
    if not named and len(joints) > count:
        ask = f"which {count} of {', '.join(joints)} were recorded? The others are held"
    elif not named and count > 1:
        several = ", ".join(position.names)
        ask = f"do {several} stand in this order? Drivers often list joints by the alphabet"
    which = named or joints[:count]
    page.line(f"joints = {json.dumps(which, ensure_ascii=False)}", "in the file's order", ask)
    put_effects(page, "N m s/rad, N s/m where the joint slides")
    if KINDS[robot.suffix.lower()] == "urdf":  # an MJCF's own friction is the model's
        _put_friction(page, robot, which)


def _put_friction(page: Page, robot: Path, joints: Sequence[str]) -> None:
    """The friction that a URDF states, which no model of kind urdf reads."""
    stated = urdf_friction(str(robot))
    for joint, name in enumerate(joints, 1):
        laws = zip(("viscous", "coulomb"), ("coefficient", "level"), ("damping", "friction"),
                   stated.get(name, (0.0, 0.0)), strict=True)  # fmt: skip
        for law, key, word, value in laws:
            if value:
                page.line()
                page.line("[[effect]]", f"{word} of {name} in {robot.name}")
                page.line(f'kind = "{law}"')
                page.line(f"joint = {joint}")
                page.line(f"{key} = {{ value = {value!r} }}")
