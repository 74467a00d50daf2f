"""Every kind: valid by default on every machine, derivatives that belong to the positions, and its
own law.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from zendsp.cli.reference import command as reference_command
from zendsp.errors import ReferenceError_
from zendsp.reference import (
    JUMPS,
    KINDS,
    MACHINES,
    Reference,
    crest_factor,
    forward_kinematics,
    load_machine,
    make_circle,
    make_lspb,
    make_multisine,
    make_prbs,
    make_reference,
    make_swing,
    make_torque_law,
    make_trapezoid,
    make_triangle,
    plot_reference,
    predict_motion,
)


@cache
def planned(machine: str, kind: str) -> Reference:
    """The default reference of a kind, planned once for all tests."""
    return make_reference(kind, machine)


@cache
def swung() -> Reference:
    """A swing of the pendulum of fewer intervals than the default, planned once for all tests."""
    return make_swing(
        load_machine("pendulum"), goal=2.0, duration=0.5, torque_limit=0.5, intervals=50
    )


PAIRS = [
    (m, k) for m in MACHINES for k in KINDS if k != "from_file" and KINDS[k].fits(load_machine(m))
]


@pytest.mark.parametrize(("machine", "kind"), PAIRS)
def test_defaults_of_every_kind_are_playable_on_every_machine(machine: str, kind: str) -> None:
    reference = planned(machine, kind)
    load_machine(machine).check(reference)
    assert reference.machine == machine and reference.joints == load_machine(machine).joints


@pytest.mark.parametrize(("machine", "kind"), [p for p in PAIRS if p[1] != "step"])
def test_velocity_and_acceleration_are_the_derivatives_of_position(machine: str, kind: str) -> None:
    reference = swung() if kind == "swing" else planned(machine, kind)
    dt = reference.sample_time
    for x, xd in ((reference.q, reference.qd), (reference.qd, reference.qdd)):
        # what one sample of the derivative adds up to; the trapezoid rule errs by a jump of the
        # derivative in one sample
        grown = 0.5 * dt * (xd[1:] + xd[:-1])
        jump = np.abs(np.diff(xd, axis=0)).max(axis=0)
        assert np.all(np.abs(np.diff(x, axis=0) - grown) <= dt * jump + 1e-9)


def test_of_a_step_only_what_is_known_is_said_checked_and_drawn() -> None:
    arm = load_machine("imi_planar")
    step = make_reference("step", arm, amplitude=0.5)
    assert step.jumps and arm.torque(step) is None
    assert not any(planned(m, kind).jumps for m, kind in PAIRS if kind != "step")
    panels = [axis.get_ylabel() for axis in plot_reference(step, arm).axes]
    assert panels == ["q [rad]", "y [m]"]
    said = CliRunner().invoke(reference_command, ["step", "--amplitude", "0.5"])
    assert said.exit_code == 0 and JUMPS in said.output
    assert "within the limits of position" in said.output
    assert said.output.count("–") == 6, "no speed, acceleration or torque of either joint"
    with pytest.raises(ReferenceError_, match="position"):
        arm.check(make_reference("step", arm, amplitude=3.0))


def test_lspb_of_the_wam_paper_cruises_at_0_083_rad_per_s() -> None:
    reference = make_lspb(
        load_machine("wam7"), start=-0.55, goal=-0.05, duration=7.0, blend_time=1.0
    )
    # 4·0.5/(49 - 25), printed as 0.083
    assert reference.qd.max() == pytest.approx(0.5 / 6.0, rel=1e-12)
    assert reference.q[-1] == pytest.approx(np.full(7, -0.05))


def test_lspb_reaches_its_goal_for_any_blend_time() -> None:
    reference = make_lspb(
        load_machine("pendulum"), start=0.0, goal=1.0, duration=4.0, blend_time=0.5
    )
    assert reference.q[-1, 0] == pytest.approx(1.0, abs=1e-12)
    assert reference.qdd.max() == pytest.approx(1.0 / (0.5 * 3.5))


@pytest.mark.parametrize("elbow", ["positive", "negative"])
def test_circle_keeps_its_radius_and_its_elbow(elbow: str) -> None:
    arm = load_machine("imi_planar")
    reference = make_circle(arm, radius=0.12, x=0.45, y=0.1, elbow=elbow)  # type: ignore[arg-type]
    tip = forward_kinematics(arm, reference.q)
    assert np.hypot(tip[:, 0] - 0.45, tip[:, 1] - 0.1) == pytest.approx(
        np.full(len(tip), 0.12), abs=1e-12
    )
    assert np.all(reference.q[:, 1] > 0) == (elbow == "positive")


def test_trapezoid_returns_after_every_speed() -> None:
    reference = make_trapezoid(
        load_machine("wam7"), joint=3, start=0.1, travel=0.4, speeds=[0.1, 0.3], acceleration=2.0
    )
    assert reference.q[-1, 2] == pytest.approx(0.1, abs=1e-9)
    assert {round(float(v), 9) for v in np.abs(reference.qd[:, 2])} >= {0.1, 0.3}
    assert np.all(reference.q[:, [0, 1, 3, 4, 5, 6]] == 0.1)


def test_trapezoid_says_which_speed_its_travel_cannot_reach() -> None:
    with pytest.raises(
        ReferenceError_, match=r"travel of 0.1 rad .* reaches 0.4472 rad/s, not 1 rad/s"
    ):
        make_trapezoid(load_machine("wam7"), start=0.0, travel=0.1, speeds=[1.0], acceleration=2.0)


def test_triangle_cycles_repeat_row_by_row() -> None:
    reference = make_triangle(load_machine("imi_planar"), start=0.0, peak=1.0, rise=0.5, cycles=3)
    per_cycle = round(2.0 / reference.sample_time)
    cycles = reference.qd[:-1, 0].reshape(3, per_cycle)
    assert np.abs(cycles - cycles[0]).max() < 1e-9
    assert reference.qd.max() == pytest.approx(1.0)


def test_multisine_has_low_crest_and_no_line_shared_by_two_joints() -> None:
    reference = make_multisine(
        load_machine("imi_planar"), start=0.0, amplitude=0.3, period=10.0, f_min=0.1, f_max=3.0,
        spectrum="flat", fade_time=0.0,
    )
    period = reference.q[:10000]
    # random phases of 15 lines have a crest factor of about 2.5; Schroeder's about 1.7
    assert all(crest_factor(period[:, j]) < 1.55 for j in range(2))
    spectrum = np.abs(np.fft.rfft(period, axis=0))
    strong = spectrum > 1e-6 * spectrum.max()
    assert not np.any(strong[:, 0] & strong[:, 1])
    assert strong[:, 0].sum() == 15 and strong[:, 1].sum() == 15
    assert np.abs(reference.q).max() == pytest.approx(0.3, rel=1e-3)


def test_prbs_has_the_autocorrelation_of_a_maximum_length_sequence() -> None:
    reference = make_prbs(
        load_machine("pendulum"), quantity="torque", start=0.0, amplitude=0.2, order=6, clock=0.01
    )
    assert reference.tau is not None
    bits = reference.tau[:-1:10, 0] / 0.2
    correlation = np.fft.ifft(np.abs(np.fft.fft(bits)) ** 2).real
    assert correlation[0] == pytest.approx(63.0) and correlation[1:] == pytest.approx(
        np.full(62, -1.0)
    )


def test_torque_law_is_the_one_of_the_paper() -> None:
    reference = make_torque_law(load_machine("pendulum"), duration=2.0)
    assert reference.tau is not None and reference.mode == "torque"
    for t in (0.0, 0.5, 2.0):
        law = (
            0.3 * (1 - np.exp(-1.8 * t)) + 0.1 * np.sin(26 * t + 0.08) + 0.1 * np.sin(12 * t + 0.34)
        )
        assert reference.tau[round(t / 0.001), 0] == pytest.approx(law, abs=1e-12)


def test_swing_reaches_the_goal_when_an_adaptive_integrator_plays_its_torque() -> None:
    from scipy.integrate import solve_ivp

    machine, reference = load_machine("pendulum"), swung()
    assert reference.tau is not None and np.abs(reference.tau).max() <= 0.5 + 1e-6
    p, dt = machine.parameters, reference.sample_time

    def rate(t: float, x: np.ndarray, tau: float) -> list[float]:  # type: ignore[type-arg]
        resist = (
            p["theta2"] * 9.81 * np.sin(x[0])
            + p["theta3"] * np.tanh(p["beta"] * x[1])
            + p["viscous"] * x[1]
        )
        return [x[1], (tau - resist) / p["theta1"]]

    x = np.zeros(2)
    for k in range(0, reference.samples - 1, 10):  # an interval is 10 samples of equal torque
        x = solve_ivp(
            rate,
            (0, 10 * dt),
            x,
            args=(reference.tau[k, 0],),
            method="LSODA",
            rtol=1e-9,
            atol=1e-11,
        ).y[:, -1]
    # rad, rad/s: what the collocation and the simulation differ by
    assert x == pytest.approx([2.0, 0.0], abs=0.02)


def test_time_optimal_swing_is_faster_with_more_torque_and_slower_with_friction() -> None:
    machine = load_machine("pendulum")
    durations = [
        make_swing(
            machine, goal=2.0, objective="time", torque_limit=limit, friction=friction, intervals=20
        ).duration
        for limit, friction in ((0.5, 0.1), (0.8, 0.1), (0.5, 0.0))
    ]
    assert durations[1] < durations[0] and durations[2] < durations[0]


def test_time_optimal_swing_pushes_and_brakes_with_all_the_torque_that_is_allowed() -> None:
    reference = make_swing(
        load_machine("pendulum"), objective="time", torque_limit=0.3, intervals=50
    )
    assert reference.tau is not None
    used = np.abs(reference.tau[:-1, 0])
    # Bang-bang (Pontryagin), but for less than one held level of slack, which makes the switch
    # softer.
    assert np.mean(used > 0.95 * 0.3) > 0.8
    assert (
        reference.tau[5, 0] > 0.29 and reference.tau[-10, 0] < -0.29 and reference.duration < 0.44
    )


@pytest.mark.long("a weak motor's swing is planned below; lost: that it begins backwards")
def test_a_weak_motor_pumps_the_pendulum_up() -> None:
    """One solution of six took 110 s, and another limit no end."""
    reference = make_swing(load_machine("pendulum"), objective="time", torque_limit=0.2)
    assert reference.tau is not None
    assert reference.q.min() < -0.5, "no torque of 0.2 N m lifts it at once: 0.1668 beside 0.1"
    assert np.abs(reference.tau).max() <= 0.2 + 1e-9
    assert reference.q[-1, 0] == pytest.approx(np.pi, abs=0.05)


WEAK = pytest.mark.long("that of least energy is planned as well; lost: one of least time")


@pytest.mark.parametrize(
    ("torque", "objective"),
    [pytest.param(0.2, "time", marks=WEAK), (0.5, "time"), (0.2, "energy")],
)
def test_a_swing_keeps_the_limit_of_acceleration(torque: float, objective: str) -> None:
    """One of 0.2 N m was planned with 242 rad/s^2, beyond the 175 of its headroom."""
    limited = load_machine("pendulum").limits.acceleration * 0.7
    reference = make_reference(
        "swing", "pendulum", torque_limit=torque, objective=objective, duration=3.0, headroom=0.7,
        intervals=100,
    )  # fmt: skip
    assert np.abs(reference.qdd).max() <= limited[0]
    assert load_machine("pendulum").find_violations(reference) == []


def test_a_swing_with_more_torque_than_is_allowed_is_told_what_fits_a_swing() -> None:
    machine = load_machine("pendulum")
    reference = make_reference(
        "swing", machine, torque_limit=0.6, objective="time", headroom=0.7, intervals=20
    )
    with pytest.raises(ReferenceError_, match="take a lower torque_limit or a nearer goal, or use"):
        machine.check(reference)


def test_an_impossible_swing_is_refused_with_what_to_change() -> None:
    with pytest.raises(ReferenceError_, match="allow more torque, more time or a nearer goal"):
        make_swing(
            load_machine("pendulum"), goal=3.0, duration=0.02, torque_limit=0.05, intervals=10
        )


def test_prediction_of_free_fall_matches_an_adaptive_integrator() -> None:
    from scipy.integrate import solve_ivp

    machine = load_machine("imi_planar")
    tau = np.tile([30.0, -5.0], (501, 1))
    q, qd, _ = predict_motion(machine.dynamics, tau, 0.001, np.zeros(2))

    def rate(t: float, x: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
        return np.concatenate(
            [x[2:], machine.dynamics.acceleration(x[:2].tolist(), x[2:].tolist(), [30.0, -5.0])]
        )

    end = solve_ivp(rate, (0, 0.5), np.zeros(4), method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.concatenate([q[-1], qd[-1]]) == pytest.approx(end, rel=1e-5, abs=1e-6)


def test_a_reference_of_wrong_shape_or_with_nan_is_refused() -> None:
    with pytest.raises(ReferenceError_, match="qd has shape"):
        Reference(np.zeros((5, 2)), 0.001, np.zeros((5, 1)))
    with pytest.raises(ReferenceError_, match="joint 2 is nan at sample 3"):
        q = np.zeros((5, 2))
        q[3, 1] = np.nan
        Reference(q, 0.001)
