"""How the search takes, simplifies, keeps and rejects its steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of, signals_of

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide.propose import OTHER, motions
from zendsp.diagnosis.measure.likelihood import (
    Scored,
    calibrate_joint,
    deviance,
    fit_scored,
)
from zendsp.diagnosis.search import backlash, forward
from zendsp.diagnosis.search.candidates import as_given, simulated
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival, Step
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.screen import Candidate, Screen, with_candidate
from zendsp.physics.calibration.fit import fit, joint_handles
from zendsp.physics.calibration.joint import facts

Array = npt.NDArray[np.float64]


def test_an_accepted_step_is_kept_where_the_next_one_is_rejected() -> None:
    machine = reality.Machine(push=(0.012, 0.0, 99.0), swirl=0.01)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(columns, model := model_of(VISCOUS))
    steps = Searcher(data, 1, lambda _, r: r.effect == "coulomb_asymmetry", 1, lambda _: None)
    found = steps.search(calibrate_joint(data, model, 1, jobs=1))
    assert [s.chosen.effect for s in found.steps] == ["coulomb_asymmetry"]
    assert {t.effect for t in found.final.model.terms} == {"viscous", "coulomb", "torque_offset"}


def test_the_search_for_backlash_starts_from_the_given_inertia_too() -> None:
    given = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(
        reality.Machine(gap=0.05, load=0.005), reality.multisine(6.0, RATE, 3), RATE
    )
    data = data_of(columns, given)
    moved = given.mechanism["inertia"][0]
    calibrated = model_of(VISCOUS, {**COULOMB, "level": 0.05}, inertia=0.007)
    assert as_given(calibrated, given) == given
    (group,) = simulated(data, calibrated, 1, frozenset({"backlash"}), 1, given)
    (plain,) = simulated(data, calibrated, 1, frozenset({"backlash"}), 1)
    assert all(c.beneath is None for c in plain)
    begun = [c.beneath for c in group if c.beneath is not None]
    assert begun and all(b.mechanism["inertia"][0] == moved for b in begun)

    def best(candidates: list[Candidate]) -> float:
        return min(deviance(data, with_candidate(calibrated, c), (1,)) for c in candidates)

    assert best(group) < best(plain) - 100.0


def test_backlash_replaces_a_given_spring_but_not_a_found_one() -> None:
    spring = {
        "kind": "elasticity",
        "joint": 1,
        "stiffness": 20.0,
        "damping": 0.05,
        "load_inertia": 0.004,
    }
    model = model_of(VISCOUS, COULOMB, spring)
    data = data_of(
        reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE), model
    )
    (group,) = simulated(data, model, 1, frozenset({"backlash"}), 1, model)
    assert {c.replaces for c in group} == {("elasticity",)}
    assert not simulated(data, model, 1, frozenset({"backlash"}), 1, model_of(VISCOUS, COULOMB))


def test_a_gap_is_found_however_wide_the_motion_is() -> None:
    """Gaps of 0.06 to 0.25 mm in a metre of travel were unexplained, or "complete"."""
    motion = 1.5 * np.sin(0.8 * np.pi * np.arange(8 * RATE) / RATE)
    motion += reality.multisine(8.0, RATE, 3, size=0.3)
    machine = reality.Machine(gap=6e-4, load=0.005, resolution=1e-6)
    model = model_of(VISCOUS, COULOMB)
    base = calibrate_joint(data_of(reality.simulate(machine, motion, RATE), model), model, 1, 1)
    best = Rounds(base.data, 1, 1, lambda _: None).round(base)[0]
    assert best.effect == "backlash"
    assert base.deviance - best.value > 5000.0  # a spring that stiffens gains 3456


def test_a_gap_that_a_stiffening_spring_imitates_takes_its_place() -> None:
    """No start of its own led to a gap of 0.9 mrad. A spring that stiffens took its place, was no
    finding, and a Stribeck curve beside it was none either.
    """
    machine = reality.Machine(gap=0.002, load=0.005)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 3), RATE)
    spring = {
        "kind": "stiffening", "joint": 1, "stiffness": 0.1, "stiffness3": 3e6, "damping": 0.05,
        "load_inertia": 0.005,
    }  # fmt: skip
    found = model_of(VISCOUS, COULOMB, spring)
    data, given = data_of(columns, found), model_of(VISCOUS, COULOMB)
    (group,) = simulated(data, found, 1, frozenset({"backlash"}), 1, given)
    assert {c.replaces for c in group} == {("stiffening",)}
    fitted = []
    for candidate in group:
        model = with_candidate(found, candidate)
        fitted.append(fit_scored(data, model, joint_handles(data, model, 1), (1,)))
    best = min(fitted, key=lambda f: f.deviance)
    assert best.model.terms[-1].value("gap") == pytest.approx(0.002, rel=0.03)


@pytest.mark.parametrize("hertz", [6.1, 10.2])
def test_a_spring_is_found_wherever_its_resonance_lies(hertz: float) -> None:
    load, motor = 0.004, 0.006
    stiffness = (2 * np.pi * hertz) ** 2 * load * motor / (load + motor)
    machine = reality.Machine(load=load, soft=stiffness)
    columns = reality.simulate(machine, reality.multisine(8.0, RATE, 5, high=6.0), RATE)
    base = model_of(VISCOUS, COULOMB)
    calibrated = calibrate_joint(data_of(columns, base), base, 1)
    ((start, *_),) = simulated(calibrated.data, calibrated.model, 1, frozenset({"elasticity"}))
    model = with_candidate(calibrated.model, start)
    found = fit_scored(calibrated.data, model, joint_handles(calibrated.data, model, 1), (1,))
    assert found.model.terms[-1].value("stiffness") == pytest.approx(stiffness, rel=0.03)


def test_a_diverging_search_tries_its_next_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    def simplified(other: Any, n: int, jobs: int) -> Any:
        return other.best, ()

    monkeypatch.setattr(decision, "simplify", simplified)
    monkeypatch.setattr(decision, "informative", lambda data, joint: 100)
    steps: Any = [
        SimpleNamespace(effect=effect, scored=SimpleNamespace(deviance=deviance))
        for effect, deviance in (("stiffening", -900.0), ("backlash", -800.0), ("ripple", 1.0))
    ]
    base: Any = SimpleNamespace(deviance=0.0)
    final: Any = SimpleNamespace(
        model=SimpleNamespace(at=lambda joint: (SimpleNamespace(effect="stiffening"),))
    )
    parts: Any = SimpleNamespace(fit=None)
    ran: Any = [SimpleNamespace(size=36.0)]
    search = JointSearch(1, base, tried=steps)
    other = decision.find_sounder(parts, search, final, ran, 1)
    assert other is not None and other.best is steps[1].scored
    assert decision.find_sounder(parts, other, final, ran, 1) is None, "nothing left gains"
    sound: Any = [SimpleNamespace(size=0.5)]
    assert decision.find_sounder(parts, search, final, sound, 1) is None, "nothing ran away"
    first = Step(steps[1], (), base)
    longer = JointSearch(1, base, [first, Step(steps[0], (), base)], tried=steps)
    alone = decision.find_sounder(parts, longer, final, sound, 1)
    assert alone is not None and alone.best is steps[1].scored, "its first step, alone"
    assert decision.find_sounder(parts, alone, final, sound, 1) is None


def test_a_proposed_motion_covers_the_whole_range_of_all_recordings() -> None:
    model = model_of(VISCOUS, COULOMB)
    slow = reality.simulate(reality.Machine(), reality.multisine(8.0, RATE, 3, size=0.3), RATE)
    wide = reality.simulate(
        reality.Machine(), 1.4 * np.sin(1.2 * np.arange(4000) / RATE) + 0.4, RATE
    )
    both = [signals_of(columns) for columns in (slow, wide)]
    record = prepare(both, model).records[0][0]
    motion = motions(record, (-np.inf, np.inf), np.random.default_rng(0))[OTHER]
    assert motion.min() < -0.6 and motion.max() > 1.4
    assert np.abs(np.gradient(motion, record.sample_time)).max() < 1.25 * facts(record).fastest
    narrow = motions(record, (-0.5, 0.5), np.random.default_rng(0))[OTHER]
    assert -0.5 <= narrow.min() < -0.35 and 0.35 < narrow.max() <= 0.5


def test_numbers_that_make_an_effect_vanish_gain_nothing() -> None:
    """An infinite torque had ended in "SVD did not converge"."""
    rows = np.vstack([np.full(50, np.nan), np.linspace(0.0, 1.0, 50)])
    screen: Any = SimpleNamespace(q=np.zeros((50, 1)), left=np.linspace(0.0, 2.0, 50))
    (none, _), (gain, theta) = Screen.groups(screen, rows, 1)
    assert none == 0.0 and gain > 1.0 and theta == pytest.approx(-2.0)


@pytest.mark.parametrize(("white", "promise", "goes_on"), [
    (False, 100.0, True), (False, 20.0, False), (True, 100.0, False),
])  # fmt: skip
def test_a_search_goes_on_from_what_was_found_where_more_is_promised(
    white: bool, promise: float, goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    data = data_of(columns, model_of(VISCOUS, COULOMB))
    found: Any = SimpleNamespace(final=SimpleNamespace(deviance=0.0))
    monkeypatch.setattr(forward, "is_white", lambda *_: white)
    monkeypatch.setattr(Rounds, "glance", lambda *_: -promise)
    monkeypatch.setattr(Searcher, "_chain", lambda _, begin, found: ("further", begin, found))
    searcher = Searcher(data, 1, lambda *_: True, 1, print)
    assert searcher.further(found) == (("further", found.final, found) if goes_on else found)


@pytest.mark.parametrize(("contradicted", "accepted", "both", "waits"), [
    ((), (), -20_000.0, "gravity"),
    (("gravity",), (), -20_000.0, "ripple"),
    (("gravity",), ("gravity",), -20_000.0, "gravity"),
    (("gravity",), ("gravity",), -17_000.0, "ripple"),
    (("gravity", "ripple"), ("ripple",), -20_000.0, "ripple"),
    (("gravity", "ripple"), (), -20_000.0, ""),
])  # fmt: skip
def test_a_step_that_is_contradicted_alone_waits_where_it_is_accepted_together_with_another(
    contradicted: tuple[str, ...], accepted: tuple[str, ...], both: float, waits: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The balancer of a real arm was a gravity first, which the recordings to choose by
    contradicted: a hysteresis waited, and friction and a spring were found. Of a lag and a spring
    each was contradicted, bent to the work of both, and neither was found. Of a pendulum with
    Coulomb friction and drag a friction over the travel waited, and neither was found.
    """
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)

    def rival(law: str, deviance: float, of: str = "") -> Rival:
        scored: Any = SimpleNamespace(deviance=deviance, model=model, of=of)
        return Rival(law, 1, scored, 0.0, (), ())

    gravity, ripple = rival("gravity", -9000.0, "gravity"), rival("ripple", -8500.0, "ripple")

    def accept(_: Any, asked: Rival, waits: bool = False) -> bool:
        return asked.effect not in contradicted if waits else cast(Any, asked.scored).of in accepted

    monkeypatch.setattr(Rounds, "round", lambda _, s: [rival("stiffness", both, s.of)])
    monkeypatch.setattr(Rounds, "glance", lambda *_: -18_000.0)
    searcher = Searcher(data_of(columns, model), 1, accept, 1, print)
    current: Any = SimpleNamespace(deviance=0.0)
    found = searcher._waits(current, [gravity, ripple])
    assert (found.effect if found else "") == waits


def test_two_steps_are_taken_together_of_which_the_first_waited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)
    levels = iter(range(0, -90_000, -9000))

    def scored() -> Any:
        return SimpleNamespace(deviance=next(levels), model=model)

    asked: list[float] = []

    def round_of(_: Rounds, current: Any) -> list[Rival]:
        asked.append(current.deviance)
        law = "gravity" if len(asked) == 1 else "stiffness"
        return [Rival(law, 1, scored(), 0.0, model.terms[:1], ())]

    def accept(before: Any, rival: Rival, waits: bool = False) -> bool:
        pair = rival.effect == "stiffness" and before.deviance == 0.0
        return (pair and not asked[2:]) or waits

    monkeypatch.setattr(forward, "is_white", lambda *_: False)
    monkeypatch.setattr(Rounds, "round", round_of)
    monkeypatch.setattr(Rounds, "glance", lambda _, scored, *__: 2.1 * scored.deviance)
    monkeypatch.setattr(Searcher, "_best_first", lambda _, __, rivals: rivals)
    monkeypatch.setattr(forward, "_simplest_sufficient", lambda rivals, _: rivals)
    monkeypatch.setattr(forward, "simplify", lambda found, *_: (found.final, ()))
    steps = Searcher(data_of(columns, model), 1, accept, 1, print)._chain(scored()).steps
    assert [(step.chosen.effect, step.alone) for step in steps] == [
        ("gravity", False), ("stiffness", True)
    ]


@pytest.mark.parametrize(("behind", "waits"), [(100.0, ""), (9000.0, "gravity")])
def test_a_step_waits_only_for_another_one_that_is_worth_it(
    behind: float, waits: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a friction over its travel nothing was left on EMPS: a seventh of the diagnosis. No
    other step waits in its place: on a TX40 a spring did, and a false ripple came with it.
    """
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)
    searcher = Searcher(data_of(columns, model), 1, lambda *_, **__: True, 1, print)
    gravity, ripple = (
        Rival(law, 1, cast(Any, SimpleNamespace(deviance=at, model=model)), 0.0, (), ())
        for law, at in (("gravity", -9000.0), ("ripple", -8000.0))
    )
    gains = {id(gravity.scored): behind, id(ripple.scored): 9000.0}
    monkeypatch.setattr(Rounds, "glance", lambda _, s, __: s.deviance - gains[id(s)])
    current: Any = SimpleNamespace(deviance=0.0)
    found = searcher._waits(current, [gravity, ripple])
    assert (found.effect if found else "") == waits


def test_a_pair_is_compared_by_its_likeliest_hypotheses_whatever_their_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A round orders by slow observers: what is behind a first step is its likeliest, not its
    first. Pairs that gain no more than that are not searched.
    """
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    model = model_of(VISCOUS, COULOMB)
    data = data_of(columns, model)
    laws = {"ripple": -9000.0, "stiffness": -8000.0}

    def rival(effect: str, deviance: float) -> Rival:
        scored: Any = SimpleNamespace(deviance=deviance, model=model)
        return Rival(effect, 1, scored, 0.0, model.terms[:1], (), rank=-deviance)

    firsts = [rival(effect, value) for effect, value in laws.items()]
    behind = {-9000.0: [-9500.0, -20_000.0], -8000.0: [-20_000.0]}
    asked: list[float] = []

    def round_of(_: Rounds, current: Any) -> list[Rival]:
        asked.append(current.deviance)
        return [rival("coulomb", value) for value in behind[current.deviance]]

    monkeypatch.setattr(forward, "is_white", lambda *_: False)
    monkeypatch.setattr(Rounds, "round", round_of)
    monkeypatch.setattr(Rounds, "glance", lambda *_: -20_000.0)
    searcher = Searcher(data, 1, lambda *_: True, 1, print)
    base: Any = SimpleNamespace(deviance=0.0)
    assert searcher._best_first(base, firsts)[0].effect == "ripple"
    assert asked == [-9000.0]


def test_no_step_starts_from_a_backlash_of_no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    moves: list[float] = []
    monkeypatch.setattr(backlash, "lossy", lambda scored, *_: moves.append(1.0) or scored)
    monkeypatch.setattr(backlash, "descend", lambda scored, *_: scored)
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    for gap, moved in ((1e-9, False), (0.01, True)):
        numbers = {"gap": gap, "stiffness": 120.0, "load_inertia": 0.004, "damping": 0.1}
        model = model_of(VISCOUS, {"kind": "backlash", "joint": 1, **numbers})
        data = data_of(columns, model)
        done = fit(data, model, (), joints=(1,), iterations=0)
        moves.clear()
        backlash.refine(Scored(done, data, 0.0, (1,)), 1, 0.0, 400.0, 1)
        assert bool(moves) is moved


def test_a_light_slow_load_is_found_though_its_start_is_worse_than_none() -> None:
    """A tenth of a machine that swings at 3 Hz: the starts with the smallest error were springs of
    50 Hz, which do nothing, and a pendulum of 1.5 kg in 14 kg was no spring.
    """
    load, motor = 0.0011, 0.0089
    stiffness = (2 * np.pi * 3.0) ** 2 * load * motor / (load + motor)
    machine = reality.Machine(load=load, soft=stiffness, coulomb=0.005, viscous=0.02)
    columns = reality.simulate(machine, reality.multisine(8.0, RATE, 5, high=6.0), RATE)
    base = model_of(VISCOUS, COULOMB)
    calibrated = calibrate_joint(data_of(columns, base), base, 1)
    best = Rounds(calibrated.data, 1, 1, lambda _: None).round(calibrated)[0]
    assert best.effect == "elasticity"
    assert best.scored.model.terms[-1].value("stiffness") == pytest.approx(stiffness, rel=0.05)
