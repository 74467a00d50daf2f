"""The simulator's effects against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benches import T, effect, rotary, two_joints

from zendsp.physics import simulate_loop


def test_dry_friction_follows_the_temperature_that_is_recorded() -> None:
    model = rotary(
        effect("coulomb", level=0.02),
        effect("friction_temperature", coefficient=-0.05, reference=20.0),
        columns={"temperature": "warm"},
    )
    rec = simulate_loop(model, command=np.zeros(2500), velocity=2.0, temperature=30.0)
    # v^2 J / 2 F with half of the level
    assert rec["plant_q"][-1] == pytest.approx(2.0**2 * 0.01 / (2 * 0.01), rel=1e-4)
    assert np.all(rec["warm"] == 30.0) and rec.units["warm"] == "°C"


@pytest.mark.parametrize("late", [0.003, -0.002, 0.0015])
def test_a_shifted_column_holds_what_acted_before_or_will_act(late: float) -> None:
    command = 0.1 * np.sin(np.arange(300) * 0.05)
    rec, plain = (
        simulate_loop(model, command=command)
        for model in (rotary(effect("column_shift", time=late)), rotary())
    )
    # the machine does not know what is written of it
    assert np.all(rec["position"] == plain["position"])
    rows = np.arange(20, 280)
    # rows hold the mean over their sample
    held = np.interp(rows + 0.5 - late / T, np.arange(300) + 0.5, command)
    assert np.abs(rec["command"][rows] - held).max() < 1e-6


def test_delay_and_lag_shift_the_torque_in_time() -> None:
    command = np.r_[np.zeros(10), np.full(90, 0.1)]
    late = simulate_loop(rotary(effect("delay", time=0.0025)), command=command)["plant_qd"]
    assert late[12] == 0.0 and late[50] == pytest.approx(0.1 / 0.01 * (0.040 - 0.0025), rel=1e-9)
    known = simulate_loop(rotary(actuator={"delay": 0.001}), command=command)["plant_qd"]
    assert known[50] == pytest.approx(0.1 / 0.01 * 0.039, rel=1e-9)
    slow = simulate_loop(rotary(effect("lag", time_constant=0.005)), command=command)["plant_qd"]
    t = 0.040
    assert slow[50] == pytest.approx(
        0.1 / 0.01 * (t - 0.005 * (1 - math.exp(-t / 0.005))), rel=1e-6
    )


def test_a_saturated_torque_still_lags_when_the_command_turns() -> None:
    """Behind the lag a command of 1.0 would stay saturated for ln 10 time constants."""
    command = np.r_[np.full(50, 1.0), np.zeros(50)]
    laws = effect("lag", time_constant=0.005), effect("saturation", level=0.1)
    speed = simulate_loop(rotary(*laws), command=command)["plant_qd"]
    # the torque after the turn sums up to level times time constant
    assert speed[-1] - speed[50] == pytest.approx(0.1 * 0.005 / 0.01, rel=1e-3)


def test_an_elastic_joint_rings_at_its_resonance() -> None:
    jm, jl, k = 0.004, 0.006, 30.0
    model = rotary(effect("elasticity", stiffness=k, damping=0.0, load_inertia=jl), inertia=jm + jl)
    rec = simulate_loop(model, command=np.r_[np.full(5, 1.0), np.zeros(1995)], inner=16)
    v = rec["plant_qd"][100:] - rec["plant_qd"][100:].mean()
    crossings = np.flatnonzero((v[:-1] < 0) & (v[1:] >= 0))
    at = crossings - v[crossings] / (v[crossings + 1] - v[crossings])
    frequency = 1.0 / (np.diff(at).mean() * T)
    assert frequency == pytest.approx(math.sqrt(k * (1 / jm + 1 / jl)) / (2 * math.pi), rel=1e-3)


def test_the_dry_friction_of_a_load_holds_it_while_its_motor_bends_the_spring() -> None:
    k = 30.0
    spring = {"stiffness": k, "damping": 0.05, "load_inertia": 0.006}
    held, free = (
        simulate_loop(
            rotary(effect("elasticity", **spring, load_dry=dry)), command=np.full(2000, 0.08)
        )["plant_q"][-1]
        for dry in (0.2, 0.0)  # N m: more than the spring gives as it overshoots
    )
    assert held == pytest.approx(0.08 / k, rel=1e-3) and free > 1.0


def test_a_spring_to_the_frame_bends_the_transmission() -> None:
    k, hold, push = 30.0, 5.0, 0.2
    load = effect("elasticity", stiffness=k, damping=0.5, load_inertia=0.006)
    held = effect("stiffness", coefficient=hold, neutral=0.0)
    model = rotary(load, held, effect("viscous", coefficient=0.2), inertia=0.01)
    rec = simulate_loop(model, command=np.full(4000, push))
    assert rec["plant_q"][-1] == pytest.approx(push * (1 / k + 1 / hold), rel=1e-3)


def test_backlash_leaves_the_motor_alone_within_its_gap() -> None:
    jm, jl, gap = 0.004, 0.006, 0.2
    model = rotary(effect("backlash", gap=gap, stiffness=500.0, load_inertia=jl), inertia=jm + jl)
    rec = simulate_loop(model, command=np.full(250, 0.05))
    free = rec["plant_q"] < gap / 2
    assert rec["plant_q"][free] == pytest.approx(0.5 * 0.05 / jm * rec.t[free] ** 2, abs=1e-9)
    assert rec["plant_q"][-1] < 0.5 * 0.05 / jm * rec.t[-1] ** 2 - 0.01, "then it carries the load"


def test_bristles_are_a_spring_before_they_slide() -> None:
    model = rotary(effect("coulomb", level=0.05), effect("presliding", stiffness=20.0, damping=0.3))
    rec = simulate_loop(model, command=np.linspace(0.0, 0.02, 4000))
    # Dahl's curve, quasi-static
    assert rec["plant_q"][-1] == pytest.approx(-0.05 / 20.0 * math.log(1 - 0.02 / 0.05), rel=0.01)


def test_the_sensor_counts_and_mixes_as_the_model_says() -> None:
    matrix = [[0.1, 0.0], [0.05, 0.1]]
    model = two_joints(
        sensor={"position_resolution": 0.01, "matrix": matrix, "offset": [0.2, 0.0]},
        actuator={"matrix": [[2.0, 0.0], [1.0, 1.0]]},
    )
    rec = simulate_loop(model, command=np.tile([0.1, -0.05], (200, 1)))
    expected = np.linalg.solve(np.array(matrix), (rec["plant_q"] - [0.2, 0.0]).T).T
    measured = np.column_stack([rec["a"], rec["b"]])
    assert np.abs(measured - expected).max() <= 0.005 + 1e-12
    assert np.abs(measured / 0.01 - np.round(measured / 0.01)).max() < 1e-9
    assert rec["plant_torque"][5] == pytest.approx([0.2, 0.05])


def test_coupling_of_inertia_enters_the_mass_matrix() -> None:
    coupling = {"from_joint": 2, "law": "inertia", "coefficient": 0.004}
    model = two_joints({"kind": "coupling", "joint": 1, **coupling})
    rec = simulate_loop(model, command=np.tile([0.0, 0.02], (101, 1)))
    assert rec["plant_qd"][100] == pytest.approx([-0.004 * 1.0 / 0.01 * 0.1, 0.1], rel=1e-9)


def test_smoothed_coulomb_friction_is_stable_however_steep_and_creeps_where_dry_friction_holds() -> (  # noqa: E501
    None
):
    # 0.1 / 1e-4 / 0.01 kg m^2: a rate of 1e5 per s
    steep = rotary(effect("coulomb_tanh", level=0.1, speed=1e-4))
    rec = simulate_loop(steep, command=np.full(1000, 0.05))
    assert (
        rec["plant_qd"][-1] == pytest.approx(1e-4 * math.atanh(0.5), rel=0.01)
        and np.abs(rec["plant_qd"]).max() < 1e-3
    )
    assert np.all(
        simulate_loop(rotary(effect("coulomb", level=0.1)), command=np.full(1000, 0.05))["plant_qd"]
        == 0.0
    )


def test_dry_friction_that_creeps_is_coulomb_friction_smoothed_by_tanh() -> None:
    r = 0.8 * np.sin(2.0 * T * np.arange(2000))
    loop = {"controller": {"kind": "pd", "kp": 2.0, "kd": 0.1}}
    creeping, smooth = (
        simulate_loop(rotary(*terms, gravity=0.3, **loop), r, inner=64)["plant_q"]
        for terms in (
            (effect("coulomb", level=0.05), effect("creep", speed=0.02)),
            (effect("coulomb_tanh", level=0.05, speed=0.02),),
        )
    )
    assert np.abs(creeping - smooth).max() < 1e-6, "rad, where dry friction that holds is 3e-4 off"


def test_dry_friction_that_grows_straight_sees_the_speed_ahead_at_coupled_joints() -> None:
    level, slow, lead, coupled = 0.05, 0.1, 0.01, 0.004
    sines = 0.12 * np.sin(np.outer(np.arange(1500) * T, (5.0, 8.0)))
    model = two_joints(
        {"kind": "coupling", "joint": 1, "from_joint": 2, "law": "inertia", "coefficient": coupled},
        *(effect("coulomb", joint, level=level) for joint in (1, 2)),
        *(
            {"kind": "creep", "joint": joint, "speed": slow, "lead": lead, "shape": "straight"}
            for joint in (1, 2)
        ),
    )
    simulated = simulate_loop(model, command=sines, inner=8)["plant_q"]

    def accelerated(push: float, v: float, inertia: float) -> float:
        grip = level / slow
        rub = grip * (inertia * v + lead * push) / (inertia + lead * grip)
        return (push - max(-level, min(level, rub))) / inertia

    q, v, steps, true = [0.0, 0.0], [0.0, 0.0], 50, []
    for u in sines.tolist():
        true.append(tuple(q))
        for _ in range(steps):
            a = accelerated(u[1], v[1], 0.02)
            b = accelerated(u[0] - coupled * a, v[0], 0.01)
            for i, rate in ((0, b), (1, a)):
                q[i] += T / steps * (v[i] + 0.5 * T / steps * rate)
                v[i] += T / steps * rate
    off = np.abs(simulated - np.array(true)).max()
    assert off < 2e-4 * np.abs(true).max(), "steps of 20 us are of first order"
