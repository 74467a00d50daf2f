"""What calibration does to the numbers of an arm: rotors, inertias, centres of mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_arms import (
    LINKS,
    RATE,
    RESOLUTION,
    SUB,
    WRIST,
    Arm,
    recorded,
    urdf,
)

import zendsp
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.decide.moved import moved, one_factor
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.search.body_explain import price_of
from zendsp.diagnosis.search.body_hypotheses import LIMITS, Hypothesis
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.physics.calibration.handles import Handle, set_values
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.model import Actuator, Model, Quantity
from zendsp.physics.term_numbers import kernel_model


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Model, list[Path]]]:
    """``recorded`` in one folder."""
    return partial(recorded, tmp_path_factory.mktemp("arms"))


def test_a_coordinate_of_a_centre_of_mass_that_no_joint_feels_is_not_fitted() -> None:
    """With two parallel axes, a coordinate along them had come out as 30 km, with springs to
    balance it. A tilt without any effect had come out as three million radians.
    """
    from zendsp.diagnosis.search.body_hypotheses import felt, turned
    from zendsp.physics.robots.bodies import Links
    from zendsp.tree import Body

    def link(parent: int, axis: tuple[float, float, float]) -> Body:
        own = np.diag([0.1, 0.2, 0.3])
        at = np.array([0.1, 0.2, 0.4])
        return Body(parent, False, np.array(axis), np.eye(3), at, 1.0, at, own, "link")

    motion, down = np.random.default_rng(1).normal(size=(2, 3, 50)), np.array([0.0, 0.0, -9.81])
    flat = Links((link(-1, (0, 1, 0)), link(0, (0, 1, 0))), down, motion)
    upright = Links((link(-1, (0, 0, 1)), link(0, (0, 1, 0))), down, motion)
    assert [felt(flat, k) for k in (0, 1)] == [("com_x", "com_z")] * 2
    # about the vertical nothing tells how high it is; behind the second joint all is felt
    assert felt(upright, 0) == ("com_x", "com_y")
    assert felt(upright, 1) == ("com_x", "com_y", "com_z")
    assert (turned(flat), turned(upright)) == (("angle_y",), ("angle_x", "angle_y"))


def test_the_inertia_of_joints_that_accelerate_together_stays_in_its_range(tmp_path: Path) -> None:
    """The model has a third of a rotor's inertia. Joints 1 and 3 accelerate nearly as joint 2 does,
    so the coupling columns absorb a part: from them alone it would be 0.22 kg m² at most.
    """
    import pinocchio as pin

    rotor, arm = 0.3, pin.buildModelFromXML(urdf(LINKS))
    work, t, rng = arm.createData(), np.arange(10 * RATE) / RATE, np.random.default_rng(1)
    w = 2 * np.pi * rng.uniform(0.3, 1.2, (6, 1))
    alike, own = (np.exp(1j * (w * t + rng.uniform(0, 6.28, (6, 1)))) * 0.2 for _ in range(2))
    waves = np.stack([alike, 0.1 * own - alike, 0.07 * own + alike])
    q, v, a = (((1j * w) ** k * waves).sum(1).real.T for k in range(3))
    q = q + np.array([0.0, 0.5, -0.9])
    u = np.array([pin.rnea(arm, work, *x) for x in zip(q, v, a, strict=True)])
    u += 0.5 * np.tanh(v / 0.005) + rotor * a * np.array([0, 1, 0])
    u += rng.normal(0, 0.01, u.shape)
    np.savez(tmp_path / "run.npz", t=t, q=RESOLUTION * np.round(q / RESOLUTION), u=u)
    (tmp_path / "arm.urdf").write_text(urdf(LINKS))
    (tmp_path / "model.toml").write_text(
        f'name = "arm"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
        '[[effect]]\nkind = "inertia"\njoint = 2\namount = { value = 0.1 }\n'
        f'[sensor]\nposition_resolution = {RESOLUTION}\n'
        '[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\n'
    )
    model = load_model(tmp_path / "model.toml")
    data = prepare([read_signals(tmp_path / "run.npz", model)], model, 64.0)
    low, high = data.ranges["inertia 2", 0]
    assert low < rotor < high


def test_noise_in_the_command_of_one_joint_is_not_blamed_on_the_others(tmp_path: Path) -> None:
    """Feedback noise at one joint shakes all others, too little to be seen in their smoothed
    positions. A complete model of a six-axis arm had been given an elastic joint for it.
    """
    import pinocchio as pin

    (tmp_path / "arm.urdf").write_text(urdf(LINKS))
    (tmp_path / "model.toml").write_text(
        f'name = "arm"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
        f'[sensor]\nposition_resolution = {RESOLUTION}\n'
        '[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\n'
    )
    arm = pin.buildModelFromXML(urdf(LINKS))
    data, r = arm.createData(), np.random.default_rng(1)
    q, v, rows, truth = np.array([0.3, 0.6, -0.9]), np.zeros(3), [], []
    for k in range(2000):
        u = pin.computeGeneralizedGravity(arm, data, q) + 9.0 * (0.5 * np.sin(k / 200) - q) - 4 * v
        u[2] += r.normal(0, 2.0)
        y = RESOLUTION * np.round(q / RESOLUTION)
        rows.append([k / RATE, *y, *u])
        before = v
        for _ in range(SUB):
            v = v + pin.aba(arm, data, q, v, u) / RATE / SUB
            q = q + v / RATE / SUB
        truth.append((v - before) * RATE)
    table = np.array(rows)
    np.savez(tmp_path / "run.npz", t=table[:, 0], q=table[:, 1:4], u=table[:, 4:])
    model = load_model(tmp_path / "model.toml")
    smoothed = prepare([read_signals(tmp_path / "run.npz", model)], model, 64.0).records[0][0]
    error = smoothed.others[:, 2].T - np.array(truth)
    assert np.all(error[50:-50].std(axis=0) < 0.1 * np.array(truth)[50:-50].std(axis=0))


def test_a_coarse_encoder_is_no_torque_of_the_next_joint(
    record: Callable[..., tuple[Model, list[Path]]], tmp_path: Path
) -> None:
    model, (path, _) = record("complete", Arm(), friction=True)
    rows, coarse = dict(np.load(path)), 16 * RESOLUTION
    rows["q"][:, 1] = coarse * np.round(rows["q"][:, 1] / coarse)
    np.savez(tmp_path / "coarse.npz", **rows)
    counts = (RESOLUTION, coarse, RESOLUTION)
    given = replace(model, sensor=replace(model.sensor, resolution=counts))
    data = prepare([read_signals(tmp_path / "coarse.npz", given)], given, 64.0)
    # fine counts: 0.0013; with its own sensor's noise alone taken off 0.0049, surely 0.0045
    assert discrepancy(data, given, 3).low < 0.0025


@pytest.mark.parametrize("rotor, noted", [(0.115, True), (0.102, False)])
def test_a_rotor_that_calibration_moves_by_what_a_link_may_weigh_is_noted(
    tmp_path: Path, rotor: float, noted: bool
) -> None:
    (tmp_path / "arm.urdf").write_text(urdf(LINKS))
    (tmp_path / "model.toml").write_text(
        f'name = "arm"\nsample_time = {1 / RATE}\n[mechanism]\nkind = "urdf"\nfile = "arm.urdf"\n'
        '[[effect]]\nkind = "inertia"\njoint = 2\namount = { value = 0.1 }\n'
        '[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\n'
    )
    given = load_model(tmp_path / "model.toml")
    notes = moved(given, set_values(given, [Handle("term", 0, "amount")], np.array([rotor])))
    assert bool(notes) == noted and all("0.1 to 0.115" in n and "payload" in n for n in notes)


@pytest.mark.usefixtures("sizes_unasked")
@pytest.mark.parametrize("stated, named", [(0.21, True), (0.285, False)])
def test_a_rotor_that_is_a_third_off_is_named_and_one_within_its_tolerance_is_not(record,
    stated: float, named: bool) -> None:  # type: ignore[no-untyped-def]
    model, paths = record("rotor", Arm(rotor=0.3), True, 4.0)
    rotor = make_term(get_effect("inertia"), 2, {"amount": stated})
    model = model.with_terms((*model.terms, rotor))
    d = zendsp.diagnose(paths[0], model, paths[1], jobs=1)
    assert [(f.effect, f.joint) for f in d.findings] == [("inertia", 2)] * named
    for f in d.findings:
        amount = f.parameters["amount"]
        assert abs(amount.value - (0.3 - stated)) < 3 * amount.std + 0.01 * 0.3
        assert {"body", "payload"} <= set(f.indistinguishable)


@pytest.mark.usefixtures("sizes_unasked")
def test_rotors_that_a_file_lacks_are_named_beside_a_link_without_inertia(record) -> None:  # type: ignore[no-untyped-def]
    """Without its rotor the wrist diverges in any simulation, and an observer sees only its
    damping.
    """
    motors = (0.3, 0.4, 0.02)
    model, paths = record("rotors", Arm(motors=motors, links=WRIST), True, 4.0)
    d = zendsp.diagnose(paths[0], model, paths[1], jobs=1)
    found = {f.joint: f.parameters["amount"] for f in d.findings if f.effect == "inertia"}
    assert len(d.findings) == len(found) == 3
    for joint, true in enumerate(motors, 1):
        assert abs(found[joint].value - true) < 3 * found[joint].std + 0.02 * true
    assert d.test is not None and d.test.improved < 0.01 * d.test.calibrated < 1.0


def test_a_rotor_that_a_file_lacks_is_the_first_step_of_a_search(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing else could be seen beside a joint that no observer can follow."""
    rotor: Any = SimpleNamespace(scored="with its rotor")
    monkeypatch.setattr(Searcher, "_rotor", lambda *_: rotor)
    monkeypatch.setattr(Searcher, "_chain", lambda _, begin: JointSearch(1, begin))
    found = Searcher.search(Searcher.__new__(Searcher), "calibrated")  # type: ignore[arg-type]
    assert [(s.chosen, s.before) for s in found.steps] == [(rotor, "calibrated")]
    assert (found.base, found.final) == ("calibrated", "with its rotor")


def test_what_calibration_moved_is_told_by_name_in_the_numbers_of_a_model_file() -> None:
    """After a law was replaced, numbers had been reported under the wrong law. A breakaway torque
    had been reported without the Coulomb level that the model file counts into it.
    """
    laws = (
        {"kind": "coulomb", "joint": 1, "level": {"value": 0.1}},
        {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.2}},
        {"kind": "stribeck", "joint": 1, "breakaway": {"value": 0.15}, "velocity": {"value": 0.1}},
    )
    rotary = {"kind": "rotary", "parameters": {"inertia": {"value": 0.01}}}
    bench = {"name": "b", "sample_time": 0.001, "mechanism": rotary, "effect": list(laws)}
    given = kernel_model(parse_model({**bench, "columns": {"position": "q", "command": "u"}}))
    moved_on = set_values(given, [Handle("term", 1, "coefficient")], np.array([0.3]))
    (note,) = moved(given, moved_on.with_terms(moved_on.terms[1:2]))
    assert note == "joint 1: calibration moves viscous coefficient 0.2 to 0.3 (+50 %)"
    stuck = set_values(given, [Handle("term", 2, "breakaway")], np.array([0.09]))
    (note,) = moved(given, stuck)
    assert "stribeck breakaway 0.15 to 0.19 (+27 %)" in note


@pytest.mark.parametrize("free", [True, False])
def test_a_gain_that_calibration_moved_is_told(free: bool) -> None:
    """Free gains of an arm fell by 7 % under the mass of a link, and no note said so."""
    rotary = {"kind": "rotary", "parameters": {"inertia": {"value": 0.01}}}
    bench = {"name": "b", "sample_time": 0.001, "mechanism": rotary}
    given = parse_model({**bench, "columns": {"position": "q", "command": "u"}})
    given = replace(given, actuator=Actuator(gain=(1.0,), gain_free=free))
    after = replace(given, actuator=Actuator(gain=(0.934,), gain_free=free))
    notes = ["joint 1: calibration moves actuator gain 1 to 0.934 (-7 %)"] if free else []
    assert moved(given, after) == notes


@pytest.mark.parametrize(
    ("ratios", "alike"),
    [
        ((1.083, 1.116, 1.077, 1.133), True),  # of a drive that gives 9 % less than it is told
        ((1.083, 1.3, 1.077, 1.133), False),  # its weight is off by itself
        ((1.05, 1.05, 1.05, 1.05), False),  # no farther than such numbers may be off together
        ((1.1, 1.1, 1.1, 0.0), False),
    ],
)
def test_one_gain_is_told_from_numbers_that_are_each_off_by_their_tolerance(
    ratios: tuple[float, ...], alike: bool
) -> None:
    """No two of the given numbers are off by the same: those of a gain differed by 6 %."""
    given = _pendulum()
    notes = moved(given, _times(given, ratios))
    assert ("all alike, as a torque gain of" in notes[0]) is alike
    factor = one_factor(given, _times(given, ratios), 1)
    assert (factor is not None) is alike
    if factor is not None:
        assert (round(factor.value, 2), round(factor.std, 3)) == (1.1, 0.025)


def test_numbers_that_a_headline_calls_off_are_told_however_little_each_moved() -> None:
    given = _pendulum()
    after = _times(given, (0.986, 1.0, 1.0031, 1.02))
    assert moved(given, after) == []
    (note,) = moved(given, after, off=True)
    assert "inertia 0.5 to 0.493 (-1 %), coulomb level 1.5 to 1.505 (+0.3 %), viscous" in note
    unsure = _times(given, (0.986, 1.0, 1.0031, 1.02), std=0.1)  # each, but not all of them
    assert moved(given, unsure, off=True) == [note]


def _pendulum() -> Model:
    rotary = {"kind": "rotary", "parameters": {"inertia": 0.5, "gravity": 10.0}}
    laws = (
        {"kind": "coulomb", "joint": 1, "level": 1.5},
        {"kind": "viscous", "joint": 1, "coefficient": 0.4},
    )
    bench = {"name": "b", "sample_time": 0.001, "mechanism": rotary, "effect": list(laws)}
    return kernel_model(parse_model({**bench, "columns": {"position": "q", "command": "u"}}))


def _times(given: Model, ratios: Sequence[float], std: float = 0.0) -> Model:
    """The four numbers of a pendulum, each times a ratio, with a relative standard deviation."""

    def after(q: Quantity, ratio: float) -> Quantity:
        return replace(q, value=ratio * q.value, std=std * q.value)

    own, laws = dict(given.mechanism), list(given.terms)
    for key, ratio in zip(("inertia", "gravity"), ratios[:2], strict=True):
        own[key] = (after(own[key][0], ratio),)
    for i, (key, ratio) in enumerate(zip(("level", "coefficient"), ratios[2:], strict=True)):
        laws[i] = replace(laws[i], parameters={key: after(laws[i].parameters[key], ratio)})
    return replace(given, mechanism=own, terms=tuple(laws))


@pytest.mark.parametrize("std, price", [(0.0, True), (0.036, False)])
def test_a_figure_that_the_model_calls_rough_is_calibrated_at_no_price(
    std: float, price: bool
) -> None:
    """From 0.29 to 0.24, a change of 17 %."""
    found: Any = SimpleNamespace(
        hypothesis=Hypothesis("calibration", free=("p3",), cost=9.0), values=np.array([-0.05])
    )
    solver: Any = SimpleNamespace(
        limits=LIMITS,
        layout=SimpleNamespace(given=np.array([0.29]), given_std=np.array([std])),
    )
    assert (price_of(found, solver) > 0.0) == price
