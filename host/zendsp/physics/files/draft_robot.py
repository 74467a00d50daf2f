"""The mechanism of a draft whose bodies stand in a URDF or an MJCF: which of its joints the columns
of a recording are.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

from zendsp.errors import ModelError
from zendsp.physics.files.draft_data import Group, one_or_each
from zendsp.physics.files.draft_tables import Page, put_effects
from zendsp.physics.robots.urdf import urdf_coupled, urdf_friction, urdf_joints
from zendsp.recording.roles import Role
from zendsp_protocol.texts import counted

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
