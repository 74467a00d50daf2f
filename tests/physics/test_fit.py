"""Calibration: right parameters with honest standard deviations, whatever the step of the
integrator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from math import copysign, sin, tanh
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.measure.likelihood import (
    deviance,
    fit_scored,
    fitted_deviance,
    tune_bandwidth,
)
from zendsp.physics.calibration.convergence import step_error, with_step_error
from zendsp.physics.calibration.covariance import _scores, robust_covariance
from zendsp.physics.calibration.descent import Descent
from zendsp.physics.calibration.fit import Data, fit
from zendsp.physics.calibration.handles import free_handles, get_values, set_values
from zendsp.physics.calibration.predict import run
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.kernel.native import native

Array = npt.NDArray[np.float64]

T, N = 0.002, 3000
TRUE = np.array([0.010, 0.004, 0.03, 0.2])  # inertia, viscous, coulomb, gravity
COUNT = 2 * np.pi / 16384


def recording(seed: int) -> Signals:
    """Six seconds in open loop with torques that reverse: plain Python at 20 kHz, friction by a
    smooth step.
    """
    r = np.random.default_rng(seed)
    t = np.arange(N) * T
    f, p = np.geomspace(0.3, 5.0, 8), r.uniform(0, 6.28, 8)
    u = 0.25 * sum(np.sin(2 * np.pi * a * t + b) for a, b in zip(f, p, strict=True)) / 2
    J, b, level, weight = TRUE
    q, v, out, h = 0.0, 0.0, [], T / 40
    for k in range(N):
        out.append(q)
        # held near zero by a loop that is part of the command below
        torque = float(u[k]) - 3.0 * q - 0.05 * v
        for _ in range(40):
            s = tanh(v / 5e-4) if abs(v) < 0.01 else copysign(1.0, v)
            slope = level / 5e-4 * (1 - s * s)
            v += h * (torque - b * v - level * s - weight * sin(q)) / (J + h * slope)
            q += h * v
        u[k] = torque
    y = COUNT * np.round(np.array(out) / COUNT)
    return Signals(f"run {seed}", t, T, y[:, None], u[:, None], None, np.array([COUNT]))


MODEL = {
    "sample_time": T,
    "mechanism": {
        "kind": "rotary",
        "parameters": {"inertia": {"value": 0.0103}, "gravity": {"value": 0.19}},
    },
    "effect": [
        {"kind": "viscous", "joint": 1, "coefficient": {"value": 0.008}},
        {"kind": "coulomb", "joint": 1, "level": {"value": 0.01}},
    ],
}


@pytest.fixture(scope="module")
def data() -> Data:
    return prepare([recording(1), recording(2)], parse_model(MODEL), 64.0)


def _fit(data: Data, inner: int) -> dict[str, tuple[float, float]]:
    model = parse_model(MODEL)
    scored = fit_scored(replace(data, inner=inner), model, free_handles(model, offsets=False), (1,))
    result = scored.fit
    names = {"mechanism": lambda h: h.key, "term": lambda h: h.key}
    return {
        names[h.place](h): (float(x), float(s))
        for h, x, s in zip(result.handles, result.x, result.std, strict=True)
    }


def test_parameters_are_found_with_honest_standard_deviations(data: Data) -> None:
    found = _fit(data, 2)
    for name, true in zip(("inertia", "coefficient", "level", "gravity"), TRUE, strict=True):
        value, std = found[name]
        # reality's friction has a slope of its own below 1 mrad/s, which no sharp step describes: a
        # few percent of the smallest term
        assert value == pytest.approx(true, rel=0.04 if name == "coefficient" else 0.01), name
        assert 0 < std < 0.02 * true, name


def test_standard_deviations_shrink_with_the_recordings(data: Data) -> None:
    half = replace(data, records=data.records[:1])
    one, two = _fit(half, 2), _fit(data, 2)
    ratio = [one[name][1] / two[name][1] for name in two]
    assert 1.0 < np.median(ratio) < 2.2  # the root of two, give or take the recordings' difference


def test_parameters_do_not_depend_on_the_integration_step(data: Data) -> None:
    two, four = _fit(data, 2), _fit(data, 4)
    for name, (value, std) in two.items():
        # the scheme is of second order: half the step moves a parameter by no more than what is
        # uncertain anyway
        assert abs(value - four[name][0]) < max(2 * std, 1e-3 * abs(value)), name


def test_the_integration_step_hardly_matters_even_with_a_reversal_within_it(data: Data) -> None:
    one, eight = _fit(data, 1), _fit(data, 8)
    for name, (value, std) in one.items():
        assert abs(value - eight[name][0]) < 0.5 * std, name


def test_the_effect_of_the_integration_step_is_known_without_another_fit(data: Data) -> None:
    bristles = {"kind": "presliding", "joint": 1, "stiffness": {"value": 2000.0, "free": False}}
    model = parse_model({**MODEL, "effect": [*MODEL["effect"], bristles]})
    handles = free_handles(model, offsets=False)
    coarse, fine = replace(data, inner=1), replace(data, inner=8)
    one, eight = (fit(d, model, handles, joints=(1,), iterations=20) for d in (coarse, fine))
    told, really = step_error(coarse, one, (1,)), eight.x - one.x
    assert np.max(np.abs(really / one.std)) > 1.0  # a step so coarse that it matters
    # to first order
    assert (np.abs(told - really) < np.maximum(1.2 * one.std, 0.3 * np.abs(really))).all()
    large = np.abs(really) > one.std
    assert large.any() and (np.sign(told) == np.sign(really))[large].all()
    certain = with_step_error(coarse, one, (1,))
    assert (certain.std >= np.abs(told)).all() and (certain.std >= one.std).all()


@pytest.mark.parametrize(
    ("begin", "added", "expected"),
    [
        (  # small and far off: what brings it there makes neutral position and stiffness one number
            {"kind": "stiffness", "coefficient": 0.001, "neutral": -3.0},
            lambda q: 0.08 * (q - 0.3),
            {"coefficient": 0.08, "neutral": 0.3},
        ),
        (  # half a turn off, where a step along the phase alone leads nowhere
            {"kind": "ripple", "order": 6.0, "amplitude": 0.002, "phase": -2.4},
            lambda q: 0.02 * np.sin(6.0 * q + 0.6),
            {"amplitude": 0.02, "phase": 0.6},
        ),
    ],
)
def test_few_steps_lead_to_a_spring_and_a_wave_from_far_off(
    data: Data, begin: dict[str, object], added: Any, expected: dict[str, float]
) -> None:
    signals = []
    for seed in (1, 2):
        seen = recording(seed)  # moved as before by a command that also bears the added torque
        signals.append(replace(seen, command=seen.command + added(seen.position)))
    held = {k: {"value": v, "free": k != "order"} for k, v in begin.items() if k != "kind"}
    term = {"kind": begin["kind"], "joint": 1, **held}
    known = {"inertia": {"value": 0.0103}, "gravity": {"value": TRUE[3], "free": False}}
    mechanism = {"kind": "rotary", "parameters": known}
    model = parse_model({**MODEL, "mechanism": mechanism, "effect": [*MODEL["effect"], term]})
    found = fit(
        prepare(signals, model, 16.0),
        model,
        free_handles(model, offsets=False),
        iterations=4,
    )
    for name, value in expected.items():
        number = found.model.terms[-1].value(name)
        number = math.remainder(number, 2 * math.pi) if name == "phase" else number
        assert number == pytest.approx(value, rel=0.05), name


def test_handles_read_and_write_the_same_numbers() -> None:
    model = parse_model(MODEL)
    handles = free_handles(model)
    x = get_values(model, handles) * 1.5 + 0.001
    again = set_values(model, handles, x)
    np.testing.assert_allclose(get_values(again, handles), x)
    # the model itself is untouched
    np.testing.assert_allclose(get_values(model, handles), (x - 0.001) / 1.5)


def test_numbers_that_are_not_free_keep_their_values() -> None:
    fixed = parse_model(
        {
            **MODEL,
            "mechanism": {
                "kind": "rotary",
                "parameters": {"inertia": {"value": 0.01, "free": False}, "gravity": 0.0},
            },
        }
    )
    keys = [h.key for h in free_handles(fixed)]
    assert "inertia" not in keys  # fixed by hand
    assert "gravity" not in keys  # zero: physics that the model does not have
    assert keys == ["coefficient", "level"]


def test_a_thinned_recording_gives_nearly_the_same_parameters(data: Data) -> None:
    thin = data.thinned()
    whole, short = _fit(data, 2), _fit(thin, 2)
    assert [rec[0].n for rec in thin.records] == [N // 2, N // 2]  # 4 ms of 2 ms
    for name, (value, _) in whole.items():
        # a first look only begins a fit: 5 % is well within the basin of any parameter
        assert short[name][0] == pytest.approx(value, rel=0.05), name


def test_the_liveliest_part_is_that_stretch_of_the_recording_and_predicted_alike(
    data: Data,
) -> None:
    record, model = data.records[0][0], parse_model(MODEL)
    part = data.liveliest(1, 0.5 * N * T).records[0][0]
    assert part.n == N // 2
    lively = np.mean(part.motion.states[2] ** 2)
    ends = (record.motion.states[2][: N // 2], record.motion.states[2][N // 2 :])
    assert lively >= max(np.mean(end**2) for end in ends)
    begin = part.first
    assert part.t0 == record.t0 + begin * T
    np.testing.assert_array_equal(part.command, record.command[begin : begin + part.n])
    whole, cut = (run(r, model, 32.0).innovations for r in (record, part))
    settled = part.n // 4  # an observer of 32 rad/s has forgotten where it began
    np.testing.assert_allclose(
        cut[settled:], whole[begin + settled : begin + part.n], atol=1e-3 * np.std(whole)
    )
    assert data.liveliest(1, 2 * N * T).records[0][0] is record  # as long as all of it


def test_thinning_keeps_the_measurements_and_the_impulse_of_the_command(data: Data) -> None:
    record = data.records[0][0]
    for every in (2, 3, 7):
        thin = record.thinned(every)
        groups = record.n // every
        said = np.where(record.counted, 1.0 / record.measurement.variance, 0.0)
        kept = np.where(thin.counted, 1.0 / thin.measurement.variance, 0.0)
        assert thin.n == groups
        assert kept.sum() == pytest.approx(said[: groups * every].sum())
        # the integral of the command at the ends of the groups is that of the recording
        assert thin.integral == pytest.approx(record.integral[: groups * every + 1 : every])


def test_the_deviance_of_a_fit_is_that_of_its_model(data: Data) -> None:
    model = parse_model(MODEL)
    result = fit(data, model, free_handles(model), joints=(1,))
    # the kernel's lanes and its single pass differ in the last digits of a sine
    assert fitted_deviance(data, result, (1,)) == pytest.approx(
        deviance(data, result.model, (1,)), abs=1e-3
    )
    tuned, value = tune_bandwidth(data, result.model, (1,))
    assert value == deviance(tuned, result.model, (1,))


@pytest.fixture
def passes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The points of each pass that a fit takes from now on."""
    taken: list[int] = []
    evaluate = Descent.evaluate

    def counted(self: Descent, points: Sequence[Array]) -> Array:
        taken.append(len(points))
        return evaluate(self, points)

    monkeypatch.setattr(Descent, "evaluate", counted)
    return taken


def test_a_fit_that_cannot_get_where_it_is_of_use_ends_at_its_first_step(
    data: Data, passes: list[int]
) -> None:
    model = parse_model(MODEL)
    handles = free_handles(model)
    whole = fit(data, model, handles, joints=(1,))
    near = fit(data, model, handles, joints=(1,), iterations=1)
    passes.clear()
    fit(data, near.model, handles, joints=(1,), goal=0.8 * whole.cost)
    assert passes == [1 + len(handles)]
    useful = fit(data, model, handles, joints=(1,), goal=1.01 * whole.cost)
    np.testing.assert_array_equal(useful.x, whole.x)


def test_a_brief_fit_takes_no_derivative_where_a_step_ends_it(
    data: Data, passes: list[int]
) -> None:
    model = parse_model(MODEL)
    handles = free_handles(model)
    brief = fit(data, model, handles, joints=(1,), tolerance=0.1, brief=True)
    assert passes[-1] == 1 < passes[-2]
    whole = fit(data, model, handles, joints=(1,))
    assert brief.cost < 1.1 * whole.cost


def test_a_fit_that_is_asked_for_again_is_remembered_and_its_terms_are_the_callers_own(
    data: Data, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = parse_model(MODEL)
    handles = free_handles(model, offsets=False)
    first = fit(data, model, handles, joints=(1,), iterations=2)
    passes = 0
    whole = native().lib

    class Counted:
        def __getattr__(self, name: str) -> object:
            nonlocal passes
            passes += 1
            return getattr(whole, name)

    monkeypatch.setattr(native(), "lib", Counted())
    again = fit(data, parse_model(MODEL), handles, joints=(1,), iterations=2, jobs=1)
    assert passes == 0
    np.testing.assert_array_equal(again.x, first.x)
    np.testing.assert_array_equal(again.residual, first.residual)
    assert not {id(t) for t in again.model.terms} & {id(t) for t in first.model.terms}
    # whatever it depends on, is fitted anew
    moved = set_values(model, handles, get_values(model, handles) * 1.01)
    for other in (
        fit(data, moved, handles, joints=(1,), iterations=2),
        fit(data, model, handles[1:], joints=(1,), iterations=2),
        fit(data.at_bandwidth(1, 32.0), model, handles, joints=(1,), iterations=2),
        fit(replace(data, records=data.records[:1]), model, handles, joints=(1,), iterations=2),
        fit(data, model, handles, joints=(1,), iterations=1),
    ):
        assert other.cost != first.cost


@pytest.mark.parametrize("misfit", [1.0, 100.0])
def test_a_number_correlated_with_a_known_one_has_the_uncertainty_that_follows(
    misfit: float
) -> None:
    """This holds however large the residuals are."""
    draw = np.random.default_rng(1)
    pattern = draw.standard_normal(4000)
    jacobian = np.stack([pattern, pattern], axis=1)
    known = 0.01
    covariance = robust_covariance(
        jacobian, misfit * draw.standard_normal(4000), 50, np.array([0.0, 1.0 / known])
    )
    std = np.sqrt(np.diag(covariance))
    assert std[1] == pytest.approx(known, rel=0.05)
    assert std[0] == pytest.approx(np.hypot(known, misfit / np.sqrt(4000)), rel=0.2)


@pytest.mark.parametrize("rows", [100, 250, 700])
def test_a_last_block_may_be_shorter_in_a_covariance(rows: int) -> None:
    rng = np.random.default_rng(1)
    jac, r = rng.standard_normal((rows, 3)), rng.standard_normal(rows)
    one_by_one = [r[i : i + 250] @ jac[i : i + 250] for i in range(0, rows, 250)]
    assert _scores(jac, r, 250) == pytest.approx(np.array(one_by_one))
