"""Every concealed effect acts as its equation says: against another integrator, with sign(qd) for
friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from planar_arm import (
    BARE,
    PERIOD,
    SAMPLES,
    TWO_PI,
    Array,
    Case,
    bouc_wen,
    command,
    config,
    driven,
    entry,
    lagged,
    late,
    lines,
    on,
    point_mass,
    run_behind,
    run_plant,
    run_reference,
    swell,
    torque,
)
from plants import Plant

from zendsp_target.concealed.sealed import EFFECTS, Concealed, ConcealedEffect

E_K, E_C, E_J = 60.0, 0.3, 0.1
BOUC, BOUC_STATES = bouc_wen(1.5, 10.0)

WAVE = {"amplitude": 0.9, "period": 0.5, "phase": 0.4}
SPRING = {"stiffness": E_K, "load_inertia": E_J}
# effect, joint, parameters, and the same thing for the reference
CASES: list[tuple[str, int, dict[str, float], Case]] = [
    ("viscous", 1, {"coefficient": 4.0}, torque(1, lambda t, q, qd, tau: 4.0 * qd[0])),
    (
        "viscous_asymmetry", 2, {"coefficient_pos": 0.8, "coefficient_neg": 9.0},
        torque(2, lambda t, q, qd, tau: 0.8 * qd[1]),
    ),
    ("coulomb", 2, {"level": 1.0}, torque(2, lambda t, q, qd, tau: 1.0)),
    (
        "coulomb_asymmetry", 1, {"level_pos": 5.0, "level_neg": 90.0},
        torque(1, lambda t, q, qd, tau: 5.0),
    ),
    (
        "quadratic_drag", 2, {"coefficient": 0.9},
        torque(2, lambda t, q, qd, tau: 0.9 * qd[1] * abs(qd[1])),
    ),
    ("load_friction", 1, {"coefficient": 0.2}, torque(1, lambda t, q, qd, tau: 0.2 * abs(tau[0]))),
    (
        "position_friction", 2, WAVE,
        torque(2, lambda t, q, qd, tau: 0.9 * math.sin(TWO_PI * q[1] / 0.5 + 0.4)),
    ),
    (
        "friction_drift", 1, {"ratio": 0.8, "time_constant": 0.3},
        torque(1, lambda t, q, qd, tau: 0.8 * (1 - math.exp(-t / 0.3)) * (8.45 + 5.3 * qd[0])),
    ),
    (
        "gravity", 1, {"torque": 9.0, "angle": 0.5},
        torque(1, lambda t, q, qd, tau: 9.0 * math.sin(q[0] - 0.5)),
    ),
    (
        "stiffness", 2, {"coefficient": 3.0, "neutral": 0.2},
        torque(2, lambda t, q, qd, tau: 3.0 * (q[1] - 0.2)),
    ),
    (
        "cubic_stiffness", 2, {"coefficient": 4.0, "neutral": 0.1},
        torque(2, lambda t, q, qd, tau: 4.0 * (q[1] - 0.1) ** 3),
    ),
    ("inertia", 2, {"amount": 0.1}, lambda: run_reference(mass=entry(2, 2, 0.1))),
    (
        "coupling", 2, {"from_joint": 1.0, "law": 0.0, "coefficient": 0.15},
        lambda: run_reference(mass=entry(2, 1, 0.15)),
    ),
    (
        "coupling", 2, {"from_joint": 1.0, "law": 1.0, "coefficient": 0.6},
        torque(2, lambda t, q, qd, tau: 0.6 * qd[0] ** 2),
    ),
    (
        "coupling", 1, {"from_joint": 2.0, "law": 2.0, "coefficient": 3.0},
        torque(1, lambda t, q, qd, tau: 3.0 * qd[1]),
    ),
    (
        "coupling", 1, {"from_joint": 2.0, "law": 3.0, "coefficient": 6.0},
        torque(1, lambda t, q, qd, tau: 6.0),
    ),
    ("elasticity", 2, {"damping": E_C, **SPRING}, lambda: run_behind(E_K, E_C, 0.0, E_J)),
    (
        "backlash", 2, {"gap": 0.04, **SPRING},
        lambda: run_behind(E_K, 0.1 * math.sqrt(E_K * E_J), 0.04, E_J),
    ),
    (
        "hysteresis", 2, {"force": 1.5, "stiffness": 10.0, "exponent": 1.0},
        lambda: run_reference(BOUC, states=BOUC_STATES, x0=(0.0,)),
    ),
    (
        "ripple", 1, {"order": 8.0, "amplitude": 6.0, "phase": 0.7},
        torque(1, lambda t, q, qd, tau: 6.0 * math.sin(8 * q[0] + 0.7)),
    ),
    ("torque_gain", 1, {"ratio": -0.15}, driven(lambda t: command(t) * [0.85, 1.0])),
    ("torque_offset", 2, {"level": -0.8}, driven(lambda t: command(t) - [0.0, -0.8])),
    ("dead_zone", 1, {"width": 4.0}, driven(lambda t: command(t) - [4.0, 0.0])),
    ("saturation", 1, {"level": 29.0}, driven(lambda t: np.minimum(command(t), [29.0, 99.0]))),
    ("lag", 2, {"time_constant": 0.010}, driven(lagged)),
    ("delay", 1, {"time": 0.008}, driven(late)),
    (
        "disturbance", 2, {"level": 1.5, "begin": 0.2, "duration": 0.3},
        torque(2, lambda t, q, qd, tau: 1.5 * swell(t)),
    ),
]  # fmt: skip


DRY = {
    "coulomb", "coulomb_asymmetry", "load_friction", "position_friction", "friction_drift",
    "coupling",
}


@pytest.fixture(scope="module")
def bare() -> tuple[Array, Array]:
    return run_plant(BARE), run_reference()


def test_the_bare_arm_moves_as_its_equations_say(bare: tuple[Array, Array]) -> None:
    plant, reference = bare
    # a fortieth of an encoder count: RK4 and the exponential midpoint rule differ by less
    assert np.abs(plant - reference).max() < 1e-6
    assert np.diff(reference, axis=0).min() > 0.0 and reference[-1].max() < 2.15


@pytest.mark.parametrize(
    ("effect", "joint", "parameters", "reference"),
    CASES,
    ids=[f"{c[0]}-{c[2].get('law', '')}" for c in CASES],
)
def test_effect_moves_the_arm_as_its_equation_says(
    bare: tuple[Array, Array],
    effect: str,
    joint: int,
    parameters: dict[str, float],
    reference: Callable[[], Array],
) -> None:
    moved = run_plant(config(effect, joint, **parameters)) - bare[0]
    wanted = reference() - bare[1]
    size = np.abs(wanted).max()
    assert size > 3e-3, "the case must move the arm by much more than the tolerance"
    # A changed dry level takes the bristle a milliradian of travel to reach; all else differs by
    # the integrators alone.
    assert np.abs(moved - wanted).max() < (0.02 if effect in DRY else 5e-4) * size, effect


def test_the_table_covers_every_effect_that_this_file_does_not_test_on_its_own() -> None:
    own = {"stribeck", "presliding", "encoder_eccentricity", "foreign", "payload"}
    assert {case[0] for case in CASES} | own == set(EFFECTS)


@pytest.mark.parametrize(
    "joint", [2, pytest.param(1, marks=pytest.mark.long("joint 2 has both links' equations"))]
)
def test_a_payload_is_a_mass_on_its_link(bare: tuple[Array, Array], joint: int) -> None:
    text = config("payload", joint, mass=2.0, x=0.25, y=0.06, z=0.0)
    moved = run_plant(text) - bare[0]
    wanted = run_reference(mass=point_mass(2.0, 0.25, 0.06, joint)) - bare[1]
    # differences of differences: the reference's Jacobian is right to 1e-8
    assert np.abs(moved - wanted).max() < 1e-5 * np.abs(wanted).max()


def breakaway(text: str) -> float:
    """Torque at which joint 1 leaves its place on a slow ramp, N m."""
    with Plant("imi_planar", text) as plant:
        for k in range(20000):
            tau = 0.001 * k
            plant.torque([tau, 0.0])
            if plant.q[0] > 0.004:
                return tau
    return math.inf


def test_stribeck_raises_the_breakaway_torque_to_its_level() -> None:
    # ramp of 1 N m/s: half a second to leave
    assert breakaway(BARE) == pytest.approx(8.45, abs=0.7)
    assert breakaway(config("stribeck", 1, breakaway=16.0, velocity=0.1)) == pytest.approx(
        16.0, abs=1.0
    )


def test_presliding_gives_way_by_torque_over_stiffness_and_comes_back() -> None:
    with Plant("imi_planar", config("presliding", 1, stiffness=400.0)) as plant:
        for k in range(8000):  # slowly: the joint rings on its bristle
            plant.torque([min(4.0, 0.0005 * k), 0.0])
        pushed = plant.q[0]
        for k in range(8000):
            plant.torque([max(0.0, 4.0 - 0.0005 * k), 0.0])
        # the bristle softens towards the Coulomb level (Dahl 1968)
        assert pushed == pytest.approx(-8.45 / 400.0 * math.log(1.0 - 4.0 / 8.45), rel=0.1)
        assert abs(plant.q[0]) < 0.5 * pushed


def test_encoder_eccentricity_bends_the_reading_and_not_the_motion() -> None:
    text = config("encoder_eccentricity", 1, amplitude=0.02, phase=0.5)
    with Plant("imi_planar", text) as plant, Plant("imi_planar", BARE) as bare:
        for k in range(SAMPLES):
            q = plant.q[0]
            shown = plant.torque(command(k * PERIOD))[0]
            bare.torque(command(k * PERIOD))
            assert shown == pytest.approx(q + 0.02 * math.sin(q + 0.5), abs=1.1 / plant.counts[0])
        assert np.array_equal(plant.q, bare.q)


@pytest.mark.parametrize("law", [0.0, 1.0, 2.0])
def test_foreign_laws_move_the_arm_and_are_bounded(law: float, bare: tuple[Array, Array]) -> None:
    moved = run_plant(config("foreign", 1, law=law, amplitude=6.0)) - bare[0]
    assert 1e-3 < np.abs(moved).max() < 1.0


def test_two_effects_act_together(bare: tuple[Array, Array]) -> None:
    both = Concealed(
        "imi_planar",
        (
            ConcealedEffect("viscous", 1, {"coefficient": 4.0}),
            ConcealedEffect("inertia", 2, {"amount": 0.1}),
        ),
        "test",
        "plain",
    )
    moved = run_plant(lines(both)) - bare[0]
    wanted = run_reference(lambda t, q, qd, tau, x: on(1, 4.0 * qd[0]), entry(2, 2, 0.1)) - bare[1]
    assert np.abs(moved - wanted).max() < 0.03 * np.abs(wanted).max()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("effect1 = magic joint=1", "no effect 'magic'"),
        ("effect1 = coulomb joint=1", "coulomb lacks its parameter 'level'"),
        ("effect1 = coulomb joint=3 level=1", "joint out of range, the machine has 2"),
        ("effect1 = coulomb joint=1 level=abc", "level is 'abc', expected a number"),
        ("effect1 = coulomb joint=1 level=1 depth=2", "no parameter 'depth'"),
        ("friction = rough", "friction is 'rough'; expected full or plain"),
    ],
)
def test_a_machine_refuses_a_wrong_line_and_says_why(line: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Plant("imi_planar", line + "\n")
