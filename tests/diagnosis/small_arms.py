"""Arms of three joints with something wrong: Pinocchio is the reality, with friction in every joint
that the given model may lack.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.search.bodies import BodySearch, find_bodies
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.model import Model

RATE, SUB = 500.0, 4
FRICTION = np.array([0.6, 1.2, 0.5])  # N m, dry
DAMPING = np.array([0.3, 0.6, 0.2])  # N m s/rad
RESOLUTION = 2 * np.pi / 2**17
ROTOR = 0.05  # kg m², of the last motor where a spring drives its link
HELD = 1e12  # kg m², of a joint that does not move
LINKS = (  # name, place, axis, mass, centre, inertia
    ("column", "0 0 0.2", "0 0 1", 4.0, "0 0.02 0.05", 0.02),
    ("upper", "0 0.1 0.1", "0 1 0", 5.0, "0.2 0 0.01", 0.06),
    ("fore", "0.4 0 0", "0 1 0", 2.0, "0.15 0.01 0", 0.015),
)
# a wrist that weighs something and has no inertia about its axis, as files often have it
WRIST = (*LINKS[:2], ("fore", "0.4 0 0", "1 0 0", 0.5, "0.04 0 0", 0.0))

# in a plane across gravity, so that inertia alone shows what it carries
FLAT = (
    ("column", "0 0 0.2", "0 0 1", 4.0, "0.15 0.02 0", 0.02),
    ("upper", "0.3 0 0", "0 0 1", 3.0, "0.15 0 0.01", 0.03),
    ("fore", "0.3 0 0", "0 0 1", 1.0, "0.1 0.01 0", 0.008),
)

# Ends of the strap: on the forearm, and on the base, m; and the product across the first
TIED, BASE_TIED = np.array([0.2, 0.0, 0.05]), np.array([0.25, -0.1, 0.1])
ACROSS_TIED = np.cross(TIED, np.eye(3), axisb=0, axisc=0)


def urdf(links: tuple[tuple[str, str, str, float, str, float], ...]) -> str:
    parts, parent = ['<robot name="arm"><link name="base"/>'], "base"
    for name, place, axis, mass, com, inertia in links:
        parts.append(
            f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia'
            f' ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0"'
            f' iyz="0"/></inertial></link><joint name="to_{name}" type="revolute"><parent'
            f' link="{parent}"/><child link="{name}"/><origin xyz="{place}"/><axis'
            f' xyz="{axis}"/><limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        )
        parent = name
    return "".join([*parts, "</robot>"])


@dataclass(frozen=True)
class Arm:
    """What is true and not in the given model."""

    mass: float = 0.0  # of a payload on the forearm, kg, with its centre at `com`
    com: tuple[float, float, float] = (0.35, 0.05, 0.03)
    round: float = 0.0  # kg m², of it about its centre
    carried: tuple[float, float] = (0.0, np.inf)  # s, from when and until when it is carried
    heavier: float = 0.0  # kg of the upper arm's own mass
    shifted: float = 0.0  # m of the upper arm's centre, along it
    tilt: float = 0.0  # rad, of gravity about x
    gain: float = 1.0  # of the actuator of joint 2
    rotor: float = 0.0  # kg m², of the motor of joint 2
    motors: tuple[float, float, float] = (0.0, 0.0, 0.0)  # kg m², rotors that no file has
    links: tuple[tuple[str, str, str, float, str, float], ...] = LINKS
    counts: float = RESOLUTION  # rad, of the encoders
    spring: float = 0.0  # N m/rad between the last motor, where its sensor is, and its link
    held: int = 0  # joint (1-based) that its brake holds
    strap: float = 0.0  # N/m, from the base to the forearm, slack below a quarter of a metre
    balancer: float = 0.0  # N/m, of a spring that lifts the upper arm, in no file


def pulled(arm: Arm, model: Any, data: Any, q: np.ndarray) -> np.ndarray:
    """Torques of the strap, N m."""
    import pinocchio as pin

    jacobian = pin.computeJointJacobian(model, data, q, 3)  # in the frame of the forearm
    pin.forwardKinematics(model, data, q)
    there = data.oMi[3]
    away = there.translation + there.rotation @ TIED - BASE_TIED
    long = float(np.linalg.norm(away))
    pull = -arm.strap * max(long - 0.25, 0.0) / long * away @ there.rotation
    return np.concatenate([pull, ACROSS_TIED @ pull]) @ jacobian


def lifted(arm: Arm, q: np.ndarray) -> np.ndarray:
    """Torques of the balancer, N m: from 0.3 m above joint 2 to 0.1 m along the upper arm."""
    long = float(np.sqrt(0.1 + 0.06 * np.sin(q[1])))
    return np.array([0.0, -arm.balancer * (long - 0.2) / long * 0.03 * np.cos(q[1]), 0.0])


def simulate(arm: Arm, seed: int, seconds: float = 7.0) -> dict[str, np.ndarray]:
    """Columns t, q, u of a loop with gravity compensation of the given model, the caller's own;
    semi-implicit Euler at 2 kHz.
    """
    table = _simulated(arm, seed, seconds).copy()
    return {"t": table[:, 0], "q": table[:, 1:4], "u": table[:, 4:]}


@cache
def _simulated(arm: Arm, seed: int, seconds: float) -> np.ndarray:
    """Rows of t, q, u, made once a session."""
    import pinocchio as pin

    given = pin.buildModelFromXML(urdf(arm.links))
    true = given.copy()
    load = pin.Inertia(arm.mass, np.array(arm.com), arm.round * np.eye(3))
    bare = given.inertias[3].copy()
    loads = [bare, bare + load]
    own = true.inertias[2]
    lever = own.lever + np.array([arm.shifted, 0.0, 0.0])
    true.inertias[2] = pin.Inertia(own.mass + arm.heavier, lever, own.inertia)
    true.armature = np.add(arm.motors, (0.0, arm.rotor, 0.0))
    if arm.held:
        true.armature[arm.held - 1] = HELD
    true.gravity.linear = 9.81 * np.array([0.0, np.sin(arm.tilt), -np.cos(arm.tilt)])
    data, plan = true.createData(), given.createData()
    r = np.random.default_rng(seed)
    f, phase = r.uniform(0.1, 0.9, (3, 5)), r.uniform(0, 6.28, (3, 5))
    size = np.array([0.8, 0.6, 0.8])[:, None] * 0.4 / f**0.5
    kp = np.array([60.0, 90.0, 40.0])
    kd = np.array([8.0, 12.0, 4.0])
    gain = np.array([1.0, arm.gain, 1.0])
    h, shaken = 1.0 / RATE / SUB, [j + 1 != arm.held for j in range(3)]
    q = np.array([0.0, 0.6, -0.9]) + (size * np.sin(phase)).sum(1)
    if arm.held:
        q[arm.held - 1] = RESOLUTION * 1000
    v = np.zeros(3)
    motor, turns = q[2], 0.0
    last, rows = q.copy(), []
    times = np.arange(int(seconds * RATE)) / RATE
    waves = np.sin(2 * np.pi * f * times[:, None, None] + phase)
    for t, goal in zip(times, np.array([0.0, 0.6, -0.9]) + (size * waves).sum(2), strict=True):
        seen = np.array([q[0], q[1], motor]) if arm.spring else q
        noise = r.normal(0, RESOLUTION / 3, 3) * shaken
        y = arm.counts * np.round((seen + noise) / arm.counts)
        u = pin.computeGeneralizedGravity(given, plan, y) + kp * (goal - y) - kd * (y - last) * RATE
        last = y
        rows.append([t, *y, *u])
        true.inertias[3] = loads[int(arm.carried[0] <= t < arm.carried[1])]
        for _ in range(SUB):
            pull = pulled(arm, true, data, q) if arm.strap else lifted(arm, q)
            moving = np.array([v[0], v[1], turns]) if arm.spring else v
            free = gain * u + pull - FRICTION * np.tanh(moving / 0.005) - DAMPING * moving
            if arm.spring:
                bent = arm.spring * (motor - q[2]) + 0.2 * (turns - v[2])
                turns += h * (free[2] - bent) / ROTOR
                motor += h * turns
                free[2] = bent
            v = v + h * pin.aba(true, data, q, v, free)
            q = q + h * v
    return np.array(rows)


def recorded(
    folder: Path, name: str, arm: Arm, friction: bool = False, seconds: float = 7.0
) -> tuple[Model, list[Path]]:
    """Two recordings of an arm, made once, and a model that lacks what is wrong with it, and
    friction too unless told.
    """
    (folder / "arm.urdf").write_text(urdf(arm.links))
    paths = [folder / f"{name}{seed}.npz" for seed in (1, 2)]
    for seed, path in enumerate(paths, 1):
        if not path.exists():
            np.savez(path, **simulate(arm, seed, seconds))
    effects = [
        {"kind": kind, "joint": j + 1, key: {"value": float(values[j])}}
        for kind, key, values in (
            ("coulomb", "level", FRICTION),
            ("viscous", "coefficient", DAMPING),
        )
        for j in range(3)
    ]
    model = folder / "model.toml"
    model.write_text(
        f'name = "arm"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "urdf"\n'
        f'file = "arm.urdf"\n[sensor]\nposition_resolution = {arm.counts}\n[columns]\n'
        'time = "t"\nposition = "q"\ncommand = "u"\n'
    )
    given = load_model(model)
    if friction:
        known = parse_model(
            {"mechanism": {"kind": "urdf", "file": str(folder / "arm.urdf")}, "effect": effects}
        )
        given = given.with_terms(known.terms)
    return given, paths


def prepared(made: tuple[Model, list[Path]]) -> tuple[Data, Data]:
    """To fit to, all but the last, and to choose by."""
    model, paths = made
    signals = [read_signals(path, model) for path in paths]
    return prepare(signals[:-1], model, 64.0), prepare(signals[-1:], model, 64.0)


def searched(made: tuple[Model, list[Path]]) -> BodySearch:
    """What the search for bodies proposes."""
    return find_bodies(*prepared(made), made[0], 1, lambda _text: None)
