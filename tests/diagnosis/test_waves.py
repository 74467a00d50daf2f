"""Which waves over the position a recording can tell, and how many of them are searched for."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide.claims import Piece
from zendsp.diagnosis.decide.rivals import _ripples
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.search import forward
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import within_basin
from zendsp.physics.calibration.joint import facts
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Quantity, Term

MODEL = model_of(VISCOUS, COULOMB)


def recording() -> Any:
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    return data_of(columns, MODEL)


@pytest.mark.parametrize("wave", ["ripple", "transmission_error", "sensor_harmonic"])
@pytest.mark.parametrize("slides", [True, False])
def test_a_wave_along_an_axis_repeats_within_the_travel(wave: str, slides: bool) -> None:
    """A transmission error with one period in the travel of the EMPS was a step of its search, and
    no finding. A turn of a joint says how often its gears and its sensor repeat.
    """
    seen = replace(facts(recording().records[0][0]), slides=slides)
    travel = replace(seen, scale=replace(seen.scale, position=0.25))
    order = next(p for p in get_effect(wave).parameters if p.name == "order")
    assert order.limits is not None
    least, _ = order.limits(travel)
    periods = least * 0.25 / (2.0 * math.pi)
    told = slides or wave == "ripple"
    assert periods == pytest.approx(1.5) if told else periods < 0.06


@pytest.mark.parametrize(("effect", "key"), [("ripple", "order"), ("position_friction", "period")])
def test_no_fourth_wave_is_looked_for(
    effect: str, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More waves are the series of a torque that has no law: a magnet at one place took six."""
    levels = iter(range(0, -90_000, -9000))

    def scored() -> Any:
        return SimpleNamespace(deviance=next(levels), model=MODEL)

    def round_of(*_: Any) -> list[Rival]:
        wave = Term(effect, 1, {key: Quantity(1.0)})
        return [Rival(effect, 1, scored(), 0.0, (wave,), ())]

    monkeypatch.setattr(forward, "is_white", lambda *_: False)
    monkeypatch.setattr(Rounds, "round", round_of)
    monkeypatch.setattr(Searcher, "_best_first", lambda _, __, rivals: rivals)
    for change in ("split_asymmetry", "straightened"):
        monkeypatch.setattr(forward, change, lambda _, current, __: current)
    monkeypatch.setattr(forward, "simplify", lambda found, *_: (found.best, ()))
    searcher = Searcher(recording(), 1, lambda *_, **__: True, 1, print)
    assert len(searcher._chain(scored()).steps) == 3


FEW = {"kind": "ripple", "joint": 1, "order": 2.0, "amplitude": 0.02, "phase": 0.4}


def with_two_periods_a_turn(*more: dict[str, object]) -> tuple[Any, Any]:
    """A recording over a third of a turn, and a model of it."""
    machine = reality.Machine(ripple=0.02, order=2)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 3), RATE)
    model = model_of(VISCOUS, {**COULOMB, "level": 0.027}, *more)
    return data_of(columns, model), model


def test_a_given_wave_with_few_periods_in_the_travel_stays_itself() -> None:
    """Calibration had moved an exact ripple from twice a turn to 4.3 times, the least that is
    searched for, and the model erred four times as much.
    """
    data, model = with_two_periods_a_turn(FEW)
    base = calibrate_joint(data, model, 1)
    ripple = base.model.terms[-1]
    assert ripple.value("order") == pytest.approx(2.0, abs=0.1)
    assert ripple.value("amplitude") == pytest.approx(0.02, rel=0.1)
    travel = facts(data.records[0][0]).scale.position
    assert within_basin(2.0, 4.3, math.inf, travel)[1] == pytest.approx(2.0 + math.pi / travel)
    assert within_basin(5.0, 4.3, math.inf, travel) == (4.3, math.inf)


def test_no_wave_with_few_periods_in_the_travel_is_searched_for() -> None:
    data, model = with_two_periods_a_turn()
    base = calibrate_joint(data, model, 1)
    listed = Rounds(data, 1, 1, print).options(base, frozenset({"ripple"}))
    least, _ = parameter_bounds("ripple", "order", data.records[0][0])
    assert listed[0][1].terms[0].value("order") >= least > 4.0


def test_a_law_over_the_position_is_not_told_from_a_ripple_with_few_periods() -> None:
    """A ripple twice a turn over a third of one was called a hardening spring, without a word of
    the ripple. Of a real spring over more of a turn no ripple is alike.
    """
    data, model = with_two_periods_a_turn()
    assert _alike_to_a_ripple(data, model, "gravity")
    machine = reality.Machine(spring=0.1)
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, 3, size=1.9), RATE)
    assert not _alike_to_a_ripple(data_of(columns, model), model, "stiffness")


def _alike_to_a_ripple(data: Any, model: Any, law: str) -> bool:
    base, rounds = calibrate_joint(data, model, 1), Rounds(data, 1, 1, lambda _: None)
    (found,) = rounds.stand_ins(base, frozenset({law}))
    term = found.scored.model.terms[-1]
    evidence = Evidence(0.5 * (base.deviance - found.scored.deviance), 9.0, np.zeros(1))
    piece = Piece("position_torque", (term,), base, 0.1, evidence, 9.0)
    parts: Any = SimpleNamespace(fit=data, choose=data)
    return _ripples(parts, rounds, found.scored, piece, piece)
