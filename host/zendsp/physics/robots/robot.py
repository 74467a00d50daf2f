"""Models whose rigid bodies stand in a file of their own, URDF or MJCF: the tree that both become.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.model import TREES, Actuator, Model, Quantity, Robot, Term
from zendsp.physics.robots.mjcf import Mjcf, read_mjcf, stated_terms
from zendsp.physics.robots.mjcf_drives import Drive, read_drives
from zendsp.physics.robots.urdf import read_urdf
from zendsp.tree import Body

Array = npt.NDArray[np.float64]


def robot_path(model: Model) -> str:
    """Path of the URDF or MJCF, relative to the model file.

    Raises
    ------
    ModelError
        Where there is no such file.
    """
    path = Path(model.file) if Path(model.file).is_absolute() else model.folder / model.file
    if not path.is_file():
        raise ModelError(
            f"[mechanism] file = {model.file!r}: no such file beside the model ({path})"
        )
    return str(path)


def robot_tree(model: Model) -> tuple[list[Body], Array]:
    """Links and gravity of a model whose kind is in ``TREES``, as its file has them.

    Raises
    ------
    ModelError
        No such file, or one that cannot be taken over.
    """
    path = robot_path(model)
    if model.kind == "mjcf":
        taken = read_mjcf(path, model.robot.joints)
        return list(taken.bodies), taken.gravity
    return _urdf(path, model.robot.joints, Path(path).stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _urdf(path: str, joints: tuple[str, ...], _changed: int) -> tuple[list[Body], Array]:
    return read_urdf(path, joints)


def mjcf_of(model: Model) -> Mjcf:
    """The compiled model of ``kind = "mjcf"``."""
    return read_mjcf(robot_path(model), model.robot.joints)


def joint_kinds(model: Model) -> tuple[str, ...]:
    """``"rotary"`` or ``"linear"`` of each joint; empty where the file cannot be read: whoever
    needs it says so.
    """
    if model.kind not in TREES:
        return ()
    try:
        bodies, _ = robot_tree(model)
    except ModelError:
        if model.kind == "mjcf":
            raise
        return ()
    return tuple("linear" if b.slides else "rotary" for b in bodies)


def stated(model: Model, robot: Robot) -> tuple[tuple[Term, ...], Actuator, Robot]:
    """The content of an MJCF beside its bodies: effects, actuators, and the joints' servos.

    Parameters
    ----------
    model : Model
        Of ``kind = "mjcf"``, as its file alone has it.
    robot : Robot
        ``take`` says what of the MJCF counts; ``commands`` whether the model file says itself what
        a command means.
    """
    taken, path = mjcf_of(model), robot_path(model)
    terms = list(stated_terms(taken)) if robot.take == "all" else []
    drives: tuple[Drive | None, ...] = (None,) * len(taken.joints)
    if robot.take == "servos" or (robot.take == "all" and not robot.commands):
        drives = read_drives(taken, path)
    servos = tuple(d if d is not None and d.servo else None for d in drives)
    robot = Robot(robot.joints, robot.take, robot.commands, servos if any(servos) else ())
    if robot.take != "all" or robot.commands:
        return tuple(terms), model.actuator, robot
    motors = [d if d is not None and not d.servo else None for d in drives]
    terms += [
        Term("lag", j, {"time_constant": Quantity(d.lag)})
        for j, d in enumerate(motors, 1)
        if d is not None and d.lag > 0.0
    ]
    delays = {d.delay if d is not None else 0.0 for d in drives}
    if len(delays) > 1:
        raise ModelError(
            f"{path}: its actuators have different delays ({sorted(delays)} s): a model has one,"
            " [actuator] delay; state the others as [[effect]] kind = \"delay\""
        )
    limits = tuple(d.limit if d is not None else 0.0 for d in motors)
    gains = tuple(d.scale if d is not None else 1.0 for d in motors)
    a = model.actuator
    return tuple(terms), Actuator(
        gain=gains,
        limit=a.limit or (limits if any(limits) else ()),
        hold=a.hold,
        delay=a.delay or delays.pop(),
        matrix=a.matrix,
        unit=a.unit,
    ), robot  # fmt: skip
