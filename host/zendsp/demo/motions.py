"""The motions of the story: slow and fast, with reversals, within the limits of each machine."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.physics.codegen.urdf import dh_urdf
from zendsp.physics.model import MechanismTable, ParameterTable
from zendsp.reference import Machine, Reference, make_circle, make_multisine, make_point_to_point

TRAVEL_S = 0.8  # from the end of one motion to the beginning of the next


def join(machine: Machine, parts: Sequence[Reference]) -> Reference:
    """Motions one after the other, with moves between them that begin and end at rest.

    Parameters
    ----------
    parts : sequence of Reference
        All of one sample time.

    Returns
    -------
    Reference
        Checked against the limits of the machine.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> arm = load_machine("imi_planar")
    >>> circle = make_circle(arm, radius=0.1)
    >>> join(arm, [circle, circle]).samples == 2 * circle.samples - 1
    True
    """
    rows = [parts[0].q]
    dt = parts[0].sample_time
    for before, after in itertools.pairwise(parts):
        if np.abs(before.q[-1] - after.q[0]).max() > 1e-9:
            way = make_point_to_point(
                machine, start=before.q[-1], goal=after.q[0], duration=TRAVEL_S, sample_time=dt
            )
            rows.append(way.q[1:])
        rows.append(after.q[1:])
    whole = Reference(np.concatenate(rows), dt, kind="story", machine=machine.name)
    machine.check(whole)
    return whole


def _multisine(
    machine: Machine, start: Any, amplitude: Any, period: float, f_max: float, fade: float = 0.5
) -> Reference:
    return make_multisine(
        machine, start=start, amplitude=amplitude, period=period, f_min=1.0 / period, f_max=f_max,
        periods=1, fade_time=fade,
    )


def arm_train(machine: Machine) -> Reference:
    """The motion on which the arm is recorded: circles slow and fast, small sways, then a wide
    multisine.
    """
    slow = make_circle(machine, radius=0.12, x=0.48, duration=3.0)
    fast = make_circle(machine, radius=0.12, x=0.48, duration=2.6, turns=-2)
    # Both joints reverse below 0.1 rad/s, each in its own time: without that, friction that falls
    # with speed was a foreign torque, and what one joint does to the other a disturbance.
    sway = _multisine(machine, [0.3, 0.5], 0.06, 4.0, 0.75)
    # Nearly as wide as the limits of speed allow: over 2.8 rad, a ripple of three a turn looked
    # like a spring, gravity and another ripple.
    wide = _multisine(machine, [0.0, 0.5], [1.7, 1.5], 6.0, 1.0, fade=0.7)
    return join(machine, [slow, fast, sway, wide])


def arm_heldout(machine: Machine) -> Reference:
    """The motion on which the arm's model is judged: another circle and another multisine."""
    circle = make_circle(machine, radius=0.1, x=0.47, y=0.08, duration=2.5, phase=2.0, turns=-1)
    return join(machine, [circle, _multisine(machine, [-0.1, 0.6], [1.3, 1.2], 5.0, 1.0)])


def arm_work(machine: Machine) -> Reference:
    """One lap of the arm's work: circles."""
    lap = make_circle(
        machine, radius=0.12, x=0.48, duration=12.0, turns=6, law="trapezoid", blend=0.06
    )
    machine.check(lap)
    return lap


def arm_mechanism(machine: Machine, folder: Path) -> MechanismTable:
    """The ``[mechanism]`` of the arm's nominal model."""
    numbers = machine.parameters
    parameters: dict[str, ParameterTable]
    parameters = {key: {"value": numbers[key]} for key in ("p1", "p2", "p3")}
    parameters |= {key: {"value": numbers[key], "free": False} for key in ("l1", "l2")}
    return {"kind": "planar2r", "parameters": parameters}


def pendulum_train(machine: Machine) -> Reference:
    """The motion on which the pendulum is recorded: two multisines, small and wide."""
    return join(
        machine, [_multisine(machine, 0.0, 0.5, 5.0, 0.8), _multisine(machine, 0.2, 2.6, 6.0, 1.2)]
    )


def pendulum_heldout(machine: Machine) -> Reference:
    """The motion on which the pendulum's model is judged: another multisine."""
    return join(machine, [_multisine(machine, 0.1, 2.4, 5.0, 1.2)])


def pendulum_work(machine: Machine) -> Reference:
    """One lap of the pendulum's work: it swings slower and faster in turn. At a constant pace all
    that friction does near rest is over in 25 ms, sooner than a torque that is fed forward can
    cancel it.
    """
    dt = machine.sample_time
    t = np.arange(round(12.0 / dt) + 1) * dt
    rise = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    pace, turn, slower = 0.4, 6.0, 0.8  # Hz on average; s between slowest and slowest; of the pace
    late = slower * turn / (2 * np.pi) * np.sin(2 * np.pi * t / turn)
    swing = 1.2 * np.sin(2 * np.pi * pace * (t - late))
    swing *= rise**3 * (10.0 + rise * (6.0 * rise - 15.0))
    lap = Reference(swing, dt, kind="swing", machine=machine.name)
    machine.check(lap)
    return lap


def pendulum_mechanism(machine: Machine, folder: Path) -> MechanismTable:
    """The ``[mechanism]`` of the pendulum's nominal model."""
    numbers = machine.parameters
    return {
        "kind": "rotary",
        "parameters": {
            "inertia": {"value": numbers["theta1"]},
            "gravity": {"value": 9.81 * numbers["theta2"]},
        },
    }


WAM_START = (0.0, -0.5, 0.0, 1.7, 0.0, 0.2, 0.0)  # rad: the elbow ahead, the hand low


def _wam_multisine(machine: Machine, share: float, period: float, f_max: float) -> Reference:
    amplitude = share * np.array([0.7, 0.5, 0.7, 0.6, 0.8, 0.7, 0.25])
    return _multisine(machine, list(WAM_START), amplitude.tolist(), period, f_max, fade=1.0)


def wam_train(machine: Machine) -> Reference:
    """The motion on which the seven-joint arm is recorded: one multisine of all its joints."""
    return join(machine, [_wam_multisine(machine, 0.8, 8.0, 1.0)])


def wam_heldout(machine: Machine) -> Reference:
    """The motion on which the seven-joint arm's model is judged: another multisine."""
    return join(machine, [_wam_multisine(machine, 0.6, 6.0, 1.2)])


def wam_work(machine: Machine) -> Reference:
    """One lap of the seven-joint arm's work: shoulder, elbow and wrist lift and lower."""
    dt = machine.sample_time
    t = np.arange(round(12.0 / dt) + 1) * dt
    rise = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    swing = np.sin(np.pi * t / 1.5) * rise**3 * (10.0 + rise * (6.0 * rise - 15.0))
    turns = np.array([0.3, 0.35, 0.0, -0.4, 0.0, 0.4, 0.0])
    lap = Reference(
        np.array(WAM_START) + swing[:, None] * turns, dt, kind="lift", machine=machine.name
    )
    machine.check(lap)
    return lap


def wam_mechanism(machine: Machine, folder: Path) -> MechanismTable:
    """The ``[mechanism]`` of the seven-joint arm's nominal model: a URDF, written into the folder.
    """
    file = folder / "wam7.urdf"
    names = ("position_min", "position_max", "torque", "speed")
    limits = {name: getattr(machine.limits, name).tolist() for name in names}
    file.write_text(dh_urdf("wam7", machine.parameters["link"], limits), encoding="utf-8")
    return {"kind": "urdf", "file": str(file.resolve())}


# What a draw may choose: effects that show in this motion. Left out are those that the given model
# has itself (viscous, coulomb and inertia: calibration finds them and nothing is missing), those
# with which the machine trips (saturation, cubic_stiffness), friction_drift, which wants recordings
# longer than these, and lag and delay, which no torque cancels: the tracking error would stay. Not
# for the pendulum: a dead zone, whose jumps of torque its current loop answers in a way that the
# given model knows nothing of.
ARM_POOL = (
    "ripple", "position_friction", "coupling", "quadratic_drag", "stribeck", "coulomb_asymmetry",
    "viscous_asymmetry", "stiffness", "gravity", "torque_offset", "dead_zone",
)
WAM_POOL = ("payload",)
PENDULUM_POOL = (
    "ripple", "position_friction", "quadratic_drag", "stribeck", "coulomb_asymmetry",
    "viscous_asymmetry", "stiffness", "torque_offset",
)
