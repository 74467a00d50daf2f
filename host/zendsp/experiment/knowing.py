"""How an experiment comes to know its machine: the shipped arm's settings, a model file, or the
low-speed experiment.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from zendsp.errors import ModelError, Refused
from zendsp.experiment.joints import (
    BRAKED,
    USED,
    Array,
    Axis,
    Known,
    Load,
    Rigid,
    axis_of,
    load_of,
    rigid_of,
)
from zendsp.experiment.lab import Bench, Lab, needed
from zendsp.experiment.planar_arm import ARM
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.standing import standing
from zendsp.link.outside import positions
from zendsp.physics import load_model
from zendsp_protocol.texts import counted

PROGRAM = "joint_pd.c"
WAY, BRAKES = 0.7, 0.1  # of the range: of a push at constant torque, and to stop within
TOUCH = 0.02  # of the largest torque: friction as it is taken before anything is known


def shipped(lab: Lab) -> Known | None:
    """The settings of the shipped arm, where the lab has no target or one with that machine, and no
    model is given.
    """
    return ARM if lab.model is None and lab.shipped("low-speed") == ARM.machine else None


def model_of(lab: Lab, joints: int) -> Rigid | None:
    """What the lab's model says of the torque beside friction.

    Raises
    ------
    ModelError
        It is of another number of joints.
    """
    if lab.model is None:
        return None
    model = load_model(lab.model)
    if model.joints != joints:
        raise ModelError(
            f"{lab.model} has {counted(model.joints, 'joint')} and {lab.machine_of('low-speed')},"
            f" which is measured, {joints}: give a model of that machine"
        )
    return rigid_of(model)


def first_look(bench: Bench, lab: Lab) -> Known:
    """A machine of which nothing is known but what it says itself, and what a model says.

    The program that holds every joint runs for 0.2 s, and tells where they stand and what they
    turn; those that stand beside a limit are moved off it.
    """
    infos = bench.machine.joints
    rigid = model_of(lab, len(infos))
    pose = standing(bench, weight_here(bench, rigid), takes_model=True)
    said = np.atleast_1d(np.asarray(bench.target["J"], dtype=np.float64))
    axes = {}
    for number, info in enumerate(infos, start=1):
        if info.command == "none":
            continue
        load = Load(float(said[number - 1]))
        if rigid is not None:
            load = load_of(rigid, pose, number, info.unit != "rad")
        axes[number] = axis_of(number, info, float(pose[number - 1]), load, TOUCH * info.torque_max)
    return Known(lab.machine_of("low-speed"), axes, pose, rigid, apart=rigid is not None)


def weight_here(bench: Bench, rigid: Rigid | None) -> Array | None:
    """What the joints weigh where they stand by a model, N m (N); None without one."""
    if rigid is None:
        return None
    bench.target.download(PROGRAM)  # positions are known while a program is loaded
    here = np.array(positions(bench.target.status(), bench.machine.joints), dtype=np.float64)
    still = np.zeros((1, len(here)))
    return np.asarray(rigid(here[None, :], still, still)[0])


def with_values(
    lab: Lab, name: str, make: Callable[[Lab], Result], values: Sequence[tuple[str, ...]]
) -> Result:
    """Another experiment's result on the same machine that has one of each of these values, read
    from this folder or made now.
    """
    found = needed(lab, name, make)
    lacking = [one for one in values if not any(value in found.values for value in one)]
    if not lacking:
        return found
    words = ", ".join(" or ".join(one) for one in lacking)
    lab.say(f"{name} in {lab.folder} lacks {words}: it is made again")
    found = make(lab)
    found.save(lab.folder / name / "result.toml")
    return found


def as_found(bench: Bench, lab: Lab, low: Result | None) -> Known:
    """The machine with what the low-speed experiment found of its joints, in the pose in which it
    found it.
    """
    arm = shipped(lab)
    if arm is not None or low is None:
        return arm or ARM
    first = first_look(bench, lab)
    infos = bench.machine.joints
    pose = np.array([low.values[f"place{j}"].value for j in range(1, len(infos) + 1)])
    axes = dict(first.axes)
    other: dict[int, Load] = {}  # what the motion shows of joints whose model it contradicts
    for j, axis in first.axes.items():
        slides = axis.unit != "rad"
        if first.rigid is not None:
            load = load_of(first.rigid, pose, j, slides)
            if f"model_inertia{j}" in low.values:
                other[j] = _load(low, j, load.inertia)
        elif f"inertia{j}" in low.values:
            load = _load(low, j, axis.load.inertia)
        else:
            continue
        level, slope = axis.level, 0.0
        if told := low.values.get(f"level{j}"):
            level = max(told.value, told.std) or axis.level
            slope = low.values[f"slope{j}"].value
        place = float(pose[j - 1])
        # where friction falls with speed its slope there says nothing of high speeds
        viscous = max(slope, level / axis.speed)
        axes[j] = axis_of(j, infos[j - 1], place, other.get(j, load), level, viscous)
        if peak := low.values.get(f"peak{j}"):  # less than usual where the drive gave no more
            axes[j] = replace(axes[j], pace=peak.value)
        axes[j] = replace(with_pushes(axes[j]), load=load)
    found = replace(first, axes=axes, pose=pose, stands=first.pose, apart=first.apart and not other)
    return with_loads(found, other)


def with_loads(known: Known, loads: Mapping[int, Load]) -> Known:
    """The machine where these joints move other loads than was known; a model is corrected by what
    they differ by.
    """
    axes = {**known.axes, **{j: replace(known.axes[j], load=load) for j, load in loads.items()}}
    if known.rigid is None:
        return replace(known, axes=axes)
    rigid = known.rigid
    before = {j: known.axes[j].load for j in loads}

    def corrected(q: Array, qd: Array, qdd: Array) -> Array:
        torque = np.array(rigid(q, qd, qdd))
        for j, load in loads.items():
            torque[:, j - 1] += (load.inertia - before[j].inertia) * qdd[:, j - 1]
            torque[:, j - 1] += load.weight(q[:, j - 1]) - before[j].weight(q[:, j - 1])
        return torque

    return replace(known, axes=axes, rigid=corrected)


def _load(low: Result, joint: int, said: float) -> Load:
    """What a joint moves as the low-speed experiment found it; where the inertia is not told from
    zero that which the machine says.
    """
    found = low.values[f"inertia{joint}"]
    flat, cos, sin = weight_of(low, joint)
    inertia = found.value if found.value > 2.0 * found.std else said
    uneven = low.values[f"uneven{joint}"].value if f"uneven{joint}" in low.values else 0.0
    std = max(flat.std, low.values.get(f"weight{joint}_middle", cos).std)
    return Load(
        inertia, flat.value, cos.value, sin.value, found.std, std, uneven, cos.std, sin.std
    )


def weight_of(low: Result, joint: int) -> list[Estimate]:
    """The parts of a joint's weight that the low-speed experiment found: the same everywhere, by
    cos q, by sin q.
    """
    return [low.values.get(f"weight{joint}{part}", Estimate(0.0)) for part in ("", "_cos", "_sin")]


def with_pushes(axis: Axis) -> Axis:
    """The joint with pushes at constant torque: speeds that it reaches, and stops from, within its
    range, its largest speed and torque.
    """
    top, _ = top_speed(axis)
    if not top > axis.pace:
        return axis
    return replace(axis, speeds=tuple(np.geomspace(max(0.4 * top, axis.pace), top, 5).tolist()))



def top_speed(axis: Axis) -> tuple[float, str]:
    """The largest speed of pushes at constant torque, and what bounds it, in words."""
    load, room, viscous = axis.load, axis.high - axis.low, max(axis.viscous, 1e-9)
    pushes = 0.5 * USED
    spare = max(0.0, pushes * axis.torque - load.most - axis.level)
    stops = 0.5 * USED * axis.torque / load.inertia  # rad/s^2
    force, far = axis.force, f"its range of {room:.3g} {axis.unit}"
    return min(
        (USED * 0.75 * axis.speed, f"its largest speed of {axis.speed:.3g} {axis.unit}/s"),
        (spare / viscous,
         f"its torque_max of {axis.torque:.3g} {force}, of which {pushes:.0%} may push it, less a"
         f" weight of up to {load.most:.3g} and a friction of {axis.level:.3g} {force},"),
        (max(WAY * room * viscous / (1.2 * load.inertia), 2.0 * axis.pace),
         f"{far}, in which it has to come to a steady speed,"),
        (BRAKES * room / BRAKED, f"{far}, in which it has to stop,"),
        ((2.0 * BRAKES * room * stops) ** 0.5, f"{far}, in which it has to stop,"),
    )  # fmt: skip


def refuse_none(result: Result, found: Collection[int]) -> None:
    """Refuse a result of no joint, for the reasons that its warnings say.

    Raises
    ------
    Refused
    """
    if not found:
        raise Refused(f"{result.name}: no joint could be measured. {' '.join(result.warnings)}")
