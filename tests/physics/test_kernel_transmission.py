"""The compiled kernel with springs and gaps between motor and load, against differential equations
integrated elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from integrated import STIFF, TANH, J, N, State, T, command, integrate, kernel, recorded, rigid
from scipy.optimize import brentq

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.physics.calibration.predict import run
from zendsp.physics.files.model_file import parse_model


def test_elastic_joint_is_two_inertias() -> None:
    k, c, load = 30.0, 0.05, 0.004

    def derivative(x: State, _t: float, u: float) -> State:
        spring = k * (x[0] - x[2]) + c * (x[1] - x[3])
        return x[1], (u - spring) / (J - load), x[3], spring / load

    true, without = integrate(derivative, 4)[:, 0], rigid(lambda *_: 0.0)
    got = kernel(
        true,
        [{"kind": "elasticity", "joint": 1, "stiffness": k, "damping": c, "load_inertia": load}],
        8,
    )
    assert np.max(np.abs(got - true)) < 0.05 * np.max(np.abs(true - without))


def test_a_stiffening_spring_is_harder_the_more_it_is_bent() -> None:
    k, k3, load = 8.0, 2.0e4, 0.004  # bent by 11 mrad: a quarter of the torque is the cubic term's
    c = 0.1 * math.sqrt(k * load)

    def derivative(k3: float) -> Callable[[State, float, float], State]:
        def rate(x: State, _t: float, u: float) -> State:
            d = x[0] - x[2]
            spring = k * d + k3 * d**3 + c * (x[1] - x[3])
            return x[1], (u - spring) / (J - load), x[3], spring / load

        return rate

    true, straight = integrate(derivative(k3), 4)[:, 0], integrate(derivative(0.0), 4)[:, 0]
    term = {
        "kind": "stiffening",
        "joint": 1,
        "stiffness": k,
        "stiffness3": k3,
        "load_inertia": load,
    }
    size = np.max(np.abs(true - straight))
    # what is left is how far the spring is thought to be bent when the recording begins
    assert np.max(np.abs(kernel(true, [term], 8) - true)) < 0.03 * size


@pytest.mark.parametrize("side", ["motor", "load"])
def test_a_spring_that_rings_when_a_recording_begins_is_no_missing_torque(side: str) -> None:
    """The last third of a recording begins in motion: with the true model of a joint whose load
    rang 5.75 mrad were unexplained there, 0.13 since the start of the load is fitted.
    """
    k, c, load = 20.0, 0.01, 0.006  # of which 2J/c are 1.2 s

    def derivative(x: State, _t: float, u: float) -> State:
        spring = k * (x[0] - x[2]) + c * (x[1] - x[3])
        return x[1], (u - spring) / (J - load), x[3], spring / load

    true = integrate(derivative, 4)[:, 0 if side == "motor" else 2]
    term = {
        "kind": "elasticity", "joint": 1, "stiffness": k, "damping": c, "load_inertia": load
    }  # fmt: skip
    model = parse_model(
        {
            "sample_time": T,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": J}},
            "sensor": {"side": side},
            "effect": [term],
        }
    )
    off = []
    for begin in (0, N // 2 + 60):  # from rest, and in motion
        t = np.arange(N - begin) * T
        seen, u = (x[begin:, np.newaxis] for x in (true, command()))
        read = Signals("run", t, T, seen, u, None, np.full(1, 1e-6))
        record = prepare([read], model, 64.0).records[0][0]
        r = run(record, model, 16.0, inner=8, begun=True).innovations
        off.append(float(np.sqrt(np.mean(r**2))))
    assert off[1] < 3.0 * off[0]


def test_a_load_that_rings_behind_a_motor_that_sticks_bends_no_number_of_a_fit() -> None:
    """Let go with its spring unbent, a load swung while dry friction held the motor; a fit that
    began with it hanging still made the damping of an arm's joint six times too large.
    """
    k, c, load, level, weight, at = 60.0, 0.02, 0.006, 0.16, 0.1, 0.8

    def derivative(x: State, _t: float, u: float) -> State:
        spring = k * (x[0] - x[2]) + c * (x[1] - x[3])
        rub = level * math.tanh(x[1] / TANH)
        pull = weight * math.sin(at + x[2])
        return x[1], (u - spring - rub) / (J - load), x[3], (spring - pull) / load

    true = at + integrate(derivative, 4, sub=STIFF)[:, 0]
    assert np.ptp(true[:20]) < 1e-4 < np.ptp(true)
    terms = [
        {"kind": "coulomb", "level": {"value": 0.9 * level}},
        {
            "kind": "elasticity", "stiffness": {"value": 1.2 * k}, "damping": {"value": 2 * c},
            "load_inertia": {"value": 0.9 * load},
        },
    ]  # fmt: skip
    model = parse_model(
        {
            "sample_time": T,
            "mechanism": {
                "kind": "rotary",
                "parameters": {"inertia": {"value": J}, "gravity": {"value": weight}},
            },
            "effect": [{"joint": 1, **term} for term in terms],
        }
    )
    t, q, u = np.arange(N) * T, true[:, np.newaxis], command()[:, np.newaxis]
    data = prepare([Signals("run", t, T, q, u, None, np.full(1, 1e-5))], model, 64.0)
    fitted = calibrate_joint(data, model, 1).model
    friction, spring = fitted.terms
    assert friction.value("level") == pytest.approx(level, rel=0.001)
    assert spring.value("stiffness") == pytest.approx(k, rel=0.003)
    assert spring.value("damping") == pytest.approx(c, rel=0.04)


ORDER, ERROR, PHASE, WEIGHT, ROTOR = 3.0, 0.02, 0.4, 0.2, 0.003


def uneven(x: float) -> tuple[float, float, float]:
    """Load position behind a motor at x, and its first two derivatives by it."""
    at = ORDER * x + PHASE
    return (
        x + ERROR * math.sin(at),
        1 + ERROR * ORDER * math.cos(at),
        -ERROR * ORDER**2 * math.sin(at),
    )


@pytest.mark.parametrize("side", ["motor", "load"])
@pytest.mark.parametrize("elastic", [False, True])
def test_the_load_turns_unevenly_behind_a_transmission_with_an_error(
    side: str, elastic: bool
) -> None:
    k, c, load = 60.0, 0.08, 0.006
    terms: list[dict[str, Any]] = [
        {"kind": "transmission_error", "order": ORDER, "amplitude": ERROR, "phase": PHASE}
    ]
    if elastic:
        terms.append({"kind": "elasticity", "stiffness": k, "damping": c, "load_inertia": load})
    else:
        terms.append({"kind": "inertia", "amount": ROTOR})

    def stiff(x: State, _t: float, u: float) -> State:  # by Lagrange, one coordinate
        at, slope, bend = uneven(x[0])
        inert = J * slope * slope + ROTOR
        return (x[1], (u - J * slope * bend * x[1] ** 2 - slope * WEIGHT * math.sin(at)) / inert)

    def springy(x: State, _t: float, u: float) -> State:
        at, slope, _ = uneven(x[0])
        pull = k * (at - x[2]) + c * (slope * x[1] - x[3])
        return x[1], (u - slope * pull) / (J - load), x[3], (pull - WEIGHT * math.sin(x[2])) / load

    if elastic:
        # of the motor where the load hangs down
        hanging = float(brentq(lambda x: uneven(x)[0], -0.1, 0.1))
        true = integrate(springy, 4, start=hanging)[:, 0 if side == "motor" else 2]
        even = integrate(lambda x, t, u: springy_even(x, u, k, c, load), 4)[
            :, 0 if side == "motor" else 2
        ]
    else:
        motor = integrate(stiff, 2)[:, 0]
        true = motor if side == "motor" else motor + ERROR * np.sin(ORDER * motor + PHASE)
        even = rigid(lambda q, v, t, u: WEIGHT * math.sin(q), inertia=J + ROTOR)
    got = kernel(true, terms, 16, gravity=WEIGHT, sensor={"side": side})
    size = np.max(np.abs(true - even))
    assert np.max(np.abs(got - true)) < 0.05 * size


def springy_even(x: State, u: float, k: float, c: float, load: float) -> State:
    """Two inertias and a pendulum's weight on the second, without an error between them."""
    pull = k * (x[0] - x[2]) + c * (x[1] - x[3])
    return x[1], (u - pull) / (J - load), x[3], (pull - WEIGHT * math.sin(x[2])) / load


def test_weights_and_springs_to_the_frame_pull_at_the_load_beyond_a_spring() -> None:
    k, c, load, hold, pull = 12.0, 0.01, 0.004, 0.6, 0.3

    def derivative(beyond: bool) -> Callable[[State, float, float], State]:
        def rate(x: State, _t: float, u: float) -> State:
            spring = k * (x[0] - x[2]) + c * (x[1] - x[3])
            at = x[2] if beyond else x[0]
            held = hold * at + pull * math.sin(at)
            motor, moved = (0.0, held) if beyond else (held, 0.0)
            return (x[1], (u - spring - motor) / (J - load), x[3], (spring - moved) / load)

        return rate

    true, before = (integrate(derivative(beyond), 4)[:, 0] for beyond in (True, False))
    terms = [
        {"kind": "elasticity", "joint": 1, "stiffness": k, "damping": c, "load_inertia": load},
        {"kind": "stiffness", "joint": 1, "coefficient": hold, "neutral": 0.0},
        {"kind": "gravity", "joint": 1, "torque": pull, "angle": 0.0},
    ]
    assert np.max(np.abs(kernel(true, terms, 8) - true)) < 0.05 * np.max(np.abs(true - before))


def test_backlash_lets_the_motor_move_alone() -> None:
    k, load, gap = 40.0, 0.004, 0.05
    c = 0.1 * math.sqrt(k * load)

    def derivative(x: State, _t: float, u: float) -> State:
        d = x[0] - x[2]
        over = d - 0.5 * gap if d > 0.5 * gap else d + 0.5 * gap if d < -0.5 * gap else 0.0
        force = k * over + (c * (x[1] - x[3]) if over else 0.0)
        return x[1], (u - force) / (J - load), x[3], force / load

    true, without = integrate(derivative, 4)[:, 0], rigid(lambda *_: 0.0)
    got = kernel(
        true,
        [{"kind": "backlash", "joint": 1, "gap": gap, "stiffness": k, "load_inertia": load}],
        16,
    )
    # impacts spread small differences: what must agree is the motion up to the third reversal
    early = slice(0, 500)
    assert np.max(np.abs(got - true)[early]) < 0.15 * np.max(np.abs(true - without)[early])


def test_a_spring_is_bent_already_when_a_recording_begins_in_the_middle() -> None:
    k, c, load = 15.0, 0.2, 0.004  # damped, so that its own ringing is over

    def derivative(x: State, _t: float, u: float) -> State:
        force = k * (x[0] - x[2]) + c * (x[1] - x[3])
        return x[1], (u - force) / (J - load), x[3], force / load

    true, begin = integrate(derivative, 4), 200
    term = {"kind": "elasticity", "joint": 1, "stiffness": k, "damping": c, "load_inertia": load}
    model = parse_model(
        {
            "mechanism": {"kind": "rotary", "parameters": {"inertia": J}},
            "effect": [term],
            "sample_time": T,
        }
    )
    later = np.ascontiguousarray(true[begin:, :1])
    record = prepare(
        [
            Signals(
                "later",
                np.arange(N - begin) * T,
                T,
                later,
                command()[begin:, None],
                None,
                np.zeros(1),
            )
        ],
        model,
    ).records[0][0]
    # the smoother's guess of the first speed is not what is tested here
    record.motion.states[:2] = true[begin:, :2].T
    early = slice(0, 100)
    off = np.abs(run(record, model, 16.0, inner=8, free_every=N).innovations[early])
    bend = np.abs(true[begin, 0] - true[begin, 2])
    assert np.max(off) < 0.15 * bend


def test_no_spring_is_bent_where_a_recording_begins_at_rest() -> None:
    k, load, push = 15.0, 0.006, 0.1  # a load that rings for long
    rows, steps = 500, 10
    command, x, true = np.full(rows, push), np.zeros(4), []
    for _ in range(rows):
        true.append(x[0])
        for _ in range(steps):  # motor, its speed, load, its speed
            force = k * (x[0] - x[2])
            x[1] += T / steps * (push - force) / (J - load)
            x[3] += T / steps * force / load
            x[0], x[2] = x[0] + T / steps * x[1], x[2] + T / steps * x[3]
    term = {"kind": "elasticity", "joint": 1, "stiffness": k, "damping": 0, "load_inertia": load}
    mechanism = {"kind": "rotary", "parameters": {"inertia": J}}
    model = parse_model({"mechanism": mechanism, "effect": [term], "sample_time": T})
    seen = np.array(true)[:, None]
    signals = Signals("step", np.arange(rows) * T, T, seen, command[:, None], None, np.zeros(1))
    record = prepare([signals], model).records[0][0]
    off = run(record, model, 16.0, inner=8, free_every=rows).innovations
    static = push * load / J / k
    assert np.ptp(off - np.polyval(np.polyfit(np.arange(rows), off, 1), np.arange(rows))) < (
        0.2 * static
    )


def test_the_load_of_a_single_joint_hangs_where_it_is_in_a_urdf_too(tmp_path: Path) -> None:
    k, c, load, weight = 8.0, 0.02, 0.008, 0.6  # its own weight bends the spring by up to 75 mrad

    def derivative(x: State, _t: float, u: float) -> State:
        spring = k * (x[0] - x[2]) + c * (x[1] - x[3])
        falls = spring - weight * math.sin(x[2])
        return x[1], (u - spring) / (J - load), x[3], falls / load

    true = integrate(derivative, 4)[:, 0]
    spring = {"kind": "elasticity", "joint": 1, "stiffness": k, "damping": c, "load_inertia": load}
    model, record = recorded(true, [spring], J, weight)
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.1"/>'
        f'<mass value="{weight / 0.981}"/><inertia ixx="1e-9" iyy="{load - weight / 98.1}"'
        ' izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="revolute">'
        '<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="99" velocity="99"/></joint></robot>'
    )
    rotor = {"kind": "inertia", "joint": 1, "amount": J - load}
    mechanism = {"kind": "urdf", "file": str(tmp_path / "arm.urdf")}
    tree = parse_model({"sample_time": T, "mechanism": mechanism, "effect": [rotor, spring]})
    signals = Signals(
        "run", np.arange(N) * T, T, record.position[:, None], command()[:, None], None, np.zeros(1)
    )
    own = prepare([signals], tree, 64.0).records[0][0]
    errors = [
        float(np.std(run(r, m, 64.0).innovations)) for r, m in ((record, model), (own, tree))
    ]
    assert errors[1] < 3.0 * errors[0]  # hung from the motor: 84 times
