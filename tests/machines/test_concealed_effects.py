"""Every concealed effect acts as its equation says: against another integrator, with sign(qd) for
friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from plants import Plant

from zendsp_target.concealed.sealed import EFFECTS, Concealed, ConcealedEffect

Array = np.ndarray  # type: ignore[type-arg]
P1, P2, P3 = 3.473, 0.196, 0.242
VISCOUS, COULOMB = np.array([5.3, 1.1]), np.array([8.45, 2.35])
# N m/rad, of imi_planar.c with plain friction: a sliding bristle is bent by the Coulomb level
BRISTLE = 2000.0 * np.array([12000.0, 1500.0])
SAMPLES, PERIOD, STEPS = 500, 0.001, 4


# rad/s: both joints slide from the first instant on, so that sign(qd) = 1 throughout
START = np.array([0.8, 1.2])


def command(t: float) -> Array:
    """Torques that keep both joints moving one way, N m."""
    return np.array([26.0 + 6.0 * math.sin(9.0 * t), 6.4 + 0.9 * math.sin(14.0 * t)])


# plain friction and no electronics: nothing but the equations
BARE = "friction = plain\nideal = 1\n"


def lines(hidden: Concealed) -> str:
    return "ideal = 1\n" + "".join(f"{k} = {v}\n" for k, v in hidden.config().items())


def config(effect: str, joint: int, **parameters: float) -> str:
    hidden = Concealed(
        "imi_planar", (ConcealedEffect(effect, joint, parameters),), "test", friction="plain"
    )
    return lines(hidden)


def run_plant(text: str) -> Array:
    with Plant("imi_planar", text) as plant:
        rows = []
        for j in range(2):
            plant.truth.qd[j] = START[j]
            plant.truth.z[j] = COULOMB[j] / BRISTLE[j]
        for k in range(SAMPLES):
            rows.append(plant.q)
            plant.torque(command(k * PERIOD))
        return np.array(rows)


Extra = Callable[[float, Array, Array, Array, Array], Array]
Case = Callable[[], Array]  # joint positions of the reference


def run_reference(
    torque: Extra | None = None,
    mass: Array | Callable[[Array], Array] | None = None,
    actuator: Callable[[float], Array] = command,
    states: Callable[[float, Array, Array, Array], Array] | None = None,
    x0: tuple[float, ...] = (),
) -> Array:
    """RK4 of M qdd + c + viscous qd + coulomb + extra = tau held over each sample; extra may have
    states x of its own.
    """

    def added(q: Array) -> Array:
        return np.zeros((2, 2)) if mass is None else mass(q) if callable(mass) else mass

    def rate(t: float, y: Array, tau: Array) -> Array:
        q, qd, x = y[:2], y[2:4], y[4:]
        c, s = P3 * math.cos(q[1]), P3 * math.sin(q[1])
        m = np.array([[P1 + 2 * c, P2 + c], [P2 + c, P2]]) + added(q)
        bias = gyroscopic(added, q, qd) if callable(mass) else np.zeros(2)
        bias += np.array([-s * qd[1] * (2 * qd[0] + qd[1]), s * qd[0] ** 2])
        bias += VISCOUS * qd + COULOMB
        extra = np.zeros(2) if torque is None else torque(t, q, qd, tau, x)
        qdd = np.linalg.solve(m, tau - bias - extra)
        return np.concatenate([qd, qdd, np.zeros(0) if states is None else states(t, q, qd, x)])

    y, rows, h = np.concatenate([np.zeros(2), START, x0]), [], PERIOD / STEPS
    for k in range(SAMPLES):
        rows.append(y[:2])
        tau = actuator(k * PERIOD)
        for i in range(STEPS):
            t = k * PERIOD + i * h
            k1 = rate(t, y, tau)
            k2 = rate(t + h / 2, y + h / 2 * k1, tau)
            k3 = rate(t + h / 2, y + h / 2 * k2, tau)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, y + h * k3, tau))
    return np.array(rows)


def gyroscopic(mass: Callable[[Array], Array], q: Array, qd: Array) -> Array:
    """The torque C qd of a mass matrix that changes with position (Lagrange, by differences)."""
    step = 1e-6 * np.eye(2)
    # [k, i, j] = dM_ij / dq_k
    slope = np.array([(mass(q + h) - mass(q - h)) / 2e-6 for h in step])
    return np.einsum("kij,k,j->i", slope, qd, qd) - 0.5 * np.einsum("ijk,j,k->i", slope, qd, qd)


def point_mass(kg: float, x: float, y: float, link: int) -> Callable[[Array], Array]:
    """Mass matrix of a point at (x, y) on a link: m J^T J of its place on the table."""

    def place(q: Array) -> Array:
        if link == 1:
            a, base = q[0], np.zeros(2)
        else:
            a, base = q[0] + q[1], 0.36 * np.array([math.cos(q[0]), math.sin(q[0])])
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.asarray(base + turn @ np.array([x, y]))

    def matrix(q: Array) -> Array:
        J = np.array([(place(q + h) - place(q - h)) / 2e-4 for h in 1e-4 * np.eye(2)])
        return np.asarray(kg * J @ J.T)

    return matrix


def on(joint: int, value: float) -> Array:
    out = np.zeros(2)
    out[joint - 1] = value
    return out


def entry(row: int, column: int, value: float) -> Array:
    out = np.zeros((2, 2))
    out[row - 1, column - 1] = value
    return out


def lagged(t: float) -> Array:
    """Joint 2 through a lag of 10 ms, from zero: mean over the sample of the exact answer."""
    T, u = 0.010, 0.0
    for k in range(round(t / PERIOD)):
        u += (command(k * PERIOD)[1] - u) * (1 - math.exp(-PERIOD / T))
    h = PERIOD / T
    goal = command(t)
    return np.array([goal[0], u + (goal[1] - u) * (1 - (1 - math.exp(-h)) / h)])


def run_behind(k: float, c: float, gap: float, load: float) -> Array:
    """RK4 of both links, the second behind a spring or gap: motor (y[1], y[3]) and link (y[4:])."""

    def push(bend: float, rate: float) -> float:
        inside = abs(bend) - gap / 2
        if gap == 0.0:
            return k * bend + c * rate
        if inside <= 0.0:
            return 0.0
        return math.copysign(max(0.0, k * inside + c * rate * math.copysign(1, bend)), bend)

    def rate(y: Array, tau: Array) -> Array:
        (_, motor, v1, vm, link, vl), turned = y, P2 - load
        cos, sin = P3 * math.cos(link), P3 * math.sin(link)
        m = np.array([[P1 + 2 * cos, P2 + cos], [P2 + cos, P2 - turned]])
        bias = np.array([-sin * vl * (2 * v1 + vl), sin * v1**2])
        held = push(motor - link, vm - vl)
        a1, al = np.linalg.solve(m, [tau[0] - VISCOUS[0] * v1 - COULOMB[0], held] - bias)
        am = (tau[1] - VISCOUS[1] * vm - COULOMB[1] - held) / turned
        return np.array([v1, vm, a1, am, vl, al])

    y, rows, h = np.array([0.0, 0.0, *START, 0.0, 0.0]), [], PERIOD / STEPS
    for n in range(SAMPLES):
        rows.append(y[:2])
        tau = command(n * PERIOD)
        for _ in range(STEPS):
            k1 = rate(y, tau)
            k2 = rate(y + h / 2 * k1, tau)
            k3 = rate(y + h / 2 * k2, tau)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3, tau))
    return np.array(rows)


def bouc_wen(
    force: float, stiffness: float
) -> tuple[Extra, Callable[[float, Array, Array, Array], Array]]:
    A = stiffness / force

    def states(t: float, q: Array, qd: Array, x: Array) -> Array:
        return np.array([A * (qd[1] - 0.5 * (abs(qd[1]) * x[0] + qd[1] * abs(x[0])))])

    return (lambda t, q, qd, tau, x: on(2, force * x[0])), states


E_K, E_C, E_J = 60.0, 0.3, 0.1
BOUC, BOUC_STATES = bouc_wen(1.5, 10.0)
TWO_PI = 2 * math.pi


def torque(joint: int, law: Callable[[float, Array, Array, Array], float]) -> Case:
    """The reference with one more torque that resists; the law is one of t, q, qd and tau."""
    return lambda: run_reference(lambda t, q, qd, tau, x: on(joint, law(t, q, qd, tau)))


def driven(actuator: Callable[[float], Array]) -> Case:
    return lambda: run_reference(actuator=actuator)


def swell(t: float) -> float:
    """A push between 0.2 and 0.5 s."""
    return math.sin(math.pi * (t - 0.2) / 0.3) ** 2 if 0.2 < t < 0.5 else 0.0


def late(t: float) -> Array:
    """Joint 1 by 8 ms."""
    return np.array([command(t - 0.008)[0] if t > 0.0079 else 0.0, command(t)[1]])


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
