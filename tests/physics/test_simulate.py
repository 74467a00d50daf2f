"""The simulator against mechanics that is known otherwise: closed forms, SciPy's integrator,
Pinocchio.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benches import MODELS, T, effect, planar, rotary
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from zendsp.errors import ModelError
from zendsp.physics import load_model, parse_model, simulate_loop
from zendsp.physics.simulation.native import simulator_library
from zendsp.physics.simulation.plant import tree_of


def test_a_free_pendulum_swings_as_scipy_says() -> None:
    model = rotary(effect("viscous", coefficient=0.003), gravity=0.3)
    rec = simulate_loop(model, command=np.zeros(3000), position=2.5, inner=8)
    truth = solve_ivp(
        lambda t, x: [x[1], (-0.3 * math.sin(x[0]) - 0.003 * x[1]) / 0.01],
        (0, 3),
        [2.5, 0],
        rtol=1e-11,
        atol=1e-12,
        t_eval=rec.t,
    )
    # h^2 = 1.6e-8 times the curvature of a fast swing
    assert np.abs(rec["plant_q"] - truth.y[0]).max() < 2e-5
    finer = simulate_loop(model, command=np.zeros(3000), position=2.5, inner=32)
    assert np.abs(finer["plant_q"] - truth.y[0]).max() < 2e-6


def test_the_planar_arm_moves_as_its_equations_say() -> None:
    def rate(t: float, x: Any) -> list[float]:
        _q1, q2, v1, v2 = x
        c, s = 0.242 * math.cos(q2), 0.242 * math.sin(q2)
        M = np.array([[3.473 + 2 * c, 0.196 + c], [0.196 + c, 0.196]])
        a = np.linalg.solve(
            M, [4.0 + s * v2 * (2 * v1 + v2) - 5.3 * v1, -0.5 - s * v1**2 - 1.1 * v2]
        )
        return [v1, v2, a[0], a[1]]

    model = planar(effect("viscous", coefficient=5.3), effect("viscous", 2, coefficient=1.1))
    rec = simulate_loop(model, command=np.tile([4.0, -0.5], (2000, 1)), position=[0.1, 1.0])
    truth = solve_ivp(rate, (0, 2), [0.1, 1.0, 0, 0], rtol=1e-11, atol=1e-12, t_eval=rec.t)
    assert np.abs(rec["plant_q"] - truth.y[:2].T).max() < 1e-7


def test_rigid_bodies_of_a_urdf_are_pinocchios_to_1e_9() -> None:
    import pinocchio as pin

    model = load_model(MODELS / "wam7.toml")
    robot = pin.buildModelFromUrdf(str(MODELS / "wam7.urdf"))
    data, lib = robot.createData(), simulator_library()
    rows, gravity = tree_of(model)
    rng = np.random.default_rng(1)
    for _ in range(50):
        q, qd, qdd = rng.normal(size=(3, 7)) * [[2.0], [3.0], [20.0]]
        tau, mass = np.empty(7), np.empty((7, 7))
        lib.lib.sim_tree(7, *(lib.doubles(x) for x in (rows, gravity, q, qd, qdd, tau, mass)))
        upper = np.triu(pin.crba(robot, data, q))
        assert np.abs(tau - pin.rnea(robot, data, q, qd, qdd)).max() < 1e-9
        assert np.abs(mass - (upper + np.triu(upper, 1).T)).max() < 1e-9


def test_a_tree_with_slides_skew_axes_and_branches_is_pinocchios_too(tmp_path: Path) -> None:
    import pinocchio as pin

    link = (
        '<link name="{n}"><inertial><origin xyz="0.1 -0.05 {z}" rpy="0.3 0.2 -0.4"/><mass'
        ' value="{m}"/><inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="-0.002"'
        ' iyz="0.003"/></inertial></link>'
    )
    joint = (
        '<joint name="j{n}" type="{t}"><parent link="{p}"/><child link="{n}"/><origin xyz="0.2 0.1'
        ' -0.3" rpy="0.5 -0.7 0.9"/><axis xyz="{a}"/><limit lower="-2" upper="2" effort="9"'
        ' velocity="9"/></joint>'
    )
    parts = ['<robot name="tree"><link name="base"/>']
    for n, parent, kind, axis in (
        ("a", "base", "revolute", "0.6 0 0.8"),
        ("z", "a", "prismatic", "0 1 0"),
        ("f", "z", "fixed", "1 0 0"),
        ("c", "f", "revolute", "0 0.6 -0.8"),
        ("d", "a", "revolute", "1 0 0"),
    ):
        parts += [link.format(n=n, z=0.07, m=1.3), joint.format(n=n, p=parent, t=kind, a=axis)]
    file = tmp_path / "tree.urdf"
    file.write_text("\n".join([*parts, "</robot>"]))
    model = parse_model({"sample_time": T, "mechanism": {"kind": "urdf", "file": str(file)}})
    robot = pin.buildModelFromUrdf(str(file))
    data, lib = robot.createData(), simulator_library()
    rows, gravity = tree_of(model)
    q, qd, qdd = np.random.default_rng(2).normal(size=(3, 4))
    tau, mass = np.empty(4), np.empty((4, 4))
    lib.lib.sim_tree(4, *(lib.doubles(x) for x in (rows, gravity, q, qd, qdd, tau, mass)))
    upper = np.triu(pin.crba(robot, data, q))
    assert np.abs(tau - pin.rnea(robot, data, q, qd, qdd)).max() < 1e-9
    assert np.abs(mass - (upper + np.triu(upper, 1).T)).max() < 1e-9


def test_an_arm_without_friction_keeps_its_energy() -> None:
    import pinocchio as pin

    model = load_model(MODELS / "wam7.toml").with_terms(())
    start = np.array([0.3, 0.9, -0.2, 1.2, 0.1, 0.4, 0.2])
    rec = simulate_loop(model, command=np.zeros((400, 7)), position=start, inner=16)
    robot = pin.buildModelFromUrdf(str(MODELS / "wam7.urdf"))
    data = robot.createData()
    energy = [
        pin.computeKineticEnergy(robot, data, q, v) + pin.computePotentialEnergy(robot, data, q)
        for q, v in zip(rec["plant_q"], rec["plant_qd"], strict=True)
    ]
    moved = max(
        pin.computeKineticEnergy(robot, data, q, v)
        for q, v in zip(rec["plant_q"], rec["plant_qd"], strict=True)
    )
    assert moved > 3.0, "it falls: joules change from one kind to the other"
    assert np.ptp(energy) < 1e-3 * moved


def test_dry_friction_holds_exactly_below_its_level_and_not_above() -> None:
    model = rotary(effect("coulomb", level=0.05))
    held = simulate_loop(model, command=np.full(500, 0.0499))
    assert np.all(held["plant_q"] == 0.0) and np.all(held["plant_qd"] == 0.0)
    moved = simulate_loop(model, command=np.full(500, 0.0501))
    assert moved["plant_q"][-1] == pytest.approx(0.5 * 0.01 * (0.499) ** 2, rel=1e-6)


def test_a_coasting_joint_stops_when_coulomb_says_and_stays() -> None:
    rec = simulate_loop(
        rotary(effect("coulomb_asymmetry", level_pos=0.02, level_neg=0.5)),
        command=np.zeros(1500),
        velocity=2.0,
    )
    assert rec["plant_q"][-1] == pytest.approx(2.0**2 * 0.01 / (2 * 0.02), rel=1e-4)  # v^2 J / 2 F
    stopped = rec.t > 1.001
    assert np.all(rec["plant_qd"][stopped] == 0.0)


def test_friction_holds_a_joint_against_the_pull_of_another() -> None:
    model = planar(effect("coulomb", 2, level=2.35))
    pull = simulate_loop(model, command=np.tile([12.0, 0.0], (300, 1)))
    # N m on joint 2 while it stands, 1.33: below its level
    reaction = 12.0 / (3.473 + 2 * 0.242) * (0.196 + 0.242)
    assert reaction < 2.35 and np.all(pull["plant_qd"][:, 1] == 0.0)
    assert pull["plant_qd"][250, 0] == pytest.approx(12.0 / (3.473 + 2 * 0.242) * 0.250, rel=1e-3)
    assert (
        simulate_loop(model, command=np.tile([25.0, 0.0], (300, 1)))["plant_qd"][-1, 1] < -0.1
    ), "25 N m pull it along"


EFFECTS = {
    "stribeck": {"breakaway": 0.08, "velocity": 0.05},
    "presliding": {"stiffness": 20.0, "damping": 0.01},
    "elasticity": {"stiffness": 30.0, "damping": 0.01, "load_inertia": 0.006},
    "hysteresis": {"force": 0.1, "stiffness": 1.0},
    "lag": {"time_constant": 0.003},
    "delay": {"time": 0.0015},
    "friction_drift": {"ratio": 1.0, "time_constant": 5.0},
    "dead_zone": {"width": 0.02},
    "load_friction": {"coefficient": 0.1},
    "ripple": {"order": 7.0, "amplitude": 0.03, "phase": 0.0},
    "quadratic_drag": {"coefficient": 0.01},
    "saturation": {"level": 0.3},
    "viscous_asymmetry": {"coefficient_pos": 0.01, "coefficient_neg": 0.02},
    "position_friction": {"amplitude": 0.02, "period": 0.5, "phase": 0.0},
    "friction_block": {
        "level": 0.05, "slope": -0.02, "curve": 0.03, "cubic": 0.01, "split": 1.0,
        "high_curve": 0.002,
    },
    "inertia": {"amount": 0.004},
    "torque_gain": {"ratio": 0.2},
    "torque_offset": {"level": 0.02},
    "gravity": {"torque": 0.1, "angle": 0.3},
    "stiffness": {"coefficient": 0.2, "neutral": 0.1},
    "cubic_stiffness": {"coefficient": 0.2, "neutral": 0.1},
    "encoder_eccentricity": {"amplitude": 0.01, "phase": 0.2},
    "coulomb_tanh": {"level": 0.05, "speed": 0.1},
    "creep": {"speed": 0.1},
    "gain_drift": {"ratio": -0.3, "time_constant": 2.0},
    "sensor_harmonic": {"order": 2.0, "amplitude": 0.01, "phase": 0.2},
    "column_shift": {"time": 0.002},
    "voltage_limit": {"level": 0.4, "slope": 0.08},
    "stiffening": {"stiffness": 20.0, "stiffness3": 5e4, "load_inertia": 0.006, "damping": 0.01},
    "transmission_error": {"order": 3.0, "amplitude": 0.02, "phase": 0.4},
    "position_filter": {"time_constant": 0.004},
    "friction_temperature": {"coefficient": 0.03, "reference": 10.0},
}


@pytest.mark.parametrize("name", EFFECTS)
def test_halving_the_step_quarters_the_error_of(name: str) -> None:
    loop = {"controller": {"kind": "pd", "kp": 2.0, "kd": 0.1}}
    model = rotary(
        effect("coulomb", level=0.05), effect(name, **EFFECTS[name]), gravity=0.3, **loop
    )
    r = 0.8 * np.sin(2.0 * T * np.arange(4000))
    fine, errors = simulate_loop(model, r, inner=256)["plant_q"], []
    for inner in (4, 16):
        errors.append(float(np.abs(simulate_loop(model, r, inner=inner)["plant_q"] - fine).max()))
    assert errors[0] < 1e-6, "rad, at four steps a sample"
    # second order: 16; a reversal may fall badly
    assert errors[1] < errors[0] / 6 or errors[1] < 1e-9


J, G, U = 0.01, 0.3, 0.12  # kg m^2, N m, N m
KEPT = math.exp(-T / 0.02)  # by a filter of 20 ms in a row
N, A, PHI = 3.0, 0.02, 0.4  # of a transmission


def uneven(x: float) -> tuple[float, float, float]:
    return (
        x + A * math.sin(N * x + PHI), 1 + A * N * math.cos(N * x + PHI),
        -A * N * N * math.sin(N * x + PHI),
    )


def geared(t: float, x: Any) -> list[float]:
    at, slope, bend = uneven(x[0])
    return [x[1], (U - J * slope * bend * x[1] ** 2 - slope * G * math.sin(at)) / (J * slope**2)]


def geared_spring(t: float, x: Any) -> list[float]:
    at, slope, _ = uneven(x[0])
    pull = 20.0 * (at - x[2]) + 5e4 * (at - x[2]) ** 3 + 0.01 * (slope * x[1] - x[3])
    return [x[1], (U - slope * pull) / 0.004, x[3], (pull - G * math.sin(x[2])) / 0.006]


ERROR = effect("transmission_error", order=N, amplitude=A, phase=PHI)
STIFFENING = effect("stiffening", stiffness=20.0, stiffness3=5e4, load_inertia=0.006, damping=0.01)
# effects, what the equations of their machine are, of which states, and what its sensor says of
# them
SCIPY: dict[str, tuple[list[dict[str, Any]], Any, list[float], Any]] = {
    "gain_drift": (
        [effect("gain_drift", ratio=-0.5, time_constant=0.4)],
        lambda t, x: [x[1], (U * (1 - 0.5 * (1 - math.exp(-t / 0.4))) - G * math.sin(x[0])) / J],
        [1.0, 0],
        lambda x: x[0],
    ),
    "sensor_harmonic": (
        [effect("sensor_harmonic", order=2.0, amplitude=0.01, phase=0.2)],
        lambda t, x: [x[1], (U - G * math.sin(x[0])) / J],
        [1.0, 0],
        lambda x: x[0] + 0.01 * np.sin(2 * x[0] + 0.2),
    ),
    "position_filter": (
        [effect("position_filter", time_constant=0.02)],
        lambda t, x: [x[1], (U - G * math.sin(x[0])) / J, (x[0] - x[2]) / 0.02],
        [1.0, 0, 1.0],
        lambda x: x[2],
    ),
    "a filter computed once a row": (
        [effect("position_filter", time_constant=0.02, computed="per_row")],
        lambda t, x: [x[1], (U - G * math.sin(x[0])) / J],
        [1.0, 0],
        lambda x: lfilter([1 - KEPT], [1, -KEPT], x[0], zi=[KEPT * 1.0])[0],
    ),
    "voltage_limit": (
        [effect("voltage_limit", level=0.13, slope=0.03)],
        lambda t, x: [
            x[1],
            (max(-0.13 - 0.03 * x[1], min(0.13 - 0.03 * x[1], U)) - G * math.sin(x[0])) / J,
        ],
        [1.0, 0],
        lambda x: x[0],
    ),
    "transmission_error": ([ERROR], geared, [1.0, 0], lambda x: x[0]),
    "stiffening behind an error": (
        [ERROR, STIFFENING],
        geared_spring,
        [1.0, 0, uneven(1.0)[0], 0],
        lambda x: x[0],
    ),
}


@pytest.mark.parametrize("name", SCIPY)
def test_a_machine_moves_as_scipy_says_with(name: str) -> None:
    effects, law, start, sensor = SCIPY[name]
    rec = simulate_loop(
        rotary(*effects, gravity=G), command=np.full(800, U), position=1.0, inner=32
    )
    truth = solve_ivp(law, (0, 0.8), start, rtol=1e-10, atol=1e-12, max_step=1e-3, t_eval=rec.t)
    # rad; h^2 = 1e-9 times the curvature of a swing of 2 rad
    assert np.abs(rec["position"] - sensor(truth.y)).max() < 3e-6


def test_friction_may_grow_with_the_torque_that_reaches_the_load() -> None:
    """U = load + 0.2 |load| sign of the speed, to the step by which the load is known late."""
    def law(t: float, x: Any) -> list[float]:
        load = U / (1.0 + math.copysign(0.2, x[1]))
        return [x[1], (load - G * math.sin(x[0])) / J]

    friction = effect("load_friction", coefficient=0.2, of="load")
    rec = simulate_loop(
        rotary(friction, gravity=G), command=np.full(800, U), position=1.0, inner=32
    )
    truth = solve_ivp(law, (0, 0.8), [1.0, -1e-12], rtol=1e-9, max_step=1e-4, t_eval=rec.t)
    of_drive = simulate_loop(
        rotary(effect("load_friction", coefficient=0.2), gravity=G), command=np.full(800, U),
        position=1.0, inner=32,
    )  # fmt: skip
    assert np.abs(rec["position"] - truth.y[0]).max() < 1e-4
    assert np.abs(of_drive["position"] - truth.y[0]).max() > 1e-2


def test_a_controller_in_python_does_what_the_built_in_one_does() -> None:
    model = rotary(effect("coulomb", level=0.05), controller={"kind": "pd", "kp": 2.0, "kd": 0.1})
    r = 0.5 * np.sin(3.0 * T * np.arange(800))
    last = [0.0]

    def law(t: float, wanted: Any, y: Any) -> Any:
        rate, last[0] = (y[0] - last[0]) / T, y[0]
        return 2.0 * (wanted[0] - y[0]) - 0.1 * rate

    built_in, own = simulate_loop(model, r), simulate_loop(model, r, law)
    assert np.abs(built_in["plant_q"] - own["plant_q"]).max() < 1e-12


def test_the_step_check_doubles_the_steps_until_they_suffice() -> None:
    stiff = rotary(
        effect("backlash", gap=0.02, stiffness=2000.0, load_inertia=0.006),
        controller={"kind": "pd", "kp": 2.0, "kd": 0.05},
        sensor={"position_resolution": 1e-4},
    )
    rec = simulate_loop(stiff, 0.5 * np.sin(6.0 * T * np.arange(300)), inner=1, check=True)
    found = rec.extra["step_check"]
    assert found["converged"] and rec.extra["simulation"]["inner"] > 1
    assert max(found["halvings"][0]["change"]) > 1e-4 >= max(found["halvings"][-1]["change"])


def test_a_model_that_nothing_drives_or_that_lacks_a_sample_time_is_refused() -> None:
    with pytest.raises(ModelError, match=r"\[controller\]"):
        simulate_loop(rotary())
    with pytest.raises(ModelError, match="sample_time"):
        simulate_loop(
            parse_model({"mechanism": {"kind": "rotary", "parameters": {"inertia": 1.0}}}),
            command=np.zeros(5),
        )


def test_the_recording_bears_the_names_of_the_models_columns() -> None:
    model = rotary(
        controller={"kind": "pd", "kp": 2.0, "kd": 0.1},
        columns={"time": "t", "position": "angle", "command": "u", "reference": "goal"},
    )
    rec = simulate_loop(model, np.full(50, 0.1))
    assert (
        rec.names == ("angle", "u", "goal", "plant_q", "plant_qd", "plant_torque")
        and rec.units["u"] == "N m"
    )
