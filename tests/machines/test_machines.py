"""The three plants: rigid-body terms against Pinocchio, step-size convergence, friction, drives,
electrics.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plants import OFF, VELOCITY, Plant, follow

from zendsp.reference import load_machine
from zendsp_isr.build import build, source_root
from zendsp_isr.parts import build_machine, machine_names
from zendsp_protocol.errors import CompileFailed

Array = np.ndarray  # type: ignore[type-arg]
# a pose of the WAM in the middle of its range, rad
UP = np.array([0.0, 0.5, 0.0, 1.5, -1.5, 0.0, 0.0])

SHIM = b"""
#include "wam7_dynamics.h"
#define arm wam7_published
void inverse(const double *q, const double *qd, const double *qdd, double *tau) {
    wam7_inverse(&arm, q, qd, qdd, tau);
}
void forward(const double *q, const double *qd, const double *tau, double *qdd) {
    wam7_forward(&arm, q, qd, tau, qdd);
}
void mass(const double *q, double *M) {
    wam7_pose p;
    wam7_locate(&arm, q, &p);
    wam7_mass(&p, (double(*)[WAM7])M);
}
"""


@pytest.fixture(scope="module")
def wam() -> Callable[..., Array]:
    path = build("test", {"shim.c": SHIM}, [source_root() / "machines"]).path
    assert path is not None
    library = ctypes.CDLL(str(path))

    def call(name: str, *inputs: Array, size: int = 7) -> Array:
        out = np.zeros(size)
        arrays = [np.ascontiguousarray(x, dtype=float) for x in (*inputs, out)]
        getattr(library, name)(*(x.ctypes.data_as(ctypes.c_void_p) for x in arrays))
        return arrays[-1]

    return call


def test_wam_dynamics_in_c_agree_with_pinocchio_to_1e_9(
    wam: Callable[..., Array], wam_of_pinocchio: Any
) -> None:
    import pinocchio as pin

    model = wam_of_pinocchio
    data, r = model.createData(), np.random.default_rng(7)
    for _ in range(300):
        q, qd, qdd = r.uniform(-3, 3, 7), r.uniform(-5, 5, 7), r.uniform(-20, 20, 7)
        tau = np.array(pin.rnea(model, data, q, qd, qdd))
        assert np.abs(wam("inverse", q, qd, qdd) - tau).max() < 1e-9
        upper = np.triu(np.array(pin.crba(model, data, q)))
        assert (
            np.abs(wam("mass", q, size=49).reshape(7, 7) - (upper + np.triu(upper, 1).T)).max()
            < 1e-9
        )
        # the wrist has 7e-5 kg m^2: accelerations are of 1e3 rad/s^2, so this one is relative
        assert np.abs(wam("forward", q, qd, tau) - qdd).max() < 1e-9 * 1e3
        assert (
            np.abs(
                wam("inverse", q, 0 * q, 0 * q)
                - np.array(pin.computeGeneralizedGravity(model, data, q))
            ).max()
            < 1e-9
        )


def test_wam_at_rest_feels_the_weight_that_the_energy_says(wam: Callable[..., Array]) -> None:
    """Gravity torque is the gradient of the potential energy, computed from frames alone."""
    links = load_machine("wam7").parameters["link"]

    def energy(q: Array) -> float:
        T, total = np.eye(4), 0.0
        for angle, link in zip(q, links, strict=True):
            ca, sa = np.cos(np.deg2rad(link["alpha_deg"])), np.sin(np.deg2rad(link["alpha_deg"]))
            c, s = np.cos(angle), np.sin(angle)
            T = T @ np.array(
                [
                    [c, -s * ca, s * sa, link["a"] * c], [s, c * ca, -c * sa, link["a"] * s],
                    [0, sa, ca, link["d"]], [0, 0, 0, 1],
                ]
            )
            total += link["mass"] * 9.81 * float((T @ np.array([*link["com"], 1.0]))[2])
        return total

    for q in np.random.default_rng(3).uniform(-2, 2, (5, 7)):
        gradient = [(energy(q + h) - energy(q - h)) / 2e-6 for h in 1e-6 * np.eye(7)]
        assert wam("inverse", q, 0 * q, 0 * q) == pytest.approx(gradient, abs=1e-6)


GAINS: dict[str, tuple[Any, Any, Any]] = {
    "imi_planar": ([2000.0, 300.0], [120.0, 12.0], [0.5, 0.8]),
    "pendulum": (1.2, 0.02, [2.0]),
    "wam7": (
        [300.0, 400.0, 100.0, 60.0, 4.0, 4.0, 2.0], [30.0, 40.0, 4.0, 3.0, 0.05, 0.05, 0.005],
        [0.4, 0.3, 0.4, 0.4, 0.5, 0.5, 0.5],
    ),
}
CENTRE = {"imi_planar": np.zeros(2), "pendulum": np.zeros(1), "wam7": UP}


def swing(name: str, substep: float, seconds: float = 10.0, more: str = "") -> tuple[Array, Array]:
    """A motion under PD along sines of several frequencies, with reversals: rows of follow(), and
    the counts per rad.
    """
    kp, kd, amplitude = GAINS[name]
    centre, n = CENTRE[name], len(CENTRE[name])
    config = f"substep = {substep}\n{more}" + "".join(f"q{j + 1} = {centre[j]}\n" for j in range(n))
    frequency = 0.3 + 0.07 * np.arange(n)
    with Plant(name, config) as plant:
        return (
            follow(
                plant,
                lambda t: centre + np.array(amplitude) * np.sin(2 * np.pi * frequency * t),
                kp,
                kd,
                seconds,
            ),
            plant.counts,
        )


EASIER = pytest.mark.long("the last has light joints and full friction, and is stiffer")


@pytest.mark.parametrize(
    ("name", "substep", "more"),
    [
        *(
            pytest.param(name, substep, f"friction = {friction}\n", marks=EASIER)
            for name, substep in (("imi_planar", 1e-4), ("pendulum", 1e-4), ("wam7", 5e-5))
            for friction in ("plain", "full")
            if (name, friction) != ("wam7", "full")
        ),
        ("wam7", 5e-5, "friction = full\n"),
    ],
)
def test_halving_the_step_changes_positions_by_less_than_an_encoder_count_in_10_s(
    name: str, substep: float, more: str
) -> None:
    n = len(CENTRE[name])
    rows, counts = swing(name, substep, more=more)
    finer, _ = swing(name, substep / 2, more=more)
    assert np.ptp(rows[:, 1 : 1 + n], axis=0).min() > 0.1, "every joint must move"
    assert (np.abs(rows - finer)[:, 1 : 1 + n] * counts).max() < 1.0


def test_halving_the_step_of_the_spinning_pendulum_changes_less_than_a_count_in_10_s() -> None:
    """Open loop, the paper's torque law: nothing pulls two runs together again."""
    ends = []
    for substep in (1e-4, 5e-5):
        with Plant("pendulum", f"substep = {substep}") as plant:
            for k in range(10000):
                t = k * 1e-3
                plant.torque(
                    [
                        0.3 * (1 - math.exp(-1.8 * t))
                        + 0.1 * math.sin(26 * t + 0.08)
                        + 0.1 * math.sin(12 * t + 0.34)
                    ]
                )
            ends.append(plant.q[0])
    assert ends[0] > 50.0
    assert abs(ends[0] - ends[1]) * 4096 / (2 * np.pi) < 1.0


def test_same_inputs_give_the_same_motion_to_the_last_bit() -> None:
    assert np.array_equal(swing("wam7", 5e-5, 0.3)[0], swing("wam7", 5e-5, 0.3)[0])


@pytest.mark.parametrize("name", ["imi_planar", "pendulum", "wam7"])
def test_friction_holds_a_joint_below_breakaway_and_its_bristle_gives_way(name: str) -> None:
    with Plant(name, "q1 = 0\nq2 = 0\nq4 = 0\n" if name == "wam7" else "") as plant:
        tau = np.zeros(plant.joints)
        tau[0] = {"imi_planar": 7.0, "pendulum": 0.07, "wam7": 3.5}[name]
        for _ in range(8000 if name == "wam7" else 2000):  # its other joints sink until they rest
            plant.torque(tau)
        resting = plant.q[0]
        for _ in range(300):
            plant.torque(tau)
        assert abs(plant.q[0] - resting) < 2.0 / plant.counts[0], "below breakaway nothing creeps"
        assert 0.0 < abs(resting) < 0.02, "but the bristle gives way"


@pytest.mark.parametrize(
    ("direction", "level", "viscous"),
    [(1.0, 8.45 * 1.05, 5.3 * 1.02), (-1.0, 8.45 * 0.95, 5.3 * 0.98)],
)
def test_sliding_friction_of_the_arm_is_what_a_constant_speed_move_measures(
    direction: float, level: float, viscous: float
) -> None:
    with Plant("imi_planar", f"q1 = {-1.2 * direction}\n") as plant:
        rows = follow(
            plant,
            lambda t: np.array([direction * (1.5 * t - 1.2), 0.0]),
            [4000.0, 300.0],
            [300.0, 12.0],
            1.5,
        )
    # from 0.5 s on the move is steady: joint 2 stands still and no acceleration is left
    assert rows[500:, 5].mean() == pytest.approx(direction * (level + 1.5 * viscous), rel=0.01)


def test_pendulum_electrics_lie_on_the_papers_straight_line() -> None:
    """v/i against qd/i: slope k_a, intercept R_a, from what the host can measure at steady speeds.
    """
    points = []
    with Plant("pendulum", "drive = voltage\nbrake = 0.0\n") as plant:
        for volts in (4.0, 8.0, 12.0, -5.0, -9.0):
            rows = []
            for _ in range(3000):
                angle = plant.sample([volts * 10000.0 / 24.0])[0]
                rows.append((angle, plant.sensors.adc[0], plant.sensors.adc[1]))
            last = np.array(rows[1000:])
            speed = (last[-1, 0] - last[0, 0]) / (0.001 * (len(last) - 1))
            current, voltage = last[:, 1].mean(), last[:, 2].mean()
            points.append((speed / current, voltage / current))
    x, y = np.array(points).T
    slope, intercept = np.polyfit(x, y, 1)
    assert slope == pytest.approx(0.1762, rel=0.02)
    # the current sensor's step of 9.8 mA is 5 % of the smallest current
    assert intercept == pytest.approx(5.54, rel=0.1)


def test_pendulum_current_loop_reaches_its_torque_in_two_samples_and_stops_at_the_supply() -> None:
    with Plant("pendulum", "brake = 0.6\n") as plant:  # braked: it does not turn
        for _ in range(3):
            plant.torque([0.3])
        plant.torque([0.3])
        # two steps of the sensor
        assert plant.sensors.adc[0] == pytest.approx(0.3 / 0.1762, abs=0.02)
        for _ in range(5):
            plant.torque([0.8])
        assert plant.sensors.adc[1] == 24.0  # 0.8 N m would need 25.2 V


@pytest.mark.parametrize(("channel", "span"), [(0, 10.0), (1, 48.0)], ids=["A", "V of the bridge"])
def test_the_pendulums_current_and_voltage_have_10_bits(channel: int, span: float) -> None:
    with Plant("pendulum") as plant:
        seen = set()
        for k in range(500):
            plant.torque([0.3 * math.sin(0.05 * k)])
            seen.add(plant.sensors.adc[channel])
    steps = np.array(sorted(seen)) / (span / 1024)
    assert np.abs(steps - np.round(steps)).max() < 1e-9 and len(seen) > 50


@pytest.mark.parametrize("name", ["imi_planar", "pendulum", "wam7"])
def test_stop_brings_every_joint_to_rest_and_holds_it(name: str) -> None:
    """Velocity mode with zero reference: what STOP imposes."""
    centre = CENTRE[name]
    start = "".join(f"q{j + 1} = {x}\n" for j, x in enumerate(centre))
    with Plant(name, start + "ideal = 1\n") as plant:  # without noise, which never rests
        push = {
            "imi_planar": [30.0, 6.0], "pendulum": [0.4],
            "wam7": [8.0, -40.0, 4.0, 8.0, 0.6, 1.0, 0.2],
        }[name]
        for _ in range(150):
            plant.torque(push)
        assert np.abs(plant.qd).max() > 0.3
        for _ in range(1500):
            plant.sample(np.zeros(plant.joints), VELOCITY)
        held = plant.q
        for _ in range(1000):
            plant.sample(np.zeros(plant.joints), VELOCITY)
        assert np.abs(plant.qd).max() < 2e-3
        # noise on an analog speed reference lets a joint wander, by two or three counts a second
        assert np.abs(plant.q - held).max() < 5e-3


def test_power_off_lets_the_wam_sink_into_its_stops_and_no_further() -> None:
    with Plant("wam7", "q2 = 0.5\nq4 = 1.5\n") as plant:
        for _ in range(5000):
            plant.sample(np.zeros(7), OFF)
        machine = load_machine("wam7")
        assert plant.q[1] > 1.0, "it falls"
        assert np.all(plant.q < machine.limits.position_max + 0.3) and np.all(
            plant.q > machine.limits.position_min - 0.3
        )


@pytest.mark.parametrize("name", ["imi_planar", "wam7"])
def test_homing_ends_at_the_home_position(name: str) -> None:
    with Plant(
        name, "q1 = 0.4\nq2 = -0.5\nq4 = 2.0\n" if name == "wam7" else "q1 = 1.0\nq2 = -1.2\n"
    ) as plant:
        plant.actuators.mode = VELOCITY
        for _ in range(20000):
            plant.ops.read(plant.handle, plant.sensors)
            done = plant.ops.home(plant.handle, plant.sensors, plant.actuators)
            plant.ops.write(plant.handle, plant.actuators)
            plant.ops.step(plant.handle, 0.001)
            if done == 1:
                break
        assert done == 1
        assert plant.q == pytest.approx(load_machine(name).home, abs=5e-3)


@pytest.mark.parametrize("name", ["imi_planar", "wam7"])
def test_plain_machine_is_the_nominal_model_of_the_host(name: str) -> None:
    """friction = plain: in steady sliding the torque is inverse dynamics with the figures of the
    machine description.
    """
    rows, _ = swing(name, 5e-5, 2.5, "friction = plain\n")
    n = len(CENTRE[name])
    q, qd, tau = rows[:, 1 : 1 + n], rows[:, 1 + n : 1 + 2 * n], rows[:, 1 + 2 * n :]
    # row k: tau is held from k to k + 1, so compare with the motion in the middle of the sample
    middle = 0.5 * (q[1:] + q[:-1])
    speed = 0.5 * (qd[1:] + qd[:-1])
    acceleration = np.diff(qd, axis=0) / 0.001
    needed = load_machine(name).dynamics.inverse(middle, speed, acceleration)
    friction = np.asarray(load_machine(name).parameters["coulomb"])
    sliding = (np.abs(qd[1:]) > 0.15).all(axis=1) & (np.arange(len(tau) - 1) > 200)
    assert sliding.sum() > 100
    # LuGre bristles follow a change of level within a milliradian, rotors of 7e-5 kg m^2 ring for a
    # few samples after it
    assert np.abs(needed - tau[:-1])[sliding].mean(axis=0) / friction == pytest.approx(
        np.zeros(n), abs=0.02
    )


def test_limits_on_the_host_are_those_of_the_machine() -> None:
    for name in machine_names():
        machine = load_machine(name)
        with Plant(name) as plant:
            for j in range(plant.joints):
                joint = plant.info.joint[j]
                assert machine.limits.torque[j] == joint.torque_max
                assert (machine.limits.position_min[j], machine.limits.position_max[j]) == (
                    joint.position_min, joint.position_max,
                )
                assert (
                    machine.limits.speed[j] <= joint.speed_max
                ), "a planned speed may not trip the drives"


@pytest.mark.parametrize("text", ["", '#include "isr.h"\nvoid UserInit(void) {}\n'])
def test_c_code_that_is_no_machine_is_refused_before_a_target_listens(
    text: str, tmp_path: Path
) -> None:
    source = tmp_path / "empty.c"
    source.write_text(text)
    with pytest.raises(CompileFailed, match=r"empty\.c: is no machine: it defines no 'zendsp_mach"):
        build_machine(str(source))
