"""The machine that a reference is planned for: by name, as its file or a running target tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import open_target
from zendsp.errors import ReferenceError_

if TYPE_CHECKING:
    from zendsp.link import Target
    from zendsp.reference import Machine
    from zendsp_protocol.messages import MachineInfo

ROBOTS = (".xml", ".mjcf", ".urdf", ".c")  # what a target simulates


def machine_for(name: str | None, target: str, connect: str | None) -> Machine | None:
    """The machine that the options name; None where they name none.

    Parameters
    ----------
    name : str or None
        A shipped one, a TOML description, or a file that a target simulates: one is started for it,
        which tells its limits and ends.
    target, connect : str
        Of a running target, whose limits are taken.
    """
    if target or connect:
        if name is not None:
            raise click.UsageError(
                "--machine names a machine and --target one that runs: give one of them"
            )
        with open_target(target, connect) as opened:
            return _told_by(opened)[0]
    if name is None:
        return None
    if name.lower().endswith(ROBOTS):
        return _simulated(Path(name))
    from zendsp.reference import load_machine

    return load_machine(name)


def _simulated(file: Path) -> Machine:
    """The machine of a robot's file, as a target that simulates it would tell; of a URDF with its
    rigid bodies.
    """
    from zendsp.link import local

    if not file.is_file():
        raise ReferenceError_(f"--machine {file}: no such file")
    with local(str(file), clock="fast") as target:
        machine, said = _told_by(target)
    return _with_bodies(machine, file, said) if file.suffix.lower() == ".urdf" else machine


def _with_bodies(machine: Machine, file: Path, said: MachineInfo) -> Machine:
    """The machine with the rigid bodies and the friction of its URDF, which say what torque a
    motion needs; as it was where these are no tree of the machine's joints.
    """
    from zendsp.errors import ModelError
    from zendsp.physics.robots.urdf import read_urdf, urdf_friction, urdf_joints

    names = [joint.name for joint in said.joints]
    try:
        chain = [name for name in urdf_joints(str(file)) if name in names]
        bodies, gravity = read_urdf(str(file), chain)
        friction = urdf_friction(str(file))
    except ModelError:
        return machine
    if sorted(chain) != sorted(names):
        return machine
    viscous, coulomb = zip(*(friction.get(name, (0.0, 0.0)) for name in names), strict=True)
    told = [chain.index(name) for name in names]  # MuJoCo keeps the order of the file
    links = [
        replace(bodies[k], parent=told.index(bodies[k].parent) if bodies[k].parent >= 0 else -1)
        for k in told
    ]
    return replace(
        machine,
        kind="tree",
        title=f"{machine.name}, as its URDF has it",
        parameters={"bodies": links, "gravity": gravity, "viscous": viscous, "coulomb": coulomb},
    )


def _told_by(target: Target) -> tuple[Machine, MachineInfo]:
    from zendsp.experiment.lab import told
    from zendsp.link.put_back import GONE
    from zendsp.reference.told import machine_told

    status = target.status()
    limits = None if status.state in GONE else target.limits()
    said = told(target)
    return machine_told(said, limits, 1.0 / status.rate_hz), said
