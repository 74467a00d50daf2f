"""Slow observers find what fast disturbances hide from fast ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_arms import Arm, prepared, recorded
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide.claims import Piece
from zendsp.diagnosis.decide.pieces import sure
from zendsp.diagnosis.decide.thresholds import CLAIMED, PLAIN, SURE
from zendsp.diagnosis.measure import discrepancy as measured
from zendsp.diagnosis.measure.discrepancy import BANDS, discrepancy, holding
from zendsp.diagnosis.measure.evidence import Evidence, compare, heard_slowly
from zendsp.diagnosis.measure.likelihood import calibrate_joint, fit_scored
from zendsp.diagnosis.search.bodies import FoundBody, find_bodies
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model


@pytest.mark.parametrize("tilt", [0.035, 0.0])
def test_a_tilt_hidden_from_fast_observers_is_found_by_slower_ones(
    tmp_path: Path, tilt: float
) -> None:
    """A controller reacts to encoder counts of 8 mrad and shakes the arm."""
    arm = Arm(tilt=tilt, counts=0.008)
    model, _ = made = recorded(tmp_path, "tilt", arm, friction=True)
    fit, choose = prepared(made)

    def found(slowest: float) -> tuple[FoundBody, ...]:
        limits = replace(LIMITS, slowest=slowest)
        return find_bodies(fit, choose, model, 1, lambda _text: None, limits).found

    assert found(LIMITS.bandwidth) == ()
    bodies = found(LIMITS.slowest)
    assert [b.term.effect for b in bodies] == (["base_tilt"] if tilt else [])
    for body in bodies:
        assert body.bandwidth < LIMITS.bandwidth
        assert body.term.value("angle_x") == pytest.approx(tilt, abs=0.002)


@pytest.mark.parametrize("more", [6e-5, 0.0])
def test_an_inertia_unsure_under_fast_observers_is_found_by_slower_ones(more: float) -> None:
    """An encoder error of 10 to 20 Hz, and 0.6 % more inertia than in the model."""
    columns = reality.simulate(
        reality.Machine(inertia=0.010 + more), reality.multisine(8.0, RATE, 6), RATE, 6
    )
    rng, t = np.random.default_rng(6), columns["t"]
    waves = 2 * np.pi * (rng.uniform(10, 20, (20, 1)) * t + rng.uniform(size=(20, 1)))
    columns["q"] = columns["q"] + 1e-3 * np.sin(waves).sum(axis=0)
    models = [
        model_of(VISCOUS, COULOMB, {"kind": "inertia", "joint": 1, "amount": amount})
        for amount in (1e-9, 6e-5)
    ]
    test = data_of(columns, models[0])
    without, having = (fit_scored(test, model, (), (1,)) for model in models)
    assert compare(without, having, test, 1).z < CLAIMED
    slowly = heard_slowly(without, having, test, 1)
    assert slowly > SURE if more else slowly < PLAIN


@pytest.mark.parametrize(("z", "slowly", "claims"), [(3, 0, True), (2, 4, True), (2, 2, False)])
def test_a_likely_mechanism_is_sure_by_fast_observers_or_by_slower_ones(
    z: float, slowly: float, claims: bool
) -> None:
    nothing: Any = SimpleNamespace(joints=6)
    evidence = Evidence(gain=100.0, z=z, blocks=np.array([1.0, -1.0]))
    piece = Piece("inertia", (), nothing, 0.02, evidence, 50.0, slowly=slowly)
    assert sure(nothing, piece) is claims
    assert not sure(nothing, replace(piece, log_e=2.0)), "it has to be likely in any case"


def falling(velocity: float, size: float = 0.5) -> tuple[Data, Model]:
    """A joint whose friction falls by 0.05 N m, with its true model (in the kernel's form)."""
    machine = reality.Machine(breakaway=0.08, stribeck=velocity)
    columns = reality.simulate(machine, reality.multisine(10.0, RATE, 3, size=size, high=2.0), RATE)
    curve = {"kind": "stribeck", "joint": 1, "breakaway": 0.05, "velocity": velocity}
    model = model_of(VISCOUS, COULOMB, curve)
    return data_of(columns, model), model


@pytest.mark.parametrize(("velocity", "bands"), [(0.1, BANDS[:1]), (0.4, BANDS[:3])])
def test_an_observer_slower_than_a_friction_falls_does_not_judge_it(
    velocity: float, bands: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It shows how the model runs away, as if torque were missing beside a true Stribeck curve."""
    data, model = falling(velocity)
    assert holding(data, model, 1) == bands  # it falls by 42 and 10 rad/s
    assert holding(data, model_of(VISCOUS, COULOMB), 1) == BANDS
    lacks = discrepancy(data, model, 1).value
    assert lacks < 0.001  # simulators differ by so much
    monkeypatch.setattr(measured, "holding", lambda *_: BANDS)
    assert discrepancy(data, model, 1).value >= lacks + (0.001 if len(bands) == 1 else 0.0)


def test_a_stribeck_curve_is_fitted_under_a_slow_observer() -> None:
    """Under the fast one that a model without it needs, the fit ended at 0.005 rad/s."""
    data, model = falling(0.1)
    without = model.with_terms(model.terms[:-1])
    base = calibrate_joint(data, without, 1)
    assert base.data.bandwidth == (64.0,)
    each = Rounds(base.data, 1, 1, lambda _text: None, base.model)
    (found,) = each.stand_ins(base, frozenset({"stribeck"}))
    assert found.scored.model.terms[-1].value("velocity") == pytest.approx(0.1, rel=0.02)
