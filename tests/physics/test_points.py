"""What a fit evaluates: a joint's innovations while the free numbers of a model move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.physics.calibration.fit import Data, fit, joint_handles, residual
from zendsp.physics.calibration.handles import Tie, free_handles, get_values, set_values
from zendsp.physics.calibration.points import Points
from zendsp.physics.calibration.predict import run_many
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.kernel.native import LANES

T, N = 0.002, 600
PLANAR = {
    "sample_time": T,
    "mechanism": {
        "kind": "planar2r",
        "parameters": {"p1": {"value": 0.02}, "p2": {"value": 0.01}, "p3": {"value": 0.005}},
    },
    "effect": [
        {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.02}},
        {"kind": "viscous", "joint": 2, "coefficient": {"value": 0.01}},
        {"kind": "coulomb", "joint": 2, "level": {"value": 0.02}},
        {"kind": "coupling", "joint": 2, "from_joint": 1, "law": 1, "coefficient": 0.01},
    ],
}
PENDULUM = {
    "sample_time": T,
    "mechanism": {
        "kind": "rotary",
        "parameters": {"inertia": {"value": 0.02}, "gravity": {"value": 0.2}},
    },
    "effect": [
        {"kind": "elasticity", "stiffness": 50.0, "damping": 0.01, "load_inertia": 0.005},
        {"kind": "coulomb", "level": {"value": 0.02}},
    ],
}


@pytest.mark.parametrize("given", [PENDULUM, PLANAR], ids=["pendulum", "planar"])
@pytest.mark.parametrize("count", [1, 7])
def test_a_point_gives_to_the_last_bit_what_the_model_with_its_numbers_gives(
    given: dict[str, object], count: int
) -> None:
    model = parse_model(given)
    model = replace(model, actuator=replace(model.actuator, gain_free=True))
    t, joints = np.arange(N) * T, model.joints
    u = 0.1 * np.sin(2 * np.pi * 1.3 * t)[:, None] * np.arange(1, joints + 1)
    q = 0.4 * np.sin(2 * np.pi * 0.9 * t)[:, None] * np.arange(1, joints + 1)
    signals = Signals("run", t, T, q, u, None, np.full(joints, 1e-4))
    data = prepare([signals], model, 64.0)
    handles = free_handles(model)  # also the numbers that another joint alone feels
    places = {"mechanism", "term", "gain"} | ({"offset"} if given is PENDULUM else set())
    assert {h.place for h in handles} == places
    x = get_values(model, handles)
    rng = np.random.default_rng(0)
    points = [x * (1 + 0.05 * rng.random(len(x))) + 1e-4 for _ in range(count)]
    for record in data.records[0]:
        expected = run_many(record, [set_values(model, handles, at) for at in points], 32.0)
        out = np.empty((record.n, LANES)) if count > 1 else np.empty(record.n)
        Points(record, model, handles, 32.0, 2).innovations(points, out)
        found = out[:, :count] if count > 1 else out[:, None]
        np.testing.assert_array_equal(found, expected)
        assert count == 1 or np.all(np.ptp(found, axis=1)[10:] > 0)  # else this says nothing


def test_a_tied_number_is_a_ratio_in_a_fit_and_itself_in_the_model() -> None:
    model = parse_model(PENDULUM)
    t = np.arange(N) * T
    q = 0.4 * np.sin(2 * np.pi * 0.9 * t)[:, None]
    data = prepare([Signals("run", t, T, q, 0.1 * q, None, np.full(1, 1e-4))], model, 64.0)
    tie = Tie("stiffness", 50.0 / 0.005, 100.0)
    handles = joint_handles(replace(data, ties={1: (tie,)}), model, 1)
    place = [h.key for h in handles].index("stiffness")
    assert handles[place].tie == tie and joint_handles(data, model, 1)[place].tie is None
    x = get_values(model, handles)
    assert x[place] == tie.ratio
    x[[h.key for h in handles].index("load_inertia")] = 0.007
    moved = set_values(model, handles, x)
    assert moved.terms[0].value("stiffness") == pytest.approx(70.0)
    record, out = data.records[0][0], np.empty(N)
    Points(record, model, handles, 32.0, 2).innovations([x], out)
    np.testing.assert_array_equal(out, run_many(record, [moved], 32.0)[:, 0])


def test_numbers_that_a_joint_does_not_feel_are_not_run_again() -> None:
    model = parse_model(PLANAR)
    t = np.arange(N) * T
    q = 0.4 * np.sin(2 * np.pi * 0.9 * t)[:, None] * np.ones(2)
    data = prepare([Signals("run", t, T, q, q, None, np.full(2, 1e-4))], model, 64.0)
    handles = free_handles(model)
    x = get_values(model, handles)
    only_second = next(
        i for i, h in enumerate(handles) if h.place == "term" and model.terms[h.index].joint == 2
    )
    other = x.copy()
    other[only_second] *= 2
    first, second = (np.empty((record.n, LANES)) for record in data.records[0])
    for record, out in zip(data.records[0], (first, second), strict=True):
        Points(record, model, handles, 32.0, 2).innovations([x, other, x], out)
    np.testing.assert_array_equal(first[:, 0], first[:, 1])
    assert np.any(second[:, 0] != second[:, 1])
    np.testing.assert_array_equal(second[:, 0], second[:, 2])


def test_a_prediction_has_the_same_digits_whatever_was_fitted_before() -> None:
    """What eight lanes of a fit ended with had others, and which threads left it was chance."""
    model = parse_model(PLANAR)
    t = np.arange(N) * T
    u = 0.1 * np.sin(2 * np.pi * 1.3 * t)[:, None] * np.ones(2)
    q = 0.4 * np.sin(2 * np.pi * 0.9 * t)[:, None] * np.ones(2)

    def recorded() -> Data:
        return prepare([Signals("run", t, T, q, u, None, np.full(2, 1e-4))], model, 32.0)

    data, handles = recorded(), joint_handles(recorded(), model, 2)
    fitted = fit(data, model, handles, joints=(2,), iterations=3, brief=True)
    anew = residual(recorded(), fitted.model, (2,))
    np.testing.assert_array_equal(residual(data, fitted.model, (2,)), anew)
