"""A given spring in a transmission, beside something that is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.explain import given_springs
from zendsp.diagnosis.explain.given_springs import upon_given_springs
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.screen import Screen
from zendsp.physics.calibration.fit import Data, fit, residual
from zendsp.physics.calibration.joint import along
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

SPRING = {"kind": "elasticity", "joint": 1, "stiffness": 10.0, "damping": 0.02}
MODEL = model_of(VISCOUS, COULOMB, {**SPRING, "load_inertia": 0.006})


def recording(wobble: float) -> Data:
    """Of a load on its spring, through whose resonance an uneven transmission sweeps."""
    machine = reality.Machine(load=0.006, soft=10.0, wobble=wobble, limit=20.0)
    motion = reality.multisine(8.0, RATE, 3, size=3.0, high=2.0)
    return data_of(reality.simulate(machine, motion, RATE), MODEL)


def searcher_of(data: Data, given: Model) -> Searcher:
    return Searcher(data, 1, lambda *_, **__: True, 1, lambda _: None, given)


def test_a_given_spring_that_calibration_bends_away_is_searched_upon_as_it_was_given() -> None:
    """An uneven transmission behind a spring of 19 Hz: without it, calibration had made a spring
    without a load, and a search upon that found an error of the sensor.
    """
    data = recording(0.02)
    base, searcher = calibrate_joint(data, MODEL, 1), searcher_of(data, MODEL)
    assert base.model.terms[2].value("load_inertia") < 0.001
    found = upon_given_springs(JointSearch(1, base), MODEL, searcher)
    now = {t.effect: t for t in found.final.model.at(1)}
    assert set(now) == {"viscous", "coulomb", "elasticity", "transmission_error"}
    assert now["transmission_error"].value("amplitude") == pytest.approx(0.02, rel=0.05)
    assert now["transmission_error"].value("order") == pytest.approx(5.0, abs=0.01)
    spring = now["elasticity"]
    assert spring.value("load_inertia") == pytest.approx(0.006, rel=0.05)
    assert all(spring.parameters[key].free for key in ("stiffness", "damping", "load_inertia"))
    assert found.base is base, "what lacks is what the calibrated model lacks"


def test_a_spring_that_stays_in_its_basin_is_searched_upon_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def again(*_: Any) -> Any:
        raise AssertionError("searched again")

    monkeypatch.setattr(given_springs, "calibrate_joint", again)
    monkeypatch.setattr(given_springs, "is_white", lambda *_: False)
    data = recording(0.0)
    search = JointSearch(1, calibrate_joint(data, MODEL, 1))
    assert upon_given_springs(search, MODEL, searcher_of(data, MODEL)) is search


def test_the_screen_expects_of_a_transmission_error_what_a_spring_passes_on() -> None:
    """As in a rigid transmission, its torque behind a spring of 32 Hz was of another phase, and an
    order of 55 was screened for one of 8.
    """
    data = recording(0.0)
    data = data.at_bandwidth(1, 8.0)
    fitted = fit(data, MODEL, (), joints=(1,), iterations=0)
    numbers = {"order": 5.0, "amplitude": 1e-3, "phase": 0.6}
    term = make_term(get_effect("transmission_error"), 1, numbers)
    expected = Screen(data, fitted, 1, (1,)).series([(term,)])[0]
    model = MODEL.with_terms((*MODEL.terms, term))
    shown = residual(data, model, (1,)) - residual(data, MODEL, (1,))
    alike = float(expected @ shown) / float(np.linalg.norm(expected) * np.linalg.norm(shown))
    assert alike > 0.95 and np.linalg.norm(shown) == pytest.approx(np.linalg.norm(expected), 0.2)
    motion = along(data.records[0][0], MODEL)
    rigid = get_effect("transmission_error").column
    assert rigid is not None
    values = {name: q.value for name, q in term.parameters.items()}
    stiff = rigid(replace(motion, spring=()), values), rigid(motion, values)
    assert float(np.corrcoef(*stiff)[0, 1]) < 0.5
