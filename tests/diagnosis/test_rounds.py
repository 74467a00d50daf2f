"""Which hypotheses a round of the search fits, from which numbers and to which samples."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.measure.discrepancy import runs_away
from zendsp.diagnosis.measure.likelihood import (
    Scored,
    calibrate_joint,
    cost_of,
    deviance,
    fit_scored,
)
from zendsp.diagnosis.search import forward, rounds, short_fits
from zendsp.diagnosis.search.candidates import simulated
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.screen import Candidate, with_candidate
from zendsp.diagnosis.search.short_fits import WAIT, ShortFits
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model


def candidate(effect: str, **numbers: float) -> Candidate:
    """One law of the library at the joint, with its start values."""
    return Candidate(effect, 1, (make_term(get_effect(effect), 1, numbers),), (), 1.0)


OFFSET = candidate("torque_offset", level=-0.003)
SPRING = candidate("stiffness", coefficient=1.0, neutral=0.0)
WAVE = candidate("ripple", order=5.0, amplitude=0.1, phase=0.0)


def complete(seconds: float = 6.0) -> Scored:
    """A model that lacks nothing, on recordings of its machine; its deviance is called 0."""
    model = model_of(VISCOUS, COULOMB)
    reference = reality.multisine(seconds, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    return Scored(fit(data, model, (), joints=(1,), iterations=0), data, 0.0, (1,))


@pytest.mark.parametrize(("amount", "possible"), [(-0.004, True), (-0.02, False)])
def test_a_law_that_makes_the_inertia_negative_is_refused(amount: float, possible: bool) -> None:
    model = model_of(VISCOUS, COULOMB, {"kind": "inertia", "joint": 1, "amount": amount})
    data = data_of(
        reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE), model
    )
    done = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=0)
    scored = Scored(done, data, 0.0, (1,))
    rival = Rival("inertia", 1, scored, 0.0, model.at(1)[2:], ())
    assert Rounds(data, 1, 1, lambda _: None)._possible(scored, rival) is possible


@pytest.mark.parametrize(
    ("before", "beside", "possible"), [(0.05, 0.4, True), (0.05, 4.8, False), (4.0, 4.8, True)]
)
def test_a_log_too_little_late_to_be_claimed_stays_so_beside_a_law(
    before: float, beside: float, possible: bool
) -> None:
    """In rows. A spring of a cart was a lag of 4.8 ms at 1 kHz, in a log late by as much."""

    def shifted(rows: float, *laws: dict[str, object]) -> Scored:
        shift = {"kind": "column_shift", "joint": 1, "time": rows / RATE}
        model = model_of(VISCOUS, COULOMB, shift, *laws)
        data = data_of(columns, model)
        done = fit(data, model, (), joints=(1,), iterations=0)
        return Scored(done, data, 0.0, (1,))

    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE)
    current = shifted(before)
    lag = shifted(beside, {"kind": "lag", "joint": 1, "time_constant": 4.8 / RATE})
    rival = Rival("lag", 1, lag, 0.0, lag.model.at(1)[3:], ())
    assert Rounds(current.data, 1, 1, lambda _: None)._possible(current, rival) is possible


def test_the_search_for_a_spring_starts_from_the_given_numbers_too() -> None:
    """Beneath a weight that calibration had bent by 14 %, no start of a true spring promised
    anything.
    """
    given = model_of(VISCOUS, COULOMB)
    machine = reality.Machine(load=0.004, soft=(2 * np.pi * 6.1) ** 2 * 0.0024)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 5, high=6.0), RATE)
    data = data_of(columns, given)
    bent = model_of(VISCOUS, {**COULOMB, "level": 0.15}, inertia=0.0102)
    (group,) = simulated(data, bent, 1, frozenset({"elasticity"}), 1, given)
    (plain,) = simulated(data, bent, 1, frozenset({"elasticity"}), 1)
    assert sorted(c.beneath == given for c in group) == [False, True], "the best upon either"
    levels = [
        min(deviance(data, with_candidate(bent, c), (1,)) for c in group)
        for group in (group, plain)
    ]
    assert levels[0] < levels[1] - 100.0


def test_a_stiffening_spring_without_stiffening_is_called_a_spring() -> None:
    load, stiffness = 0.004, 20.0
    machine = reality.Machine(load=load, soft=stiffness)
    base = model_of(VISCOUS, COULOMB)
    data = data_of(reality.simulate(machine, reality.multisine(4.0, RATE, 5, high=6.0), RATE), base)
    rounds = Rounds(data, 1, 2, print, base)
    found = rounds.stand_ins(calibrate_joint(data, base, 1), frozenset({"stiffening"}))
    assert found[0].effect == "elasticity"
    assert found[0].scored.model.terms[-1].value("stiffness") == pytest.approx(stiffness, rel=0.02)


def test_the_load_behind_a_spring_may_have_more_inertia_than_the_model_states() -> None:
    """The model forgot the motor's inertia. A number at its bound would count as not seen."""
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


def test_a_gain_too_small_for_a_step_still_stands_in_for_an_inertia() -> None:
    """Drives are known to half a percent, so one of 0.3 % is likely, and no finding. It had stood
    in no list where all of a model's numbers are held: "inertia" alone, at 84 %.
    """
    held = [
        {**VISCOUS, "coefficient": {"value": 0.004, "free": False}},
        {**COULOMB, "level": {"value": 0.03, "free": False}},
    ]
    base = parse_model(
        {
            "sample_time": 1.0 / RATE,
            "mechanism": {
                "kind": "rotary",
                "parameters": {"inertia": {"value": 0.01003, "free": False}},
            },
            "effect": held,
        }
    )
    columns = reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 3, high=6.0), RATE)
    data = data_of(columns, base)
    each = Rounds(data, 1, 1, lambda _: None, base)
    found = each.stand_ins(calibrate_joint(data, base, 1), frozenset({"torque_gain"}))
    assert [r.effect for r in found] == ["torque_gain"]
    assert each.too_small(found[0], found[0].terms[0])


def test_a_round_lists_each_effect_once_also_after_a_second_look(
    monkeypatch: pytest.MonkeyPatch
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
    monkeypatch.setattr(Rounds, "too_small", lambda *_: False)
    monkeypatch.setattr(rounds, "WAIT", 200.0)  # more than the steps of this reality gain
    each = Rounds(data, 1, 1, lambda _: None)
    effects = [r.effect for r in each.round(calibrate_joint(data, model, 1))]
    assert len(looked) == 2 and set(looked) <= set(effects)
    assert len(effects) == len(set(effects)), effects


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The effects that rounds fit, in order."""
    fitted: list[str] = []
    quick = ShortFits.quick

    def noted(self: ShortFits, current: Scored, group: list[Candidate]) -> Rival | None:
        fitted.append(group[0].effect)
        return quick(self, current, group)

    monkeypatch.setattr(ShortFits, "quick", noted)
    return fitted


def test_an_unpromising_transmission_is_not_fitted_beside_another_law(fitted: list[str]) -> None:
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
def test_an_effect_that_promises_nothing_on_all_samples_is_not_fitted(
    drag: float, fitted: list[str]
) -> None:
    columns = reality.simulate(reality.Machine(drag=drag), reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(columns, base := model_of(VISCOUS, COULOMB))
    Rounds(data, 1, 1, print, base).round(calibrate_joint(data, base, 1))
    assert ("quadratic_drag" in fitted) is (drag > 0.0)  # every search lists it


@pytest.mark.parametrize("ripple", [0.0, 0.004])
def test_beside_a_gap_too_what_promises_nothing_is_not_fitted(
    ripple: float, fitted: list[str]
) -> None:
    """All 21 hypotheses were, each for a quarter of a second, after a gap had explained all."""
    machine = reality.Machine(gap=0.003, load=0.005, ripple=ripple)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 3), RATE)
    gap = {"kind": "backlash", "joint": 1, "gap": 0.003, "stiffness": 120.0, "load_inertia": 0.005}
    data = data_of(columns, base := model_of(VISCOUS, COULOMB, {**gap, "damping": 0.05}))
    rivals = Rounds(data, 1, 1, print, base).round(calibrate_joint(data, base, 1))
    assert ("quadratic_drag" in fitted) is False  # every search lists it
    assert ("ripple" in fitted) is (ripple > 0.0)
    assert not ripple or rivals[0].effect == "ripple"


@pytest.mark.parametrize("promised", [True, False])
def test_a_hypothesis_that_a_first_look_misfits_is_fitted_from_the_models_numbers(
    promised: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each reversal of a small motor was shorter than a thinned sample. On thinned samples the
    friction was misfitted beside a true torque, which cost more than the torque gained, and nothing
    was found. Likewise a spring of which the thinned samples promised nothing. A fit that starts
    from the model's numbers cannot be worse than the model.
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
    found = Rounds(current.data, 1, 1, lambda _: None, model).short.quick(current, [OFFSET])
    assert found is not None and found.value < current.deviance - WAIT
    found_level = found.scored.model.at(1)[-1].value("level")
    assert found_level == pytest.approx(-0.004, rel=0.1)


@pytest.mark.parametrize(("bandwidth", "thinned"), [(16.0, False), (64.0, True)])
def test_where_thinned_recordings_mislead_a_hypothesis_is_fitted_to_every_sample(
    bandwidth: float, thinned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If friction fitted to thinned samples is six times too large, this costs more than any
    hypothesis gains: of a complete machine 18 such fits said nothing. A model that needs a fast
    observer lacks much, so thinned samples do for it.
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

    def noted(self: ShortFits, data: Data, model: Model, *rest: Any, **more: Any) -> Any:
        if any(t.effect == "torque_offset" for t in model.terms):
            hypotheses.append(data)
        return short(self, data, model, *rest, **more)

    monkeypatch.setattr(ShortFits, "_short", noted)
    found = Rounds(current.data, 1, 1, lambda _: None, model).short.quick(current, [OFFSET])
    assert found is not None and found.value < current.deviance - WAIT
    assert (hypotheses[0] is other) is thinned


@pytest.mark.parametrize(("whole", "asked"), [(-500.0, [True]), (500.0, [True, False])])
def test_a_hypothesis_that_fits_worse_on_every_sample_is_tried_on_thinned_ones(
    whole: float, asked: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    current = complete()
    begun: list[bool] = []

    def starts(*given: Any) -> Any:
        begun.append(given[-1])
        return OFFSET, current.fit, whole if given[-1] else 1000.0

    monkeypatch.setattr(ShortFits, "misleads", lambda *_: True)
    monkeypatch.setattr(ShortFits, "_from_starts", starts)
    monkeypatch.setattr(ShortFits, "_upon_its_numbers", lambda *_: (current.fit, -70.0))
    data = current.data
    found = Rounds(data, 1, 1, lambda _: None).short._short_fits(current, [OFFSET], data)
    assert begun == asked
    assert found is not None


@pytest.mark.parametrize(("gain", "asked"), [(10.0, [64.0, 16.0]), (100.0, [64.0])])
def test_a_hypothesis_without_gain_under_a_fast_observer_is_tried_under_a_slow_one(
    gain: float, asked: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A spring in a motion with rests: a fast observer followed it, so the fit did not move from
    its start, and a machine that lacked it had been called complete.
    """
    current = complete()
    data = current.data
    current = replace(current, data=data.at_bandwidth(1, 64.0))
    begun: list[float] = []

    def short(_: ShortFits, base: Scored, __: list[Candidate], given: Data) -> Rival:
        begun.append(given.bandwidth[0])
        scored = replace(base, deviance=-gain * len(begun))
        return Rival("stiffness", 1, scored, 0.0, SPRING.terms, ())

    monkeypatch.setattr(ShortFits, "_short_fits", short)
    found = Rounds(data, 1, 1, lambda _: None).short.quick(current, [SPRING])
    assert begun == asked
    assert found is not None and found.value == -gain * len(asked)


@pytest.mark.parametrize(("missing", "fitted"), [(0.0, False), (0.004, True)])
def test_a_hypothesis_that_gains_nothing_under_a_slow_observer_either_is_left(
    missing: float, fitted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four more fits to all samples each made the last round of a search its longest."""
    reference = reality.multisine(6.0, RATE, 3)
    model = model_of(VISCOUS, COULOMB)
    pushed = reality.simulate(reality.Machine(push=(missing, 0.0, 99.0)), reference, RATE)
    data = data_of(pushed, model).at_bandwidth(1, 64.0)
    current = fit_scored(data, model, joint_handles(data, model, 1), (1,), rounds=1)
    # misled so far under its own observer that only the slow one is left
    monkeypatch.setattr(ShortFits, "_upon_its_numbers", lambda *given: given[3:])
    short = Rounds(data, 1, 1, lambda _: None).short
    found = short._short_fits(current, [OFFSET], data.at_bandwidth(1, 16.0))
    assert (found is not None) is fitted


@pytest.mark.parametrize(("kept", "fitted"), [(50.0, ["stiffness"]), (5000.0, [])])
def test_an_effect_that_promises_more_than_the_listed_ones_gained_is_fitted_too(
    kept: float, fitted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    current = complete(12.0)
    listed = Rival("ripple", 1, replace(current, deviance=-kept), 0.0, WAVE.terms, ())
    monkeypatch.setattr(
        ShortFits, "quick", lambda _, base, group: replace(listed, effect=group[0].effect)
    )
    monkeypatch.setattr(Rounds, "_is_idle", lambda *_: False)  # nothing is missing here
    each = Rounds(current.data, 1, 1, lambda _: None)
    assert 100 < 0.05 * each.n < 1000
    more = each._overlooked(current, [(0.2, WAVE), (0.05, SPRING)], [[WAVE]], [listed], map)
    assert [r.effect for r in more] == fitted


def test_all_hypotheses_that_promise_nearly_as_much_as_the_first_are_fitted() -> None:
    """Of a drive that gave 8 % less torque than it said, in an arm that bore much weight, a screen
    saw a constant, waves and springs that explained as much. The gain came tenth, after the last
    that was fitted, and a transmission error was named with 88 %.
    """
    current = complete(2.0)
    names = ["ripple", "gravity", "stiffness", "torque_offset", "coulomb_asymmetry", "dead_zone"]
    names += ["viscous_asymmetry", "saturation", "cubic_stiffness", "torque_gain", "lag"]
    shares = [0.68, *[0.63] * 8, 0.61, 0.3]
    options = [(share, candidate(n)) for share, n in zip(shares, names, strict=True)]
    listed = Rounds(current.data, 1, 1, lambda _: None)._listed(current, options)
    assert [group[0].effect for group in listed][:10] == names[:10]
    few = [(0.68 if n == "ripple" else 0.1, candidate(n)) for n in names]
    listed = Rounds(current.data, 1, 1, lambda _: None)._listed(current, few)
    assert "torque_gain" not in {group[0].effect for group in listed}, "a shortlist stays short"


def test_a_fit_upon_the_models_numbers_ends_where_it_cannot_gain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    current = complete(2.0)
    goals: list[float] = []
    fitted = short_fits.fit

    def noted(*args: Any, goal: float = np.inf, **more: Any) -> Any:
        goals.append(goal)
        return fitted(*args, goal=goal, **more)

    monkeypatch.setattr(short_fits, "fit", noted)
    short, worse = ShortFits(1, 1, 2000), 50.0
    begun = fitted(current.data, with_candidate(current.model, OFFSET), (), iterations=0)
    short._upon_its_numbers(current, OFFSET, begun, worse)
    short._upon_its_numbers(current, OFFSET, begun, -worse)
    of = [cost_of(current.data, 1, value) for value in (current.deviance, -worse)]
    assert goals == pytest.approx([of[0], of[0], of[1], of[1]])


def test_a_short_fit_ends_where_its_hypothesis_cannot_come_to_be_examined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nor is one that begins far from its numbers, as those of hidden states do, judged there."""
    current = complete(2.0)
    goals: dict[str, float] = {}
    fitted = short_fits.fit

    def noted(data: Data, model: Model, *args: Any, goal: float = np.inf, **more: Any) -> Any:
        effect = model.terms[-1].effect
        level = cost_of(data, 1, deviance(data, current.model, (1,)))
        goals.setdefault(effect, goal - level)
        return fitted(data, model, *args, goal=goal, **more)

    monkeypatch.setattr(short_fits, "fit", noted)
    short = ShortFits(1, 1, 2000)
    spring = candidate("elasticity", stiffness=20.0, damping=0.01, load_inertia=0.004)
    for one in (OFFSET, spring):
        short.quick(current, [one])
    assert goals["torque_offset"] < 0.0
    assert goals["elasticity"] == np.inf


def test_what_is_behind_a_step_that_cannot_be_taken_is_not_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A joint of an arm that lacked nothing spent 3.4 of its 4.4 s on a round upon the
    hypothesis that gained most. Where a glance promises no step behind it, none is asked for.
    """
    base, asked = complete(2.0), []
    far: Any = SimpleNamespace(deviance=-9e4, model=base.model)

    def round_of(_: Rounds, current: Any) -> list[Rival]:
        asked.append(current)
        return [Rival("ripple", 1, far, 0.0, base.model.terms[:1], ())]

    monkeypatch.setattr(forward, "is_white", lambda *_: False)
    monkeypatch.setattr(Rounds, "round", round_of)
    monkeypatch.setattr(Rounds, "glance", lambda _, scored, __: scored.deviance - 1.0)
    searcher = Searcher(base.data, 1, lambda *_, **__: False, 1, lambda _: None)
    assert searcher._chain(base).steps == []
    assert asked == [base]


def test_a_law_whose_short_fit_ended_far_from_its_minimum_is_fitted_on() -> None:
    """A Stribeck curve of 12 % of the torque was left where its short fit ended, with half of what
    an offset had gained; the search took the offset, and the machine was unexplained.
    """
    base = model_of(VISCOUS, COULOMB)
    machine = reality.Machine(drag=0.02, ripple=0.01)
    data = data_of(reality.simulate(machine, reality.multisine(6.0, RATE, 3), RATE), base)
    current = calibrate_joint(data, base, 1)
    search = Rounds(data, 1, 1, lambda _: None, base)

    def short(candidate: Candidate, iterations: int) -> Rival:
        model = with_candidate(current.model, candidate)
        found = fit(
            current.data, model, joint_handles(data, model, 1), joints=(1,), iterations=iterations
        )
        value = deviance(current.data, found.model, (1,))
        scored = Scored(found, current.data, value, (1,))
        return Rival(candidate.effect, 1, scored, 0.0, candidate.terms, ())

    near = short(candidate("ripple", order=7.0, amplitude=0.01, phase=0.0), 20)
    far = short(candidate("quadratic_drag", coefficient=1e-4), 0)
    gains = [current.deviance - rival.value for rival in (near, far)]
    assert gains[1] < 0.5 * gains[0], "left, by what it gained so far"
    assert search.short.promised(near) < 1.0 < gains[0] < search.short.promised(far)
    search._looked_at = lambda *_, **__: [near, far]  # type: ignore[method-assign]
    search._overlooked = lambda *_: []  # type: ignore[method-assign]
    assert search.round(current)[0].effect == "quadratic_drag"


@pytest.mark.parametrize(("excess", "band"), [(0.0, 16.0), (0.03, 32.0), (0.06, 64.0)])
def test_laws_are_ranked_by_a_slow_observer_that_holds_the_model_to_the_motion(
    excess: float, band: float
) -> None:
    """Beside a friction that falls at 26 /s an observer of 16 rad/s shows the instability: it
    ranked the right laws behind four others, and the chain ended before it had them.
    """
    curve = {"kind": "stribeck", "joint": 1, "breakaway": excess, "velocity": 0.1}
    model = model_of(VISCOUS, COULOMB, *([curve] if excess else []))
    columns = reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(columns, model)
    scored = Scored(fit(data, model, (), joints=(1,), iterations=0), data, 0.0, (1,))
    away = runs_away(data, model, 1)
    assert away < band and (away >= band / 2 or not excess)
    assert short_fits.settled(scored, 1) == band
    assert short_fits.settled(scored, 1, 8.0) == (band if excess else 8.0)
