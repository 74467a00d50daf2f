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
    """The machine of a robot's file, as a target that simulates it would tell; of a URDF with the
    speeds that it limits, which MuJoCo does not read.
    """
    from zendsp.link import local

    if not file.is_file():
        raise ReferenceError_(f"--machine {file}: no such file")
    with local(str(file), clock="fast") as target:
        machine, said = _told_by(target)
    if file.suffix.lower() != ".urdf":
        return machine
    from xml.etree import ElementTree

    import numpy as np

    stated = {
        joint.get("name", ""): float(limit.get("velocity", "inf"))
        for joint in ElementTree.parse(file).iter("joint")
        if (limit := joint.find("limit")) is not None
    }
    speeds = [
        min(own, stated.get(joint.name) or own)  # 0: it says nothing
        for joint, own in zip(said.joints, machine.limits.speed, strict=True)
    ]
    return replace(machine, limits=replace(machine.limits, speed=np.array(speeds)))


def _told_by(target: Target) -> tuple[Machine, MachineInfo]:
    from zendsp.experiment.lab import told
    from zendsp.link.put_back import GONE
    from zendsp.reference.told import machine_told

    status = target.status()
    limits = None if status.state in GONE else target.limits()
    said = told(target)
    return machine_told(said, limits, 1.0 / status.rate_hz), said
