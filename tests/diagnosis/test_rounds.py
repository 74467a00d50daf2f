"""Which hypotheses a round of the search fits, to which recordings, and in which order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.measure.likelihood import (
    Scored,
    calibrate_joint,
    fit_scored,
)
from zendsp.diagnosis.search import rounds, short_fits
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.screen import Candidate
from zendsp.diagnosis.search.short_fits import WAIT, ShortFits
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model


@pytest.mark.parametrize(("amount", "possible"), [(-0.004, True), (-0.02, False)])
def test_no_joint_has_less_inertia_than_none(amount: float, possible: bool) -> None:
    model = model_of(VISCOUS, COULOMB, {"kind": "inertia", "joint": 1, "amount": amount})
    data = data_of(
        reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE), model
    )
    done = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=0)
    rival = Rival("inertia", 1, Scored(done, data, 0.0, (1,)), 0.0, model.at(1)[2:], ())
    assert Rounds(data, 1, 1, lambda _: None)._possible(rival) is possible


def test_what_was_begun_as_a_bent_spring_and_does_not_bend_is_a_spring() -> None:
    load, stiffness = 0.004, 20.0
    machine = reality.Machine(load=load, soft=stiffness)
    base = model_of(VISCOUS, COULOMB)
    data = data_of(reality.simulate(machine, reality.multisine(4.0, RATE, 5, high=6.0), RATE), base)
    rounds = Rounds(data, 1, 2, print, base)
    found = rounds.stand_ins(calibrate_joint(data, base, 1), frozenset({"stiffening"}))
    assert found[0].effect == "elasticity"
    assert found[0].scored.model.terms[-1].value("stiffness") == pytest.approx(stiffness, rel=0.02)


def test_the_load_on_a_spring_may_weigh_more_than_the_whole_that_the_model_states() -> None:
    """A model that forgot the motor's inertia: what is at a bound counts as not seen."""
    load, motor = 0.0085, 0.0015
    stiffness = (2 * np.pi * 12.0) ** 2 * load * motor / (load + motor)
    machine = reality.Machine(load=load, soft=stiffness)
    columns = reality.simulate(machine, reality.multisine(8.0, RATE, 5, high=6.0), RATE)
    base = model_of(VISCOUS, COULOMB, inertia=load)
    found = Rounds(data_of(columns, base), 1, 2, print, base).stand_ins(
        calibrate_joint(data_of(columns, base), base, 1), frozenset({"elasticity"})
    )
    assert found[0].terms[0].effect == "elasticity"
    assert found[0].scored.model.terms[-1].value("load_inertia") == pytest.approx(load, rel=0.05)


def test_a_round_has_one_entry_an_effect_also_where_a_second_look_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(6.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    looked: list[str] = []

    def two(_: Rounds, __: Scored, rivals: list[Rival]) -> list[Rival]:
        looked.extend(r.effect for r in rivals[1:3])
        return rivals[1:3]

    monkeypatch.setattr(Rounds, "_promising", two)
    monkeypatch.setattr(rounds, "vanishes", lambda *_: False)  # nothing is missing here
    monkeypatch.setattr(Rounds, "_too_small", lambda *_: False)
    monkeypatch.setattr(rounds, "WAIT", 200.0)  # more than the steps of this reality gain
    each = Rounds(data, 1, 1, lambda _: None)
    effects = [r.effect for r in each.round(calibrate_joint(data, model, 1))]
    assert len(looked) == 2 and set(looked) <= set(effects)
    assert len(effects) == len(set(effects)), effects


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Effects that rounds fit, as they do."""
    fitted: list[str] = []
    quick = ShortFits.quick

    def noted(self: ShortFits, current: Scored, group: list[Candidate]) -> Rival | None:
        fitted.append(group[0].effect)
        return quick(self, current, group)

    monkeypatch.setattr(ShortFits, "quick", noted)
    return fitted


def test_a_transmission_that_promises_next_to_nothing_beside_another_law_is_not_fitted(
    fitted: list[str],
) -> None:
    transmissions = {"elasticity", "backlash", "stiffening"}
    sprung = reality.Machine(load=0.004, soft=20.0)
    for machine, missing in ((reality.Machine(viscous=0.05), set()), (sprung, {"elasticity"})):
        columns = reality.simulate(machine, reality.multisine(4.0, RATE, 5, high=6.0), RATE)
        data = data_of(columns, base := model_of(COULOMB))
        fitted.clear()
        first = Rounds(data, 1, 1, print, base).round(calibrate_joint(data, base, 1))[0]
        assert missing <= transmissions & set(fitted)
        if not missing:
            assert first.effect in ("viscous", "viscous_asymmetry")
            assert not transmissions & set(fitted)


@pytest.mark.parametrize("drag", [0.0, 0.002])
def test_what_promises_nothing_on_all_samples_is_not_fitted(
    drag: float, fitted: list[str]
) -> None:
    columns = reality.simulate(reality.Machine(drag=drag), reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(columns, base := model_of(VISCOUS, COULOMB))
    Rounds(data, 1, 1, print, base).round(calibrate_joint(data, base, 1))
    assert ("quadratic_drag" in fitted) is (drag > 0.0)  # every search lists it


@pytest.mark.parametrize("promised", [True, False])
def test_a_hypothesis_that_a_first_look_bends_is_fitted_upon_the_numbers_of_the_model(
    promised: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a small motor each turn round lasted less than a thinned sample: the friction that such a
    look put beside a true torque cost more than the torque gained, and nothing was found. So it was
    of a spring of which the look itself promised nothing: no model is worse than one it contains.
    """
    if not promised:
        monkeypatch.setattr(ShortFits, "gain_of_look", lambda *_: 0.0)
    reference = reality.multisine(6.0, RATE, 3)
    pushed = reality.simulate(reality.Machine(push=(0.004, 0.0, 99.0)), reference, RATE)
    model = model_of(VISCOUS, COULOMB)
    current = calibrate_joint(data_of(pushed, model), model, 1)
    other = reality.simulate(
        reality.Machine(push=(0.004, 0.0, 99.0), coulomb=0.12), reference, RATE
    )
    monkeypatch.setattr(short_fits, "first_look", lambda *_: data_of(other, model))
    begin = make_term(get_effect("torque_offset"), 1, {"level": -0.003})
    asked = [Candidate("torque_offset", 1, (begin,), (), 1.0)]
    found = Rounds(current.data, 1, 1, lambda _: None, model).short.quick(current, asked)
    assert found is not None and found.value < current.deviance - WAIT
    found_level = found.scored.model.at(1)[-1].value("level")
    assert found_level == pytest.approx(-0.004, rel=0.1)


@pytest.mark.parametrize(("bandwidth", "thinned"), [(16.0, False), (64.0, True)])
def test_where_thinned_recordings_mislead_a_hypothesis_is_fitted_to_every_sample(
    bandwidth: float, thinned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction that a look finds six times as large costs the model itself more than any hypothesis
    gains: of 18 looks of a complete machine none told anything. A model that needs a fast observer
    lacks much, and is looked at on thinned ones.
    """
    reference = reality.multisine(6.0, RATE, 3)
    pushed = reality.simulate(reality.Machine(push=(0.004, 0.0, 99.0)), reference, RATE)
    model = model_of(VISCOUS, COULOMB)
    data = data_of(pushed, model).at_bandwidth(1, bandwidth)
    current = fit_scored(data, model, joint_handles(data, model, 1), (1,), rounds=1)
    other = data_of(reality.simulate(reality.Machine(coulomb=0.12), reference, RATE), model)
    monkeypatch.setattr(short_fits, "first_look", lambda *_: other)
    hypotheses: list[Data] = []
    short = ShortFits._short

    def noted(self: ShortFits, data: Data, model: Model, *rest: Any) -> Any:
        if any(t.effect == "torque_offset" for t in model.terms):
            hypotheses.append(data)
        return short(self, data, model, *rest)

    monkeypatch.setattr(ShortFits, "_short", noted)
    begin = make_term(get_effect("torque_offset"), 1, {"level": -0.003})
    each = Rounds(current.data, 1, 1, lambda _: None, model)
    found = each.short.quick(current, [Candidate("torque_offset", 1, (begin,), (), 1.0)])
    assert found is not None and found.value < current.deviance - WAIT
    assert (hypotheses[0] is other) is thinned


@pytest.mark.parametrize(("whole", "asked"), [(-500.0, [True]), (500.0, [True, False])])
def test_a_hypothesis_that_ends_worse_on_every_sample_is_looked_at_on_thinned_ones_after_all(
    whole: float, asked: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(6.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    done = fit(data, model, (), joints=(1,), iterations=0)
    begin = make_term(get_effect("torque_offset"), 1, {"level": -0.003})
    option = Candidate("torque_offset", 1, (begin,), (), 1.0)
    begun: list[bool] = []

    def starts(*given: Any) -> Any:
        begun.append(given[-1])
        return option, done, whole if given[-1] else 1000.0

    monkeypatch.setattr(ShortFits, "misleads", lambda *_: True)
    monkeypatch.setattr(ShortFits, "_from_starts", starts)
    monkeypatch.setattr(ShortFits, "_upon_its_numbers", lambda *_: (done, -70.0))
    current = Scored(done, data, 0.0, (1,))
    found = Rounds(data, 1, 1, lambda _: None).short._short_fits(current, [option], data)
    assert begun == asked
    assert found is not None


@pytest.mark.parametrize(("gain", "asked"), [(10.0, [64.0, 16.0]), (100.0, [64.0])])
def test_what_gains_nothing_under_a_fast_observer_is_begun_again_under_a_slow_one(
    gain: float, asked: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A spring among rests: a fast observer followed it, its fit stayed where it began, and a
    machine was complete that lacked it.
    """
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(6.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    current = Scored(fit(data, model, (), joints=(1,), iterations=0), data, 0.0, (1,))
    current = replace(current, data=data.at_bandwidth(1, 64.0))
    spring = make_term(get_effect("stiffness"), 1, {"coefficient": 1.0, "neutral": 0.0})
    begun: list[float] = []

    def short(_: ShortFits, base: Scored, __: list[Candidate], given: Data) -> Rival:
        begun.append(given.bandwidth[0])
        scored = replace(base, deviance=-gain * len(begun))
        return Rival("stiffness", 1, scored, 0.0, (spring,), ())

    monkeypatch.setattr(ShortFits, "_short_fits", short)
    found = Rounds(data, 1, 1, lambda _: None).short.quick(
        current, [Candidate("stiffness", 1, (spring,), (), 1.0)]
    )
    assert begun == asked
    assert found is not None and found.value == -gain * len(asked)


@pytest.mark.parametrize(("kept", "fitted"), [(50.0, ["stiffness"]), (5000.0, [])])
def test_what_promises_more_than_anything_listed_keeps_is_not_overlooked(
    kept: float, fitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(12.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    current = Scored(fit(data, model, (), joints=(1,), iterations=0), data, 0.0, (1,))
    spring = make_term(get_effect("stiffness"), 1, {"coefficient": 1.0, "neutral": 0.0})
    wave = make_term(get_effect("ripple"), 1, {"order": 5.0, "amplitude": 0.1, "phase": 0.0})
    listed = Rival("ripple", 1, replace(current, deviance=-kept), 0.0, (wave,), ())
    options = [
        (share, Candidate(term.effect, 1, (term,), (), 1.0))
        for share, term in ((0.2, wave), (0.05, spring))
    ]
    monkeypatch.setattr(
        ShortFits, "quick", lambda _, base, group: replace(listed, effect=group[0].effect)
    )
    monkeypatch.setattr(Rounds, "_is_idle", lambda *_: False)  # nothing is missing here
    each = Rounds(data, 1, 1, lambda _: None)
    assert 100 < 0.05 * each.n < 1000
    more = each._overlooked(current, options, [[options[0][1]]], [listed], map)
    assert [r.effect for r in more] == fitted
