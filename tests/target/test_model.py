"""The compiled runtime and machine against an independent model: NumPy and SciPy, other equations'
form, another integrator.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from samples import rows_of, run
from scipy.integrate import solve_ivp

from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime, program_text

Make = Callable[..., Runtime]
Array = npt.NDArray[np.float64]

COUNTS = 153600.0 / (2.0 * np.pi)
MV_PER_NM = np.array([10000.0 / 245.0, 10000.0 / 39.2])
# level for qd > 0, for qd < 0
COULOMB = np.array([[8.45 * 1.05, 8.45 * 0.95], [2.35 * 0.96, 2.35 * 1.04]])
BREAKAWAY = np.array([[11.4 * 1.05, 11.4 * 0.95], [3.1 * 0.96, 3.1 * 1.04]])
VISCOUS = np.array([[5.3 * 1.02, 5.3 * 0.98], [1.1 * 0.97, 1.1 * 1.03]])
STRIBECK = np.array([0.08, 0.10])
SIGMA0, SIGMA1 = np.array([12000.0, 1500.0]), np.array([60.0, 6.0])


def derivative(_t: float, state: Array, torque: Array) -> Array:
    """Planar arm with LuGre friction, written from the Lagrangian: M qdd + Mdot qd - 1/2 d(qd' M
    qd)/dq = net torque.
    """
    q, qd, z = state[0:2], state[2:4], state[4:6]
    p1, p2, p3 = 3.473, 0.196, 0.242
    c, s = np.cos(q[1]), np.sin(q[1])
    mass = np.array([[p1 + 2 * p3 * c, p2 + p3 * c], [p2 + p3 * c, p2]])
    mass_dot = -p3 * s * qd[1] * np.array([[2.0, 1.0], [1.0, 0.0]])
    half_gradient = np.array([0.0, 0.5 * -p3 * s * (2.0 * qd[0] ** 2 + 2.0 * qd[0] * qd[1])])
    side = np.where(qd >= 0.0, 0, 1)
    joint = np.arange(2)
    fade = np.exp(-((qd / STRIBECK) ** 2))
    level = COULOMB[joint, side] + (BREAKAWAY - COULOMB)[joint, side] * fade
    z_dot = qd - SIGMA0 * np.abs(qd) * z / level
    friction = SIGMA0 * z + SIGMA1 * fade * z_dot + VISCOUS[joint, side] * qd
    qdd = np.linalg.solve(mass, torque - friction - mass_dot @ qd + half_gradient)
    return np.concatenate([qd, qdd, z_dot])


class PD:
    """The law of pd.c with its circle, in NumPy."""

    kp, kd = np.array([2000.0, 300.0]), np.array([120.0, 12.0])

    def __init__(self, q0: Array) -> None:
        self.start, self.last, self.last_r = q0, q0, q0
        self.qd, self.rd = np.zeros(2), np.zeros(2)

    def __call__(self, k: int, counts: Array, dt: float) -> tuple[Array, Array]:
        q, t = counts / COUNTS, k * dt
        s = min(1.0, t / 1.5)
        blend = 10 * s**3 - 15 * s**4 + 6 * s**5
        phi = 2.0 * np.pi * t / 4.5
        target = np.array([0.2, 0.6]) + 0.4 * np.array([np.cos(phi), np.sin(phi)])
        r = self.start + blend * (target - self.start)
        a = 1.0 - np.exp(-2.0 * np.pi * 80.0 * dt)
        self.qd = self.qd + a * ((q - self.last) / dt - self.qd)
        self.rd = self.rd + a * ((r - self.last_r) / dt - self.rd)
        self.last, self.last_r = q, r
        return self.kp * (r - q) + self.kd * (self.rd - self.qd), r


def simulate(samples: int, dt: float) -> tuple[Array, Array]:
    """Counts and torques of every sample: hold, one sample of delay, floor quantiser."""
    state, held = np.zeros(6), np.zeros(2)
    law = PD(np.zeros(2))
    counts, torques = np.empty((samples, 2)), np.empty((samples, 2))
    for k in range(samples):
        acting = held
        counts[k] = np.floor(state[0:2] * COUNTS)
        torques[k], _ = law(k, counts[k], dt)
        held = torques[k]
        # LSODA changes to an implicit method where the bristles are stiff
        step = solve_ivp(
            derivative, (0.0, dt), state, method="LSODA", rtol=1e-9, atol=1e-12, args=(acting,)
        )
        state = step.y[:, -1]
    return counts, torques


def test_the_closed_loop_agrees_with_an_independent_model(make_runtime: Make) -> None:
    samples = 900
    runtime = make_runtime(program_text("pd"), machine_config={"ideal": 1.0})
    rows = rows_of(runtime, ("enc", "tau", "aout"), samples)
    counts, torques = simulate(samples, 1e-3)
    assert np.ptp(counts[:, 0]) > 3000  # it moved, through stiction
    assert np.ptp(counts[:, 1]) > 3000
    # the quantiser turns any difference into a count now and then, and the loop feeds it back
    assert np.max(np.abs(rows[:, 0:2] - counts)) <= 2.0
    # one count through the derivative of joint 1: 120 N m s/rad · 0.395 · 4.1e-5 rad / 1 ms = 1.9 N
    # m
    assert np.max(np.abs(rows[:, 2:4] - torques)) < 2.1
    # and that in fewer than one sample in twenty
    assert np.sqrt(np.mean((rows[:, 2:4] - torques) ** 2)) < 1.9 / np.sqrt(20.0)
    # the command acts one sample after it was computed
    assert np.allclose(rows[1:, 4:6], rows[:-1, 2:4] * MV_PER_NM, rtol=1e-12)


def test_both_clocks_give_identical_results(make_runtime: Make) -> None:
    found = []
    for clock, rate in (("fast", 1000.0), ("real", 1000.0)):
        runtime = make_runtime(program_text("pd"), clock=clock, rate_hz=rate)
        runtime.write({"Kp1": 2500.0}, "me", at_tick=300)
        found.append(rows_of(runtime, ("tick", "t", "enc", "tau", "aout", "qd1"), 800))
    assert np.array_equal(found[0], found[1])


def test_pauses_leave_no_trace_in_the_results(make_runtime: Make) -> None:
    found = []
    for pieces in ((600,), (1, 99, 250, 250)):
        runtime = make_runtime(program_text("pd"))
        runtime.acquire_configure(0, AcquireConfig(("tick", "enc", "tau", "aout"), seconds=0.6))
        runtime.acquire_start(0)
        for ticks in pieces:
            run(runtime, ticks)
        found.append(runtime.acquire_read(0, 0, 600))
    assert np.array_equal(found[0], found[1])


def test_halving_the_inner_step_moves_positions_by_less_than_a_count_in_ten_seconds(
    make_runtime: Make,
) -> None:
    """Open loop, where nothing pulls two solutions together: torques that reverse and stick."""
    law = """
    #include "isr.h"
    static double q[2];
    void UserInit(void) { SIGNAL(q, "rad", ""); }
    void UserISR_INT2(void) {
        const double t = SAMPLE_TIME;
        WRITE_TORQUE(0, 13.0 * sin(2.0 * t) + 3.0 * sin(7.0 * t));
        WRITE_TORQUE(1, 3.5 * sin(3.0 * t));
    }
    """
    found = []
    for substep in (1e-4, 5e-5):
        runtime = make_runtime(law, machine_config={"ideal": 1.0, "substep": substep})
        runtime.acquire_configure(0, AcquireConfig(("enc",), seconds=10.0))
        runtime.acquire_start(0)
        runtime.start(ticks=10_000)
        runtime.wait_paused(60.0)
        found.append(runtime.acquire_read(0, 0, 10_000))
    assert np.ptp(found[0][:, 0]) > 5000
    # floor() may show a difference far below one count as one count, where a position passes an
    # edge
    assert np.max(np.abs(found[0] - found[1])) <= 1.0
    assert np.mean(found[0] != found[1]) < 0.05
