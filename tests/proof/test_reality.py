"""The reality of the proof obeys physics that is known without it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from zendsp.proof.reality import CouplingTruth, JointTruth, MachineTruth, inverse_dynamics, run

T = np.arange(2000) * 1e-3
STILL = np.zeros((2000, 1))


def swing(**joint: object) -> MachineTruth:
    """A pendulum let go at 1 rad, no actuator command."""
    return MachineTruth("rotary", (JointTruth(**joint),), (0.01, 0.3), q0=(1.0,))  # type: ignore[arg-type]


def test_energy_stays_where_nothing_dissipates() -> None:
    machine = swing(gravity=0.1, gravity_angle=0.4, stiffness=0.2, neutral=0.3, cubic=0.1)
    energy = run(machine, STILL).energy
    # drift-kick-drift at 20 us: the error swings with (omega h)^2 ~ 1e-8 and does not grow
    assert np.ptp(energy) < 1e-6 * np.ptp(0.3 * np.cos(run(machine, STILL).q))


def test_energy_stays_in_an_elastic_joint_with_a_gap() -> None:
    machine = swing(
        trans_stiffness=40.0, trans_gap=0.05, motor_inertia=0.005, extra_inertia=-0.005
    )
    energy = run(machine, STILL).energy
    # contact opens and closes inside a step: first order in h there
    assert np.ptp(energy) < 1e-3


def test_planar_arm_and_chain_conserve_energy() -> None:
    pair = (JointTruth(), JointTruth())
    zero = (0.0, 0.0)
    arm = MachineTruth(
        "planar2r", pair, (3.5, 0.2, 0.24), kp=zero, kd=zero, ki=zero, q0=(0.2, 1.0), v0=(1.0, -3.0)
    )
    energy = run(arm, np.zeros((2000, 2))).energy
    assert np.ptp(energy) < 1e-6 * energy[0]


def test_friction_never_adds_energy_and_ends_in_rest() -> None:
    got = run(swing(coulomb_pos=0.1, coulomb_neg=0.1, drag=0.001), STILL)
    assert np.all(np.diff(got.energy) <= 1e-12)
    assert got.v[-1, 0] == 0.0  # held: exactly, not nearly


def test_joint_sticks_below_breakaway_and_slides_above() -> None:
    machine = MachineTruth(
        "rotary",
        (
            JointTruth(
                coulomb_pos=0.05, coulomb_neg=0.05, stribeck_extra=0.02, stribeck_velocity=0.1
            ),
        ),
        (0.01,),
    )
    held = run(machine, STILL, feedforward=np.full((2000, 1), 0.0699))
    assert np.all(held.q == 0.0)
    freed = run(machine, STILL, feedforward=np.full((2000, 1), 0.0701))
    assert freed.q[-1, 0] > 0.1


def test_bristles_give_way_by_force_over_stiffness() -> None:
    machine = MachineTruth(
        "rotary",
        (
            JointTruth(
                coulomb_pos=0.05, coulomb_neg=0.05, bristle_stiffness=10.0, bristle_damping=0.3
            ),
        ),
        (0.01,),
    )
    ramp = np.minimum(T / 1.0, 1.0)[:, None] * 0.01
    got = run(machine, STILL, feedforward=ramp)
    # Dahl: x = -(Fc/s0) ln(1 - F/Fc)
    assert got.q[-1, 0] == pytest.approx(-0.005 * np.log(1 - 0.2), rel=0.02)


def test_torque_effects_have_the_signs_of_the_contract() -> None:
    """M qdd + effect = command: a positive offset slows, a command that balances it holds still."""
    machine = MachineTruth("rotary", (JointTruth(torque_offset=0.2),), (0.01,))
    assert np.all(np.abs(run(machine, STILL, feedforward=np.full((2000, 1), 0.2)).q) < 1e-12)
    assert run(machine, STILL).q[-1, 0] == pytest.approx(-0.5 * 20.0 * T[-1] ** 2, rel=1e-6)


def test_delay_moves_the_answer_by_just_that_time() -> None:
    command = np.sin(20 * T)[:, None] * 0.1
    plain, late = (
        MachineTruth(
            "rotary", (JointTruth(viscous_pos=0.01, viscous_neg=0.01, delay=delay),), (0.01,)
        )
        for delay in (0.0, 0.0033)
    )
    a = run(plain, STILL, feedforward=command).q[:, 0]
    b = run(late, STILL, feedforward=command).q[:, 0]
    # interpolation of a over 1 ms
    assert np.max(np.abs(b[100:] - np.interp(T[100:] - 0.0033, T, a))) < 1e-5


def test_lag_passes_a_constant_and_delays_a_ramp_by_its_time_constant() -> None:
    machine = MachineTruth("rotary", (JointTruth(lag=0.01),), (0.01,))
    v = run(machine, STILL, feedforward=np.full((2000, 1), 0.1)).v[:, 0]
    assert v[-1] == pytest.approx(10.0 * (T[-1] - 0.01), rel=1e-6)


@pytest.mark.parametrize(
    ("joint", "order"),
    [
        ({"viscous_pos": 0.003, "viscous_neg": 0.003, "drag": 0.002}, 1.8),
        ({"trans_stiffness": 40.0, "trans_damping": 0.01, "motor_inertia": 0.005}, 1.8),
        ({"bw_force": 0.05, "bw_stiffness": 1.0}, 0.9),  # the law has kinks at reversals
        ({"coulomb_pos": 0.02, "coulomb_neg": 0.02}, 0.7),  # so has dry friction
    ],
)
def test_halving_the_step_converges(joint: dict[str, float], order: float) -> None:
    from dataclasses import replace

    command = 0.2 * np.sin(7 * T)[:, None]
    runs = [
        run(replace(swing(**joint), substeps=n), STILL, feedforward=command).q for n in (10, 20, 40)
    ]
    coarse, fine = (np.max(np.abs(b - a)) for a, b in itertools.pairwise(runs))
    assert np.log2(coarse / fine) > order
    assert fine < 1e-4  # rad


def test_sensor_counts_by_rounding_or_by_floor() -> None:
    step = 2 * np.pi / 4096
    got = run(swing(resolution=step), STILL)
    assert np.allclose(got.measured / step, np.rint(got.measured / step), atol=1e-9)
    assert np.max(np.abs(got.measured - got.q)) <= 0.5 * step * (1 + 1e-9)
    floor = run(swing(resolution=step, floor_counts=1.0), STILL)
    assert np.all(floor.measured <= floor.q + 1e-12)


def test_chain_agrees_with_the_planar_formula() -> None:
    """Two links on parallel vertical axes, as a chain and by p1, p2, p3."""
    from zendsp.proof.reality import LinkTruth

    eye = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    thin = (0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1)
    m1, m2, l1, c1, c2 = 2.0, 1.5, 0.4, 0.15, 0.2
    links = (
        LinkTruth(eye, (0.0, 0.0, 0.0), m1, (c1, 0.0, 0.0), thin),
        LinkTruth(eye, (l1, 0.0, 0.0), m2, (c2, 0.0, 0.0), thin),
    )
    pair, zero = (JointTruth(), JointTruth()), (0.0, 0.0)
    base = {"kp": zero, "kd": zero, "ki": zero, "q0": zero, "v0": zero}
    chain = MachineTruth("urdf", pair, links=links, **base)  # type: ignore[arg-type]
    p2 = 0.1 + m2 * c2**2
    p1 = 0.1 + m1 * c1**2 + m2 * l1**2 + p2
    planar = MachineTruth("planar2r", pair, (p1, p2, m2 * l1 * c2), **base)  # type: ignore[arg-type]
    q, v, a = np.random.default_rng(0).normal(size=(3, 50, 2))
    assert np.allclose(
        inverse_dynamics(chain, q, v, a), inverse_dynamics(planar, q, v, a), atol=1e-12
    )


def test_coupled_joint_feels_its_neighbour() -> None:
    pair = (JointTruth(), JointTruth())
    zero = (0.0, 0.0)
    arm = MachineTruth(
        "planar2r", pair, (1.0, 0.2, 0.0), kp=zero, kd=zero, ki=zero, q0=zero, v0=(0.0, 1.0)
    )
    quiet = run(arm, np.zeros((500, 2))).v[-1, 0]
    from dataclasses import replace

    pushed = run(
        replace(arm, couplings=(CouplingTruth(0, 1, "viscous", 0.5),)), np.zeros((500, 2))
    ).v[-1, 0]
    assert quiet == 0.0 and pushed < -0.05


def test_runaway_is_reported_with_its_row() -> None:
    machine = MachineTruth("rotary", (JointTruth(),), (0.01,), kp=(-50.0,), q0=(0.1,))
    with pytest.raises(RuntimeError, match="ran away at row"):
        run(machine, STILL)
