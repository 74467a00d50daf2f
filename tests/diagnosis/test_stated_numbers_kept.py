"""What the numbers that a model states say of a mechanism beside them."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import reality
from made_claims import piece
from reality import RATE
from small_models import data_of, model_of

from zendsp.diagnosis.decide import pieces, rivals
from zendsp.diagnosis.decide.findings import Estimate
from zendsp.diagnosis.decide.stated_numbers import at_ends
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.physics.calibration.bounds import parameter_bounds


@pytest.mark.parametrize(
    ("level", "without", "turning"),
    [
        (0.0301, 0.044, False),  # it had absorbed a hysteresis, beside which it is as stated
        (0.0301, 0.032, True),  # 7 %: stated numbers are not known so well
        (0.026, 0.030, True),  # as stated it is the whole friction, of which bristles take a part
        (0.026, 0.044, True),
    ],
)
def test_a_hysteresis_that_keeps_the_stated_friction_is_not_how_that_turns_round(
    level: float, without: float, turning: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hysteresis of 11 % of the torque was a refinement, since Coulomb friction of 147 % took up
    most of it; and the spring beside it had no law, for what the hysteresis left.
    """

    def model(amount: float) -> Any:
        return model_of({"kind": "coulomb", "joint": 1, "level": amount})

    monkeypatch.setattr(pieces, "at_reversals", lambda *_: 0.9)
    monkeypatch.setattr(pieces, "kept_laws", lambda _, model, *__: model.at(1))
    parts: Any = SimpleNamespace(test=None)
    final: Any = SimpleNamespace(model=model(level))
    bare: Any = SimpleNamespace(model=model(without))
    found = replace(piece(0.014, 14.0, 500.0, "hysteresis"), without=bare)
    assert pieces.turns_round(parts, model(0.03), final, found) is turning


@pytest.mark.parametrize(
    ("effect", "at_turns", "only"),
    [
        ("coulomb_asymmetry", 0.998, True), ("coulomb_asymmetry", 0.1, False),
        ("stribeck", 0.998, False), ("presliding", 0.998, False),
        ("coulomb_asymmetry", 1.0, False),  # the joint does nothing but reverse
    ],
)  # fmt: skip
def test_a_friction_that_acts_always_is_not_known_by_reversals_alone(
    effect: str, at_turns: float, only: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model with the uneven friction that was found, as Coulomb friction and a constant, lacked
    another one of 22 and 0 N (68 %), whose constant calibration had moved to -14: they differed
    where the joint turned round. Its compensation drove the joint away.
    """
    given = model_of({"kind": "coulomb", "joint": 1, "level": 11.0})
    monkeypatch.setattr(pieces, "at_reversals", lambda *_: at_turns)
    parts: Any = SimpleNamespace(test=None)
    final: Any = SimpleNamespace(model=given)
    found = piece(0.0018, 9.0, 200.0, effect)
    without: Any = SimpleNamespace(model=given)
    assert pieces.only_at_turns(parts, given, final, replace(found, without=without)) is only
    nothing = model_of()
    assert not pieces.only_at_turns(parts, nothing, final, replace(found, without=without))


@pytest.mark.parametrize(
    ("rival", "gain", "beside"),
    [("lag", 61_600.0, False), ("hysteresis", 61_600.0, True), ("hysteresis", 90_000.0, False)],
)
def test_a_law_with_no_more_numbers_competes_with_a_stated_number_that_is_wrong(
    rival: str, gain: float, beside: bool
) -> None:
    """A lag of 3 ms beside a filter that the model states was another filter (0.96), though far
    likelier: a law beside a number was compared only where it explained a quarter more.
    """
    given = model_of({"kind": "position_filter", "joint": 1, "time_constant": 0.0025})
    without: Any = SimpleNamespace(deviance=0.0)
    first = replace(piece(0.1, 9.0, 50.0, "position_filter"), without=without)
    final: Any = SimpleNamespace(deviance=-57_000.0)
    scored: Any = SimpleNamespace(deviance=-gain)
    other = Rival(rival, 1, scored, 0.0, (), ())
    assert rivals._beside_a_number(given, final, first, other) is beside


def test_an_order_at_the_end_of_its_search_says_that_it_may_be_smaller() -> None:
    """A ripple twice a turn was a wave of 2.241 ± 0.087: fewer than one and a half of them in the
    travel are no wave, and the search ends there.
    """
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 1), RATE)
    record = data_of(columns, model_of()).records[0][0]
    least, most = parameter_bounds("ripple", "order", record)
    assert least > 2.0 and most == math.inf

    def said(order: float) -> str:
        values = {"order": Estimate(order, 0.09, "1"), "amplitude": Estimate(0.07, 0.01, "N m")}
        return at_ends("ripple", values, record)

    assert said(1.001 * least).startswith(" Its order stands where its search ends")
    assert "the true one may be smaller" in said(1.001 * least)
    assert said(1.2 * least) == ""
