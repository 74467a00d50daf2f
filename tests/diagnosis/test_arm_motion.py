"""How the links of an arm with springs move, by its model and all of its encoders together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zendsp.diagnosis.data.prepare import at_their_poses, prepare, within_samples
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.transmission.arm_motion import arm_motion, is_chain, with_springs_at
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.diagnosis.transmission.other_springs import with_other_spring
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model
from zendsp.tree import Array

T, SUB, SECONDS, COUNT = 0.004, 20, 8.0, 4e-4  # s; rad
MASS, LENGTH, CENTRE, OWN = 2.0, 0.3, 0.15, 0.02  # kg, m, m, kg m²: of both links
ROTOR = (0.04, 0.012)  # kg m²
VISCOUS = (0.3, 0.15)  # N m s/rad
STIFFNESS, DAMPING = (220.0, 110.0), (0.12, 0.06)  # N m/rad, N m s/rad
LINK = """<link name="l{i}"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{i}" type="continuous"><parent link="l{before}"/><child link="l{i}"/>
<origin xyz="{at} 0 0"/><axis xyz="0 0 1"/></joint>"""


def _bodies(q: Array, v: Array) -> tuple[Array, Array]:
    """Mass matrix and velocity torques of two links in a plane."""
    outer, cross = OWN + MASS * CENTRE**2, MASS * LENGTH * CENTRE
    c, s = cross * np.cos(q[1]), cross * np.sin(q[1])
    first = 2 * OWN + 2 * MASS * CENTRE**2 + MASS * LENGTH**2 + 2 * c
    mass = np.array([[first, outer + c], [outer + c, outer]])
    return mass, np.array([-s * (2 * v[0] * v[1] + v[1] ** 2), s * v[0] ** 2])


def _simulated(springs: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """Commands (n, 2), motors (n, 2), and positions, then speeds of the links (n, 4). A joint (from
    0) without a spring has one of 100 times its stiffness, well damped.
    """
    rigid = [1.0 if j in springs else 100.0 for j in range(2)]
    k = np.array(STIFFNESS) * rigid
    d = np.array([DAMPING[j] if j in springs else 0.4 * np.sqrt(k[j] * ROTOR[j]) for j in (0, 1)])
    t = np.arange(round(SECONDS / T)) * T
    first = np.sin(6 * t) + 0.6 * np.sin(17 * t) + 0.4 * np.sin(37 * t)
    second = np.sin(8 * t + 1) + 0.6 * np.sin(23 * t) + 0.5 * np.sin(51 * t)
    command = np.stack([2.0 * first, 0.7 * second], axis=1) * np.minimum(1.0, t / 0.4)[:, None]
    turned, speed, q, v = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    h, rows = T / SUB, []
    for u in command:
        rows.append((*turned, *q, *v))
        for _ in range(SUB):  # semi-implicit Euler
            through = k * (turned - q) + d * (speed - v)
            mass, moving = _bodies(q, v)
            speed = speed + h * (u - np.array(VISCOUS) * speed - through) / np.array(ROTOR)
            v = v + h * np.linalg.solve(mass, through - moving)
            turned, q = turned + h * speed, q + h * v
    table = np.array(rows)
    return command, table[:, :2], table[:, 2:]


def _model(folder: Path, springs: tuple[int, ...]) -> Model:
    text = LINK.format(i=1, before=0, at=0) + LINK.format(i=2, before=1, at=LENGTH)
    (folder / "arm.urdf").write_text(f'<robot name="arm"><link name="l0"/>{text}</robot>')
    first = 2 * OWN + 2 * MASS * CENTRE**2 + MASS * LENGTH**2 + 2 * MASS * LENGTH * CENTRE
    load = (first, OWN + MASS * CENTRE**2)
    effects = [
        {"kind": kind, "joint": j + 1, key: values[j]}
        for kind, key, values in (("inertia", "amount", ROTOR), ("viscous", "coefficient", VISCOUS))
        for j in (0, 1)
    ]
    effects += [
        {"kind": "elasticity", "joint": j + 1, "stiffness": STIFFNESS[j], "damping": DAMPING[j],
         "load_inertia": load[j], "links_inertia": load[j]}
        for j in springs
    ]  # fmt: skip
    made = parse_model(
        {
            "sample_time": T,
            "mechanism": {"kind": "urdf", "file": "arm.urdf"},
            "sensor": {"position_resolution": COUNT},
            "effect": effects,
        },
        str(folder / "arm.toml"),
    )
    return kernel_model(replace(made, folder=folder))


def _prepared(folder: Path, springs: tuple[int, ...]) -> tuple[Data, Model, Array]:
    """A recording by coarse counts, the true model, and the links within samples (2, 3, n)."""
    command, motors, links = _simulated(springs)
    model = _model(folder, springs)
    seen = COUNT * np.round(motors / COUNT)
    t = np.arange(len(command)) * T
    read = Signals("run", t, T, seen, command, None, np.full(2, COUNT))
    data = prepare([read], model, 64.0)
    q, v = links[:, :2], links[:, 2:]
    states = np.stack([q, v, np.gradient(v, T, axis=0)])
    true = np.stack([within_samples(states[:, :, j], T) for j in (0, 1)])
    return data, at_their_poses(model, data), true


def _off(links: Array, true: Array) -> list[float]:
    """Of each link's acceleration, as a part of it."""
    some = slice(100, -100)
    errors = (links - true)[:, 2, some].std(axis=1) / true[:, 2, some].std(axis=1)
    return [float(e) for e in errors]


def test_links_behind_two_springs_do_not_shake_one_another(tmp_path: Path) -> None:
    """By one observer after the other the links' accelerations were wrong by 0.7 to 1.9 of
    themselves, and calibration moved a true stiffness of 131 N m/rad to 475.
    """
    data, model, true = _prepared(tmp_path, (0, 1))
    rec = data.records[0]
    assert is_chain(data, model, divided(model))
    found = arm_motion(rec, data, model)
    assert found is not None
    motors = _off(rec[0].others, true)
    assert min(motors) > 0.3, "what the encoders show is not how the links move"
    assert max(_off(found.links, true)) < 0.3 * min(motors)
    felt = with_links(Parts(data, data, data), model, divided(model)).fit
    for joint in (1, 2):
        fitted = calibrate_joint(felt, model, joint, 1).model
        stiffness = next(t for t in fitted.at(joint) if t.effect == "elasticity")
        assert stiffness.value("stiffness") == pytest.approx(STIFFNESS[joint - 1], rel=0.05)


def test_errors_of_the_motion_of_links_are_as_large_as_is_said(tmp_path: Path) -> None:
    data, model, true = _prepared(tmp_path, (0, 1))
    found = arm_motion(data.records[0], data, model)
    assert found is not None
    drawn = found.chain.felt_errors(found.strength)[:, 100:-100].std(axis=1)
    pose = np.arange(true.shape[2]) // found.chain.every
    between = found.chain.masses * (1.0 - np.eye(2))
    real = np.einsum("kij,jk->ik", between[pose], (found.links - true)[:, 2])[:, 100:-100]
    assert np.all(drawn > 0.7 * real.std(axis=1)), "else they would be missing physics"
    assert np.all(drawn < 5.0 * real.std(axis=1)), "else they would hide missing physics"


def test_a_spring_that_another_hides_is_found(tmp_path: Path) -> None:
    data, model, _ = _prepared(tmp_path, (0, 1))
    for known, hidden in ((1, 2), (2, 1)):
        found = with_other_spring(data, with_springs_at(model, {known}), {known}, {1, 2})
        assert found is not None
        spring = next(t for t in found.at(hidden) if t.effect == "elasticity")
        assert spring.value("stiffness") == pytest.approx(STIFFNESS[hidden - 1], rel=0.2)


def test_a_rigid_joint_beside_a_spring_has_none(tmp_path: Path) -> None:
    for springs in ((0,), (1,)):
        data, model, _ = _prepared(tmp_path, springs)
        assert with_other_spring(data, model, {springs[0] + 1}, {1, 2}) is None


def test_a_gap_or_a_machine_without_bodies_is_no_chain(tmp_path: Path) -> None:
    data, model, _ = _prepared(tmp_path, (0,))
    assert is_chain(data, model, {1})
    assert not is_chain(data, model, {2}) and not is_chain(data, model, ())
    gap = replace(model.terms[-1], effect="backlash")
    assert not is_chain(data, model.with_terms((*model.terms[:-1], gap)), {1})
    assert not is_chain(data, replace(model, kind="planar2r"), {1})
