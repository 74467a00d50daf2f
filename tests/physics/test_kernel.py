"""The compiled kernel against differential equations integrated elsewhere (Runge-Kutta of fourth
order, ten steps a sample and more), effect by effect.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from integrated import (
    STIFF,
    J,
    N,
    State,
    T,
    Torque,
    command,
    dry,
    integrate,
    kernel,
    recorded,
    rigid,
    warmth,
)

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.physics.calibration.observed import response, trace
from zendsp.physics.calibration.predict import RAN_AWAY, run, run_many
from zendsp.physics.effects import library
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Quantity, Term

SMOOTH: dict[str, tuple[dict[str, float], Torque]] = {
    "viscous": ({"coefficient": 0.02}, lambda q, v, t, u: 0.02 * v),
    "viscous_asymmetry": (
        {"coefficient_pos": 0.02, "coefficient_neg": 0.05},
        lambda q, v, t, u: (0.02 if v > 0 else 0.05) * v,
    ),
    "quadratic_drag": ({"coefficient": 0.01}, lambda q, v, t, u: 0.01 * v * abs(v)),
    "gravity": ({"torque": 0.1, "angle": 0.3}, lambda q, v, t, u: 0.1 * math.sin(q - 0.3)),
    "stiffness": ({"coefficient": 0.2, "neutral": 0.1}, lambda q, v, t, u: 0.2 * (q - 0.1)),
    "cubic_stiffness": ({"coefficient": 0.1, "neutral": 0.0}, lambda q, v, t, u: 0.1 * q**3),
    "ripple": (
        {"order": 5.0, "amplitude": 0.05, "phase": 0.7},
        lambda q, v, t, u: 0.05 * math.sin(5 * q + 0.7),
    ),
    "torque_offset": ({"level": 0.02}, lambda q, v, t, u: 0.02),
    # what the drive does not give is a torque that resists
    "gain_drift": (
        {"ratio": -0.3, "time_constant": 0.7},
        lambda q, v, t, u: 0.3 * u * (1 - math.exp(-t / 0.7)),
    ),
    "voltage_limit": (
        {"level": 0.14, "slope": 0.05},
        lambda q, v, t, u: u - max(-0.14 - 0.05 * v, min(0.14 - 0.05 * v, u)),
    ),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_torque_is_integrated_to_second_order(name: str) -> None:
    parameters, law = SMOOTH[name]
    true, without = rigid(law), rigid(lambda *_: 0.0)
    term = {"kind": name, "joint": 1, **parameters}
    coarse, fine = (np.max(np.abs(kernel(true, [term], inner) - true)) for inner in (2, 8))
    size = np.max(np.abs(true - without))
    assert coarse < 0.01 * size  # a hundredth of what the effect does
    # sixteen times less in theory; kinks at reversals cost some
    assert fine < 0.3 * coarse + 1e-5 * size


def reaches(u: float, v: float) -> float:
    """Torque x that remains of a drive's u behind a friction of 0.04 + 0.3 |x| against the speed v.
    """
    rest = u - math.copysign(0.04, v)
    return abs(rest) / (1.0 + math.copysign(0.3, v * rest))


DRY: dict[str, tuple[list[dict[str, Any]], Torque]] = {
    "coulomb": ([{"kind": "coulomb", "level": 0.05}], lambda q, v, t, u: dry(0.05)(v)),
    "coulomb_asymmetry": (
        [{"kind": "coulomb_asymmetry", "level_pos": 0.03, "level_neg": 0.06}],
        lambda q, v, t, u: dry(0.03 if v > 0 else 0.06)(v),
    ),
    # in the kernel's form the Stribeck parameter is the excess over the Coulomb level
    "stribeck": (
        [
            {"kind": "coulomb", "level": 0.03},
            {"kind": "stribeck", "breakaway": 0.03, "velocity": 0.5},
        ],
        lambda q, v, t, u: dry(0.03 + 0.03 * math.exp(-((v / 0.5) ** 2)))(v),
    ),
    "position_friction": (
        [
            {"kind": "coulomb", "level": 0.04},
            {"kind": "position_friction", "amplitude": 0.02, "period": 0.5, "phase": 0.2},
        ],
        lambda q, v, t, u: dry(0.04 + 0.02 * math.sin(2 * math.pi * q / 0.5 + 0.2))(v),
    ),
    "load_friction": (
        [{"kind": "load_friction", "coefficient": 0.3}],
        lambda q, v, t, u: dry(0.3 * abs(u))(v),
    ),
    "friction of the load": (
        [
            {"kind": "coulomb", "level": 0.04},
            {"kind": "load_friction", "coefficient": 0.3, "of": "load"},
        ],
        lambda q, v, t, u: dry(0.04 + 0.3 * reaches(u, v))(v),
    ),
    "friction_drift": (
        [
            {"kind": "coulomb", "level": 0.05},
            {"kind": "friction_drift", "ratio": -0.5, "time_constant": 1.0},
        ],
        lambda q, v, t, u: dry(0.05 * (1 - 0.5 * (1 - math.exp(-t))))(v),
    ),
    "friction_temperature": (
        [
            {"kind": "coulomb", "level": 0.05},
            {"kind": "friction_temperature", "coefficient": -0.04, "reference": 25.0},
        ],
        lambda q, v, t, u: dry(0.05 * (1 - 0.04 * (warmth(t) - 25)))(v),
    ),
}


def test_a_light_joint_that_rubs_and_is_damped_needs_no_small_steps() -> None:
    light = 7e-4
    terms = [
        {"kind": "viscous", "joint": 1, "coefficient": 0.1},
        {"kind": "coulomb", "joint": 1, "level": 0.05},
    ]
    start = np.zeros(N)
    coarse, fine = (kernel(start, terms, inner, light) for inner in (2, 64))
    assert np.max(np.abs(coarse - fine)) < 2e-3 * np.ptp(fine)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5, 2.0, 3.7])
def test_sines_and_powers_of_the_kernel_are_those_of_the_library(exponent: float) -> None:
    """The kernel has its own, inlined: they hold many turns away, and from standstill to ten times
    a law's speed.
    """
    falls = {"kind": "stribeck", "breakaway": 0.2, "velocity": 0.3, "exponent": exponent}
    wave = {"kind": "ripple", "order": 1000.0, "amplitude": 1.0, "phase": 0.7}
    model, record = recorded(np.zeros(N), [{"joint": 1, **t} for t in (falls, wave)])
    q, v = np.linspace(-50.0, 50.0, N), np.geomspace(1e-6, 3.0, N)
    record.motion.states[:2] = q, v
    friction, ripple = (trace(record, model, (term,), 1e-12) for term in model.terms)
    breakaway = model.terms[0].value("breakaway")
    assert friction == pytest.approx(breakaway * np.exp(-((v / 0.3) ** exponent)), abs=1e-13)
    assert ripple == pytest.approx(np.sin(1000.0 * q + 0.7), abs=1e-10)


@pytest.mark.parametrize("name", DRY)
def test_dry_friction_sticks_and_slides_like_a_steep_smooth_law(name: str) -> None:
    terms, law = DRY[name]
    true, without = rigid(law, sub=STIFF), rigid(lambda *_: 0.0)
    got = kernel(true, [{"joint": 1, **t} for t in terms], 8)
    assert np.max(np.abs(got - true)) < 0.02 * np.max(np.abs(true - without))


@pytest.mark.parametrize(("shape", "lead"), [("round", 0.0), ("straight", 0.0), ("straight", 0.01)])
def test_dry_friction_that_creeps_grows_with_the_speed_or_with_the_speed_ahead(
    shape: str, lead: float
) -> None:
    level, slow = 0.05, 0.2

    def law(q: float, v: float, t: float, u: float) -> float:
        if shape == "round":
            return level * math.tanh(v / slow)
        gives = level / slow * (J * v + lead * u) / (J + lead * level / slow)
        return max(-level, min(level, gives))

    term = {"kind": "creep", "joint": 1, "speed": slow, "lead": lead, "shape": shape}
    true, holds = rigid(law, sub=STIFF), rubbing_by_pieces(level)
    got = kernel(true, [{"kind": "coulomb", "joint": 1, "level": level}, term], 2)
    # steps of 1 ms, of second order: 2.2e-4; taken at the speed of their end alone 1e-2
    assert np.max(np.abs(got - true)) < 5e-4 * np.max(np.abs(true - holds))


def test_friction_that_creeps_slowly_is_as_exact_where_the_joint_turns_round() -> None:
    """All that changes within a step there acted as at its end: 2.8e-3 rad, three times what a
    friction that holds is off.
    """
    level, slow = 0.05, 5e-4
    terms = [
        {"kind": "coulomb", "joint": 1, "level": level},
        {"kind": "creep", "joint": 1, "speed": slow, "shape": "round"},
    ]
    true = rigid(lambda q, v, t, u: level * math.tanh(v / slow), sub=4 * STIFF)
    off = np.max(np.abs(true - rubbing_by_pieces(level)))
    assert np.max(np.abs(kernel(true, terms, 2) - true)) < 0.1 * off


def rubbing_by_pieces(level: float, late: float = 0.0) -> np.ndarray:
    """Exact position of a joint with set-valued friction, piece by piece between changes of the
    command, which comes ``late`` s, and stops.
    """
    q, v, true, u = 0.0, 0.0, [], command()
    for k in range(N):
        true.append(q)
        for torque, left in ((u[max(k - 1, 0)], late), (u[k], T - late)):
            while left > 0.0:
                moves = math.copysign(1.0, v or torque)
                a = (torque - math.copysign(level, moves)) / J if v or abs(torque) > level else 0.0
                stands = -v / a if a * v < 0.0 else math.inf
                step = min(left, stands)
                q += step * (v + 0.5 * a * step)
                v, left = 0.0 if stands <= left else v + a * step, left - step
    return np.array(true)


@pytest.mark.parametrize("inner", [1, 2])
def test_a_joint_that_turns_round_within_a_step_is_exact(inner: int) -> None:
    true = rubbing_by_pieces(0.05)
    got = kernel(true, [{"kind": "coulomb", "joint": 1, "level": 0.05}], inner)
    assert np.max(np.abs(got - true)) < 1e-12 * np.ptp(true)


def test_a_command_that_changes_within_a_step_is_exact_but_where_the_joint_turns_round() -> None:
    true, at_once, late = rubbing_by_pieces(0.05, 0.0007), rubbing_by_pieces(0.05), 0.0007
    terms = [
        {"kind": "coulomb", "joint": 1, "level": 0.05},
        {"kind": "delay", "joint": 1, "time": late},
    ]
    got = kernel(true, terms, 1)
    assert np.max(np.abs(got - true)) < 0.02 * np.max(np.abs(true - at_once))


def test_added_inertia_slows_the_joint() -> None:
    true = rigid(lambda *_: 0.0, inertia=J + 0.004)
    got = kernel(true, [{"kind": "inertia", "joint": 1, "amount": 0.004}], 2)
    assert np.max(np.abs(got - true)) < 2e-3 * np.ptp(true)


def test_bristles_bend_as_lugre_says() -> None:
    level, s0, s1 = 0.05, 60.0, 0.1

    def derivative(x: State, _t: float, u: float) -> State:
        rate = x[1] - s0 * abs(x[1]) * x[2] / level
        return x[1], (u - s0 * x[2] - s1 * rate) / J, rate

    true = integrate(derivative, 3)[:, 0]
    without = rigid(lambda q, v, t, u: dry(level)(v), sub=STIFF)
    terms = [
        {"kind": "coulomb", "joint": 1, "level": level},
        {"kind": "presliding", "joint": 1, "stiffness": s0, "damping": s1},
    ]
    coarse, fine = (np.max(np.abs(kernel(true, terms, inner) - true)) for inner in (2, 8))
    size = np.max(np.abs(true - without))  # what bending does beside plain friction
    # of second order: sixteen times less in theory
    assert coarse < 0.02 * size and fine < 0.1 * coarse


def test_hysteresis_remembers_as_bouc_and_wen_say() -> None:
    force, stiffness, n = 0.08, 0.8, 1.5
    rate = stiffness / force

    def derivative(x: State, _t: float, u: float) -> State:
        z, v = x[2], x[1]
        zdot = rate * (v - 0.5 * abs(v) * abs(z) ** (n - 1) * z - 0.5 * v * abs(z) ** n)
        return v, (u - force * z) / J, zdot

    true, without = integrate(derivative, 3)[:, 0], rigid(lambda *_: 0.0)
    got = kernel(
        true,
        [{"kind": "hysteresis", "joint": 1, "force": force, "stiffness": stiffness, "exponent": n}],
        8,
    )
    assert np.max(np.abs(got - true)) < 0.01 * np.max(np.abs(true - without))


def test_coupling_torque_integrates_to_the_velocity_of_the_other_joint() -> None:
    terms = [{"kind": "viscous", "joint": j, "coefficient": 0.1} for j in (1, 2)]
    arm = {"kind": "planar2r", "parameters": {"p1": 0.3, "p2": 0.05, "p3": 0.04}}
    model = parse_model(
        {
            "mechanism": arm,
            "effect": terms,
            "sample_time": T,
            "columns": {"position": ["a", "b"], "command": ["c", "d"]},
        }
    )
    t = np.arange(N) * T
    # the second joint's push has a period of 0.9 s
    q = np.stack([np.sin(3 * t), 0.5 * np.sin(7 * t)], axis=1)
    signals = Signals("made", t, T, q, np.zeros((N, 2)), None, np.zeros(2))
    first, second = prepare([signals], model).records[0]
    # of the first joint's acceleration on the second, over its inertia p2
    push = np.cumsum(second.basis["p2"].bias) * T
    moved = first.motion.states[1] - first.motion.states[1][0]
    assert np.max(np.abs(push[:-1] - moved[1:])) < 1e-9


def varied(model: Model, factor: float) -> Model:
    """The model with every number of its effects and its inertia times a factor."""
    terms = tuple(
        Term(
            t.effect,
            t.joint,
            {k: Quantity(q.value * factor, q.free) for k, q in t.parameters.items()},
        )
        for t in model.terms
    )
    items = {
        key: tuple(Quantity(q.value * factor, q.free) for q in values)
        for key, values in model.mechanism.items()
    }
    return replace(model, terms=terms, mechanism=items)


# a value of each kind of number that lets the effect act on the recording
TYPICAL = {
    "torque": 0.03, "torque/speed": 0.01, "torque/speed2": 0.005, "torque/position": 30.0,
    "torque/position3": 0.1, "speed": 0.3, "position": 0.01, "time": 0.004, "ratio": 0.2,
    "angle": 0.5, "order": 3.0, "inertia": 0.003, "command": 0.05, "number": 1.0, "mass": 0.3,
    "length": 0.1, "body_inertia": 0.003, "temperature": 25.0, "1/temperature": 0.03,
}


@functools.cache
def rubbing() -> np.ndarray:
    """A motion against dry friction."""
    return rigid(lambda q, v, t, u: dry(0.04)(v), sub=STIFF)


@pytest.mark.parametrize("name", [e for e in library() if e != "coupling"])
def test_many_parameter_sets_at_once_predict_what_each_of_them_predicts_alone(name: str) -> None:
    effect = library()[name]
    term = {"kind": name, **{p.name: max(TYPICAL[p.size], p.lower) for p in effect.parameters}}
    needed = [{"kind": "coulomb", "level": 0.03}] if name != "coulomb" else []
    model, record = recorded(rubbing(), [*needed, term])
    # more than fit into one pass, and not a multiple
    models = [varied(model, 1.0 + 0.05 * i) for i in range(11)]
    alone = np.stack([run(record, m, 16.0).innovations for m in models], axis=1)
    together = run_many(record, [*models, models[3]], 16.0)
    # they differ, or the comparison says nothing
    assert np.all(np.ptp(alone, axis=1)[N // 2 :] > 0)
    np.testing.assert_allclose(together[:, :11], alone, rtol=1e-6, atol=1e-8 * np.std(alone))
    np.testing.assert_array_equal(together[:, 11], together[:, 3])


def test_a_small_inertia_behind_much_viscous_friction_is_followed() -> None:
    """For example the last joint of an arm, which comes to rest within a fifteenth of a sample."""
    damping = 15.0 * J / T
    position = rigid(lambda q, v, t, u: damping * v, sub=200)
    model, record = recorded(position, [{"kind": "viscous", "coefficient": damping}])
    followed = run(record, model, 16.0).innovations
    finely = run(record, model, 16.0, inner=128).innovations
    wrong = run(record, varied(model, 1.05), 16.0, inner=128).innovations  # 5 % of the friction
    assert np.std(followed - finely) < 0.2 * np.std(wrong - finely)


def test_a_diverging_prediction_does_not_affect_those_computed_beside_it() -> None:
    model, record = recorded(
        rubbing(),
        [{"kind": "viscous", "coefficient": 0.01}],
    )
    away = replace(
        model, terms=(replace(model.terms[0], parameters={"coefficient": Quantity(-50.0)}),)
    )
    one, lost, two = run_many(record, [model, away, varied(model, 1.1)], 16.0).T
    np.testing.assert_allclose(one, run(record, model, 16.0).innovations, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        two, run(record, varied(model, 1.1), 16.0).innovations, rtol=1e-9, atol=1e-12
    )
    marked = lost == RAN_AWAY
    assert marked[-1] and not marked[0]
    np.testing.assert_array_equal(marked, run(record, away, 16.0).innovations == RAN_AWAY)


def test_a_filter_gives_the_samples_that_are_asked_for_of_doubles_and_of_floats() -> None:
    _, record = recorded(rubbing(), [{"kind": "viscous", "coefficient": 0.01}])
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((19, record.n))  # more than one register, not a multiple of it
    inertia, damping = np.full(record.n, J), np.full(record.n, 0.01)
    then = rng.random(record.n), 7
    rows = np.arange(3, record.n - 7, 5, dtype=np.int32)
    whole = response(record, 16.0, inertia, damping, columns, then=then)
    some = response(record, 16.0, inertia, damping, columns, then=then, rows=rows)
    np.testing.assert_array_equal(some, whole[:, rows])
    single = columns.astype(np.float32)
    rounded = response(record, 16.0, inertia, damping, single, then=then, rows=rows)
    np.testing.assert_allclose(rounded, some, atol=1e-6 * np.abs(some).max())
