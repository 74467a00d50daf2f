"""A fit by the Jacobian of a model nearby ends where its own fit does, or says that it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_fit import MODEL, recording

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.measure import likelihood
from zendsp.diagnosis.measure.likelihood import fit_scored
from zendsp.physics.calibration import predict
from zendsp.physics.calibration.chord import fit_near
from zendsp.physics.calibration.fit import Data, Fit, fit, residual
from zendsp.physics.calibration.handles import free_handles
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Quantity, Term


@pytest.fixture(scope="module")
def data() -> Data:
    return prepare([recording(1), recording(2)], parse_model(MODEL), 16.0)


@pytest.fixture(scope="module")
def final(data: Data) -> Fit:
    model = parse_model(MODEL)
    return fit(data, model, free_handles(model), joints=(1,))


def sprung(model: Model, stiffness: float) -> Model:
    """A model with a spring that no fit moves."""
    numbers = {"coefficient": Quantity(stiffness), "neutral": Quantity(0.3)}
    spring = Term("stiffness", 1, numbers).held()
    return model.with_terms((*model.terms, spring))


def test_a_small_implant_is_fitted_without_by_the_jacobian_of_the_final_model(
    data: Data, final: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = sprung(final.model, 0.003)  # 1 % of the torque
    whole = fit(data, model, final.handles, joints=(1,))
    passes: list[int] = []
    run = predict.run_many
    monkeypatch.setattr(predict, "run_many", lambda *a, **k: passes.append(1) or run(*a, **k))
    near = fit_near(data, model, final, 1)
    assert near is not None and not passes, "one set of numbers a step"
    # where the Jacobian changes with the numbers, its minimum is another: by a part of the gain
    gained = np.log(whole.cost / final.cost)
    assert np.log(near.cost / whole.cost) == pytest.approx(0.0, abs=0.01 * gained)
    assert np.all(np.abs(near.x - whole.x) < 0.5 * whole.std)
    # the last step is taken to first order, and no residual is computed there
    here = residual(data, near.model, (1,))
    assert float(here @ here) == pytest.approx(near.cost, rel=1e-3)


def test_a_model_that_is_not_near_is_left_to_a_fit_of_its_own(data: Data, final: Fit) -> None:
    far = sprung(final.model, 1.0)
    assert fit_near(data, far, final, 1) is None
    held = fit(data, final.model, (), joints=(1,))
    assert fit_near(data, final.model, held, 1) is None, "a machine without free numbers had failed"
    scored = fit_scored(data, far, final.handles, (1,), rounds=1, near=lambda _: final)
    whole = fit_scored(data, far, final.handles, (1,), rounds=1)
    np.testing.assert_array_equal(scored.fit.x, whole.fit.x)


def test_no_observer_is_tried_after_the_last_fit(
    data: Data, final: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would be thrown away: of a fit that is tried under one observer, three passes of four."""
    tuned: list[int] = []
    tune = likelihood.tune_bandwidth
    monkeypatch.setattr(
        likelihood, "tune_bandwidth", lambda *a, **k: tuned.append(1) or tune(*a, **k)
    )
    fit_scored(data, final.model, final.handles, (1,), rounds=1)
    assert not tuned
    fit_scored(data.at_bandwidth(1, 64.0), final.model, final.handles, (1,), rounds=2)
    assert tuned == [1]


def test_the_predictions_that_are_asked_for_most_stay(data: Data, final: Fit) -> None:
    record = data.records[0][0]
    one = predict.run(record, final.model, 16.0)
    for i in range(2 * predict.REMEMBERED):
        predict.run(record, sprung(final.model, 1e-3 * (i + 1)), 16.0)
        assert predict.run(record, replace(final.model), 16.0) is one
