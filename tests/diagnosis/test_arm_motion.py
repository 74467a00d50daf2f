"""How the links of an arm with springs move, by its model and all of its encoders together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from zendsp.diagnosis.data.prepare import at_their_poses, prepare, within_samples
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.decide.claims import needed
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.transmission.arm_chain import Chain, Steps, chain_of, springs_of
from zendsp.diagnosis.transmission.arm_motion import arm_motion, is_chain, with_springs_at
from zendsp.diagnosis.transmission.arm_path import path_along
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.diagnosis.transmission.other_springs import (
    first_springs,
    needed_springs,
    with_other_spring,
)
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


@cache
def _simulated(springs: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """Commands (n, 2), motors (n, 2), and positions, then speeds of the links (n, 4). A joint (from
    0) without a spring has one of 100 times its stiffness, well damped. Made once a session, and
    only read.
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
    for made in (command, table):
        made.flags.writeable = False
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


def _scaled(model: Model, by: dict[int, float]) -> Model:
    """The model with stiffer springs at some joints (1-based), by a factor each."""
    terms = list(model.terms)
    for i, t in enumerate(terms):
        if t.effect == "elasticity":
            stiff = t.parameters["stiffness"]
            other = {"stiffness": replace(stiff, value=by[t.joint] * stiff.value)}
            terms[i] = replace(t, parameters={**t.parameters, **other})
    return model.with_terms(tuple(terms))


def test_two_springs_that_take_up_one_another_are_told_apart(tmp_path: Path) -> None:
    """Each by itself fits a third and two thirds of its stiffness to what both do: of 12467 and
    1478 N m/rad one of 3915 was found.
    """
    data, model, _ = _prepared(tmp_path, (0, 1))
    found = needed_springs(data, _scaled(model, {1: 0.33, 2: 0.67}), {1, 2})
    assert found is not None
    for joint, spring in springs_of(found).items():
        assert spring.value("stiffness") == pytest.approx(STIFFNESS[joint - 1], rel=0.005), "counts"


def test_a_spring_that_took_up_another_does_not_keep_it_hidden(tmp_path: Path) -> None:
    """The second spring alone is 64 N m/rad for 110: beside that, no first one pays."""
    data, model, _ = _prepared(tmp_path, (0, 1))
    alone = needed_springs(data, with_springs_at(model, {2}), {2})
    assert alone is not None
    assert springs_of(alone)[2].value("stiffness") < 0.8 * STIFFNESS[1]
    found = with_other_spring(data, alone, {2}, {1, 2})
    assert found is not None
    for joint, spring in springs_of(found).items():
        assert spring.value("stiffness") == pytest.approx(STIFFNESS[joint - 1], rel=0.1)


def test_of_two_springs_one_that_only_imitates_the_other_is_dropped(tmp_path: Path) -> None:
    for true in (0, 1):
        data, model, _ = _prepared(tmp_path, (true,))
        both = _model(tmp_path, (0, 1)).terms
        found = needed_springs(data, model.with_terms(both), {1, 2})
        assert found is not None and set(springs_of(found)) == {true + 1}


def test_the_filter_of_an_arm_says_what_a_dense_one_says() -> None:
    """Also where a sensor rests on a plateau, says nothing, or a torque becomes unsure."""
    rng = np.random.default_rng(3)
    n, every, c, m = 40, 8, 5, 3
    d, poses = 2 * c, n // every
    A = np.eye(d) + T * np.eye(d, k=c) + np.zeros((poses, 1, 1))
    eased, bent = rng.standard_normal((poses, c, 2)), 0.1 * rng.standard_normal((poses, 4, 4))
    motors, links = np.array([2, 0]), np.array([4, 3])
    twist = np.eye(c)[motors] - np.eye(c)[links]
    A += np.kron(np.eye(2), eased) @ bent @ np.kron(np.eye(2), twist)
    G = rng.standard_normal((poses, d, c))
    f, unsure = rng.standard_normal((n, c)), np.zeros((n, c))
    unsure[13:21, 2] = 4.0
    value, half = 2.0 * rng.standard_normal((n, m)), np.zeros((n, m))
    variance = np.full((n, m), 0.3)
    half[5:9, 1], variance[17:20, 0] = 0.4, -1.0
    first, spread, usual = rng.standard_normal(d), rng.uniform(0.5, 2.0, d), np.full(c, 2.0)
    places = np.arange(c)
    chain = Chain(
        np.zeros((poses, m, m)), Steps(A, G, eased, bent, motors, links), f, unsure,
        (value, half, variance), (first, spread), places, usual, T, every,
    )  # fmt: skip
    strength = rng.uniform(0.1, 1.0, c)
    x, P, deviance = first, np.diag(spread), 0.0
    for k in range(n):
        for i in np.flatnonzero(variance[k] > 0.0):
            error = value[k, i] - x[i]
            error = np.sign(error) * max(abs(error) - half[k, i], 0.0)
            S = P[i, i] + variance[k, i]
            gain = P[:, i] / S
            x, P = x + gain * error, P - S * np.outer(gain, gain)
            deviance += np.log(S) + error**2 / S
        a, g = A[k // every], G[k // every]
        x = a @ x + g @ f[k]
        P = a @ P @ a.T + g @ np.diag(unsure[k] + (strength * usual) ** 2) @ g.T
    smoothed = chain.smoothed(strength)[0]
    assert smoothed == pytest.approx(deviance, rel=1e-10), "both round"
    assert chain.deviance(strength) == smoothed


def test_a_step_of_an_arm_is_the_exponential_of_its_bodies_and_springs(tmp_path: Path) -> None:
    """In A and G, and in A's few numbers by which the filter goes."""
    data, model, _ = _prepared(tmp_path, (0, 1))
    rec = data.records[0]
    chain = chain_of(path_along(rec, data, model, rec[0].others), model)
    assert chain is not None
    c, twist = 4, np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    pulls = twist.T * STIFFNESS @ twist, twist.T * DAMPING @ twist
    for pose in (0, 30):
        steps = chain.steps
        inverse = np.zeros((c, c))
        inverse[:2, :2] = np.diag(1.0 / np.array(ROTOR))
        inverse[2:, 2:] = np.linalg.inv(chain.masses[pose])
        rate = np.zeros((3 * c, 3 * c))
        rate[:c, c : 2 * c] = np.eye(c)
        rate[c : 2 * c] = np.hstack([-inverse @ pulls[0], -inverse @ pulls[1], inverse])
        whole = expm(T * rate)[: 2 * c]
        few = np.kron(np.eye(2), steps.eased[pose]) @ steps.bent[pose] @ np.kron(np.eye(2), twist)
        free = np.eye(2 * c) + T * np.eye(2 * c, k=c)
        for found in (steps.A[pose], free + few):
            assert found == pytest.approx(whole[:, : 2 * c], rel=1e-8, abs=1e-10), "rounding"
        assert steps.G[pose] == pytest.approx(whole[:, 2 * c :], rel=1e-8, abs=1e-12), "rounding"


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


ONE = pytest.mark.long("both and none are the same decision; lost: one alone")


@pytest.mark.parametrize("springs", [(), pytest.param((1,), marks=ONE), (0, 1)])
def test_all_encoders_show_springs_before_a_joint_is_searched(
    springs: tuple[int, ...], tmp_path: Path
) -> None:
    """Searched upon recorded positions, the joints beside a spring took most of the time."""
    data, model, _ = _prepared(tmp_path, springs)
    found = first_springs(data, data, with_springs_at(model, ()), needed(2))
    had = {} if found is None else springs_of(found)
    assert {j: had[j].value("stiffness") for j in sorted(had)} == {
        # 3 %: of nine arms it was within 2.8 %
        j + 1: pytest.approx(STIFFNESS[j], rel=0.03) for j in springs
    }


def test_a_spring_that_other_recordings_have_not_is_none_of_all_encoders(tmp_path: Path) -> None:
    """One of a rigid arm gained 96 of the deviance of the fit, and lost 12 elsewhere."""
    data, model, _ = _prepared(tmp_path, (0,))
    others, *_ = _prepared(tmp_path, ())
    assert first_springs(data, others, with_springs_at(model, ()), needed(2)) is None
