"""Unusual but right recordings are accepted, and what is done to them is reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from acceptance import accepted
from reality import KNOWN, RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.data import checks
from zendsp.diagnosis.data.checks import check_motion, check_signals
from zendsp.diagnosis.data.inertia import with_its_scale
from zendsp.diagnosis.data.plausibility import DRIVES, check_driven
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.regression import _blurred, look, regress, rigid_body
from zendsp.diagnosis.data.signals import Signals
from zendsp.errors import RecordingError
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.physics.simulation.control import simulate_loop
from zendsp.physics.term_numbers import kernel_model

Columns = dict[str, np.ndarray]

UNUSUAL = {
    "saturated at the stated limit": (reality.Machine(limit=0.25), {}),
    "a spring that is not in the model": (reality.Machine(spring=1.5), {}),
    "a pendulum whose gravity is not in the model": (reality.Machine(gravity=0.5), {"size": 1.5}),
    "friction ten times the model's": (reality.Machine(coulomb=0.3, kp=20.0, kd=0.4), {}),
    "slow and coarse": (reality.Machine(resolution=2 * np.pi / 2048), {"size": 0.12, "high": 0.8}),
    "twice the inertia": (reality.Machine(inertia=0.02), {}),
    "late by two samples": (reality.Machine(delay=0.004), {"high": 8.0}),
    "a coarse sensor in fast motion": (reality.Machine(resolution=2 * np.pi / 1024), {"high": 8.0}),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_but_right_recordings_are_accepted(name: str, tmp_path: Path) -> None:
    machine, reference = UNUSUAL[name]
    columns = reality.simulate(machine, reality.multisine(10.0, RATE, 3, **reference), RATE)
    model = reality.model_file(tmp_path / "model.toml", RATE, *KNOWN, resolution=machine.resolution)
    if machine.limit < 3.0:
        model.write_text(model.read_text().replace("limit = 3.0", f"limit = {machine.limit}"))
    accepted(reality.save(tmp_path / "run.csv", columns), model)


def test_a_free_swing_is_accepted_and_one_about_the_upright_is_not(
    tmp_path: Path, refuse: Callable[..., str]
) -> None:
    machine = reality.Machine(kp=0.0, kd=0.0, gravity=0.4, coulomb=0.001, viscous=0.001)
    swing = reality.simulate(machine, np.r_[1.2, np.zeros(4999)], RATE)
    text = reality.model_file(
        tmp_path / "model.toml", RATE, reality.effect("viscous", coefficient=0.001), gravity=0.4
    ).read_text()
    model = tmp_path / "free.toml"
    model.write_text(
        "\n".join(
            line for line in text.splitlines() if not line.startswith(("command", "reference"))
        )
    )
    swung = reality.save(tmp_path / "swing.csv", {"t": swing["t"], "q": swing["q"]})
    assert any("names no command" in note for note in accepted(swung, model))
    upright = reality.save(tmp_path / "upright.csv", {"t": swing["t"], "q": swing["q"] - np.pi})
    assert "hanging down" in refuse(upright, "--model", model)
    degrees = reality.save(tmp_path / "degrees.csv", {"t": swing["t"], "q": np.degrees(swing["q"])})
    assert "degrees" in refuse(degrees, "--model", model)


def test_a_note_that_holds_for_several_recordings_is_printed_once(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    milli = {"t_ms": 1e3 * good["t"], **{k: v for k, v in good.items() if k != "t"}}
    text = model.read_text()
    assert 'time = "t"' in text
    model.write_text(text.replace('time = "t"', 'time = "t_ms"'))
    given = kernel_model(load_model(model))
    both = [read_signals(reality.save(tmp_path / f"{n}.csv", milli), given) for n in (1, 2)]
    assert check_signals(both, given).count("t_ms: ms converted to s") == 1


def test_a_hardly_driven_joint_is_not_taken_to_be_in_degrees(tmp_path: Path) -> None:
    free = reality.simulate(
        reality.Machine(kp=0.0, kd=0.0, gravity=0.4, coulomb=0.001, viscous=0.002),
        np.r_[1.2, np.zeros(4999)],
        RATE,
    )
    speed = np.gradient(free["q"], 1.0 / RATE)
    compensation = 0.001 * np.tanh(speed / 0.1) + 2e-4 * np.random.default_rng(0).standard_normal(
        len(speed)
    )
    model = reality.model_file(
        tmp_path / "model.toml", RATE, reality.effect("viscous", coefficient=0.002), gravity=0.4
    )
    accepted(
        reality.save(
            tmp_path / "hardly.csv",
            {"t": free["t"], "q": free["q"], "u": compensation, "r": 0 * speed},
        ),
        model,
    )


def swings(seed: int) -> np.ndarray:
    """Angle, speed and acceleration over twelve seconds at 250 Hz, (3, n)."""
    rng, t = np.random.default_rng(seed), np.arange(3000) / 250.0
    w = 2 * np.pi * rng.uniform(0.2, 1.2, 5)
    phase = np.outer(t, w) + rng.uniform(0, 2 * np.pi, 5)
    own = np.sin(phase), np.cos(phase) * w, -np.sin(phase) * w**2
    return np.stack([x.sum(axis=1) / 5 for x in own])


def swinging(
    own: tuple[float, float, float],
    lengths: tuple[float, float],
    rotors: tuple[float, float],
    mass: float,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and torques of a flat arm with a mass at its end, whose second joint swings against
    its first; ``own`` are p1, p2, p3 without the mass.
    """
    p1, p2, p3 = own
    l1, l2 = lengths
    q1 = 0.8 * swings(seed)
    q2 = 0.1 * swings(seed + 1) - 0.7 * q1
    m1, m2 = p1 + rotors[0] + mass * (l1**2 + l2**2), p2 + mass * l2**2
    c, s = (f(q2[0]) * (p3 + mass * l1 * l2) for f in (np.cos, np.sin))
    coriolis = s * q2[1] * (2 * q1[1] + q2[1])
    first = (m1 + 2 * c) * q1[2] + (m2 + c) * q2[2] - coriolis
    second = (m2 + c) * q1[2] + (m2 + rotors[1]) * q2[2] + s * q1[1] ** 2 + 0.1 * q2[1]
    return np.stack([q1[0], q2[0]], axis=1), np.stack([first, second], axis=1)


@pytest.mark.parametrize("tool", [1.0, 3.0])
def test_a_tool_that_pulls_against_the_links_own_inertia_is_no_bad_recording(tool: float) -> None:
    """The second of two links swings against the first; most of its inertia is its motor's. With
    the second command's sign flipped, or from another run, the recording is refused.
    """
    p1, p2, p3, l1, l2, rotor = 1.0, 0.02, 0.005, 0.5, 0.3, 0.2
    model = parse_model(
        {
            "sample_time": 0.004,
            "mechanism": {
                "kind": "planar2r",
                "parameters": {"p1": p1, "p2": p2, "p3": p3, "l1": l1, "l2": l2},
            },
            "effect": [{"kind": "inertia", "joint": 2, "amount": rotor}],
        }
    )

    def run(mass: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
        return swinging((p1, p2, p3), (l1, l2), (0.0, rotor), mass, seed)

    def looked_at(angles: np.ndarray, command: np.ndarray) -> None:
        t = np.arange(len(angles)) * 0.004
        signals = Signals("run", t, 0.004, angles, command, None, np.full(2, 1e-5))
        check_driven(["joint 1", "joint 2"], prepare([signals], model, 64.0).records[0], model)

    looked_at(*run(tool))
    angles, command = run(0.0)
    with pytest.raises(RecordingError, match="sign"):
        looked_at(angles, command * [1.0, -1.0])
    with pytest.raises(RecordingError, match="different runs"):
        looked_at(angles, np.stack([command[:, 0], run(0.0, seed=6)[1][:, 1]], axis=1))


def test_a_chirp_through_the_resonance_of_a_soft_shaft_is_of_one_run() -> None:
    """A shaft of 9 Hz, driven up to 18, was "of different runs", even with its spring given."""
    rate, seconds = 500.0, 16.0
    t = np.arange(0.0, seconds, 1.0 / rate)
    sweep = 1.5 * np.sin(2.0 * np.pi * (0.2 * t + (18.0 - 0.2) * t**2 / 2.0 / seconds))
    machine = reality.Machine(soft=30.0, load=0.006, kp=3.0, kd=0.05, limit=10.0)
    columns = reality.simulate(machine, sweep, rate)
    model = model_of(VISCOUS, COULOMB, rate=rate)
    check_driven(["run"], data_of(columns, model, rate).records[0], model)
    other = {**columns, "u": np.roll(columns["u"], 1234)}
    with pytest.raises(RecordingError, match="different runs"):
        check_driven(["run"], data_of(other, model, rate).records[0], model)


def test_a_joint_with_hardly_any_torque_is_not_taken_to_be_in_degrees() -> None:
    """Such as the shoulder of an acrobot, which its elbow moves. Where neither joint agrees, both
    are in degrees.
    """
    p1, p2, p3, l1, l2 = 0.6, 0.2, 0.05, 0.5, 0.3
    mechanism = {"p1": p1, "p2": p2, "p3": p3, "l1": l1, "l2": l2}
    model = parse_model(
        {"sample_time": 0.004, "mechanism": {"kind": "planar2r", "parameters": mechanism}}
    )
    angles, command = swinging((p1, p2, p3), (l1, l2), (0.0, 0.0), 0.0, 1)

    def looked_at(command: np.ndarray) -> None:
        t = np.arange(len(angles)) * 0.004
        signals = Signals("run", t, 0.004, angles, command, None, np.full(2, 1e-5))
        check_driven(["joint 1", "joint 2"], prepare([signals], model, 64.0).records[0], model)

    looked_at(command / [np.degrees(1.0), 1.0])
    with pytest.raises(RecordingError, match="degrees"):
        looked_at(command / np.degrees(1.0))


def test_a_joint_that_its_controller_holds_while_another_swings_is_no_bad_recording() -> None:
    """As in a frequency response of joint 1: the command of joint 2 is that of its controller and
    looks like negative friction.
    """
    model = load_model("imi_planar.toml")
    tones = np.linspace(0.5, 30.0, 22)[:, None]
    t = np.arange(5000) * 0.001
    phases = np.random.default_rng(1).uniform(0.0, 2 * np.pi, (22, 1))
    swing = 0.004 * np.sin(2 * np.pi * tones * t + phases).sum(axis=0)
    run = simulate_loop(model, np.stack([swing, np.zeros(5000)], axis=1))
    signals = Signals("run", t, 0.001, run["q"], run["tau"], None, np.full(2, 4e-5))
    check_driven(["joint 1", "joint 2"], prepare([signals], model, 64.0).records[0], model)


def test_a_joint_that_is_held_against_its_weight_is_no_bad_recording(tmp_path: Path) -> None:
    """The command is that of a PD controller plus the weight of the links, as in most arms."""
    link = (
        '<link name="{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/><inertia ixx="0.01"'
        ' iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="to_{0}"'
        ' type="revolute"><parent link="{3}"/><child link="{0}"/><origin xyz="0 0 {4}"/><axis'
        ' xyz="0 1 0"/><limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
    )
    links = link.format("upper", -0.2, 2, "base", 0)
    links += link.format("fore", -0.15, 1.2, "upper", -0.4)
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/>{links}</robot>')
    mechanism = {"kind": "urdf", "file": str(tmp_path / "arm.urdf")}
    motor = {"kind": "inertia", "joint": 2, "amount": 0.01}
    model = parse_model({"sample_time": 0.001, "mechanism": mechanism, "effect": [motor]})
    own, lever, weight = 0.01 + 1.2 * 0.15**2, 1.2 * 0.4 * 0.15, 1.2 * 0.15 * 9.81
    t = np.arange(9000) * 0.001
    tones, phases = np.linspace(0.1, 1.6, 9), np.random.default_rng(1).uniform(0.0, 6.28, 9)
    turns = 2 * np.pi * tones
    swing, spin, push = (
        (0.08 * turns**k * np.sin(turns * t[:, None] + phases + k * np.pi / 2)).sum(axis=1)
        for k in range(3)
    )
    angle = speed = 0.0
    rows = []
    for q1, v1, a1 in zip(swing, spin, push, strict=True):
        held = -30.0 * angle - 2.0 * speed + weight * np.sin(q1 + angle)
        rows.append((angle, held))
        coupled = (own + lever * np.cos(angle)) * a1 + lever * np.sin(angle) * v1**2
        rubs = 0.25 * np.tanh(speed / 0.002) + 0.15 * speed
        free = held - rubs - weight * np.sin(q1 + angle) - coupled
        speed += 0.001 * free / (own + 0.01)
        angle += 0.001 * speed
    fore = np.array(rows)
    angles = 1e-5 * np.round(np.stack([swing, fore[:, 0]], axis=1) / 1e-5)
    command = np.stack([np.zeros(9000), fore[:, 1]], axis=1)

    def held(command: np.ndarray) -> bool:
        slow = look(angles.T, command.T, 0.001, np.full(2, 3e-6))
        found = regress(slow, model, 2, rigid_body(slow, model))
        assert found is not None and abs(found.friction) > DRIVES, "as if it drove"
        return found.held

    assert held(command)
    assert not held(-command), "nobody holds a joint by doubling its weight"


def test_a_tool_as_heavy_as_a_light_arm_is_no_gear_ratio(tmp_path: Path) -> None:
    """Both inertias are about ten times the model's. A forgotten gear ratio of ten is refused."""
    link = (
        '<link name="{0}"><inertial><mass value="0.2"/><inertia ixx="1e-3" iyy="1e-3" izz="{1}"'
        ' ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="to_{0}" type="revolute"><parent'
        ' link="{2}"/><child link="{0}"/><origin xyz="{3} 0 0"/><axis xyz="0 0 1"/><limit'
        ' lower="-9" upper="9" effort="9" velocity="9"/></joint>'
    )
    links = link.format("upper", 0.001, "base", 0) + link.format("fore", 0.01, "upper", 0.2)
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/>{links}</robot>')
    mechanism = {"kind": "urdf", "file": str(tmp_path / "arm.urdf")}
    model = parse_model({"sample_time": 0.004, "mechanism": mechanism})
    own = 0.001 + 0.01 + 0.2 * 0.2**2, 0.01, 0.0

    def looked_at(mass: float, gear: float = 1.0) -> None:
        angles, torque = swinging(own, (0.2, 0.5), (0.0, 0.0), mass, 1)
        t = np.arange(len(angles)) * 0.004
        signals = Signals("run", t, 0.004, angles, gear * torque, None, np.full(2, 1e-5))
        check_driven(["joint 1", "joint 2"], prepare([signals], model, 64.0).records[0], model)

    looked_at(0.35)
    with pytest.raises(RecordingError, match="gear ratio"):
        looked_at(0.0, gear=10.0)


def test_the_sign_of_a_command_is_judged_where_the_motion_is_liveliest(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    monkeypatch.setattr(checks, "check_driven", lambda *_, signs: seen.append(signs))
    monkeypatch.setattr(checks, "check_caused", lambda *_: None)
    parts = [
        SimpleNamespace(
            command=np.sin(np.arange(9.0)),
            motion=SimpleNamespace(states=[None, speed * np.sin(np.arange(9.0))]),
            recording=name,
            joint=1,
        )
        for name, speed in (("a", 1.0), ("a", 0.1), ("b", 0.2))
    ]
    data: Any = SimpleNamespace(records=[[part] for part in parts])
    check_motion(data, SimpleNamespace(columns={}), ["a (first)", "a (last)", "b"])  # type: ignore[arg-type]
    assert seen == [True, False, True]


def test_a_joint_without_a_drive_is_accepted_beside_a_driven_one(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.setattr(checks, "check_driven", lambda where, *_, signs: seen.extend(where))
    monkeypatch.setattr(checks, "check_caused", lambda *_: None)
    motion = SimpleNamespace(states=np.zeros((3, 9)))
    monkeypatch.setattr(checks, "_let_go", lambda _: False)
    pushed, silent = (
        SimpleNamespace(command=c, motion=motion, recording="run")
        for c in (np.sin(np.arange(9.0)), np.zeros(9))
    )
    model: Any = SimpleNamespace(columns={"command": "tau"})
    for k, record in enumerate((pushed, silent), 1):
        record.joint = k
    cart_and_pole: Any = SimpleNamespace(records=[[pushed, silent]])
    check_motion(cart_and_pole, model, ["run"])
    assert seen == ["run: joint 1", "run: joint 2"]
    pole: Any = SimpleNamespace(records=[[silent, silent]])
    with pytest.raises(RecordingError, match="zero throughout"):
        check_motion(pole, model, ["run"])


@pytest.mark.parametrize(
    ("speed", "free"),
    [
        (lambda t: np.exp(-0.3 * t) * np.sin(5.0 * t), True),  # a pendulum
        (lambda t: 8.0 - t, True),  # a wheel that was turned
        (lambda t: np.sin(4.0 * t) * np.minimum(t, 2.0) * np.exp(-0.1 * t), False),
        (lambda t: 1.0 + t, False),
    ],
)
def test_a_command_of_zeros_is_taken_for_none_where_the_joint_moves_as_one_that_was_let_go(
    speed: Callable[[np.ndarray], np.ndarray], free: bool
) -> None:
    """Free decays with a logged command of 0 were refused."""
    t = np.arange(0.0, 6.0, 0.005)
    motion = SimpleNamespace(states=np.stack([t, speed(t), t]))
    assert checks._let_go(SimpleNamespace(motion=motion)) is free  # type: ignore[arg-type]


def test_the_inertia_of_what_nothing_drives_is_held_and_its_scale_said() -> None:
    """Free, it drifted: a Coulomb friction was unknown, and a complete pendulum not told."""
    given = model_of(VISCOUS)
    held, notes = with_its_scale(given, [1])
    assert not held.mechanism["inertia"][0].free and "only ratios to its inertia" in notes[0]
    assert with_its_scale(given, []) == (given, [])
    assert with_its_scale(held, [1]) == (held, [])


@pytest.mark.parametrize(("second", "told"), [(0.0, False), (0.3, True)])
def test_a_single_sine_accuses_no_inertia_that_a_spring_explains(second: float, told: bool) -> None:
    """A motion of `joint_pd.c` had been refused for an inertia of 0.085 of the model's."""
    t, random = np.arange(10000) / 500.0, np.random.default_rng(3)
    parts = ((0.1, 3.0), (0.1 * second, 11.0))
    q = sum(size * np.sin(w * t) for size, w in parts)
    qdd = sum(-size * w**2 * np.sin(w * t) for size, w in parts)
    noise = 2e-4
    y = (q + random.normal(0.0, noise, len(t)))[np.newaxis]
    u = (0.01 * qdd + random.normal(0.0, 1e-3, len(t)))[np.newaxis]
    model = parse_model(
        {"mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": 0.01}}}}
    )
    slow = look(y, u, 0.002, np.array([noise]))
    found = regress(slow, model, 1, rigid_body(slow, model))
    assert found is not None
    assert (found.error < 0.1) == told
    assert (abs(found.slope - 1.0) < 0.1) == told


def test_the_noise_of_a_resting_joint_causes_no_overflow() -> None:
    """A user had seen "overflow encountered in scalar power"."""
    columns = np.random.default_rng(0).normal(size=(50, 3))
    with np.errstate(all="raise"):
        assert _blurred(columns, 1e200) and not _blurred(columns, 1e-200)


@pytest.mark.parametrize("driven_elsewhere", [True, False])
def test_a_constant_command_is_refused_only_where_no_recording_drives_the_joint(
    driven_elsewhere: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint that rests in one recording may have a constant command there."""

    def record(joint: int, run: str, *command: float) -> Any:
        states = (np.zeros(2), np.array([0.0, 1.0]), np.zeros(2))
        return SimpleNamespace(
            joint=joint, recording=run, command=np.array(command),
            motion=SimpleNamespace(states=states),
        )  # fmt: skip

    monkeypatch.setattr(checks, "check_driven", lambda *_, **__: None)
    monkeypatch.setattr(checks, "check_caused", lambda *_: None)
    other = record(2, "b", -0.007, 0.1 if driven_elsewhere else -0.007)
    data: Any = SimpleNamespace(
        records=((record(1, "a", 0.0, 1.0), record(2, "a", -0.007, -0.007)),
                 (record(1, "b", 0.0, 1.0), other))
    )  # fmt: skip
    model: Any = SimpleNamespace(columns={"command": "u"})
    if driven_elsewhere:
        check_motion(data, model, ["a", "b"])
    else:
        with pytest.raises(RecordingError, match="joint 2: the command is constant"):
            check_motion(data, model, ["a", "b"])
