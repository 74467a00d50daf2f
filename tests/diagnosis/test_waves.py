"""Which waves over the position a recording can tell, and how many of them are searched for."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.search import forward
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.diagnosis.search.rounds import Rounds
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
