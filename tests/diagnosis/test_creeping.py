"""How a dry friction creeps where it turns round, known or found, and what imitates that."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.explain import one_joint
from zendsp.diagnosis.search import forward
from zendsp.diagnosis.search.candidates import loosened
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival, Step
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.model import Model, Term

CREEP = {"kind": "creep", "joint": 1, "speed": 0.002}


@pytest.mark.parametrize(("alone", "warm"), [(100.0, True), (500.0, False)])
def test_findings_are_refitted_upon_a_creep_that_gains_little_and_the_search_goes_on(
    monkeypatch: pytest.MonkeyPatch, alone: float, warm: bool
) -> None:
    def scored(deviance: float) -> Any:
        return SimpleNamespace(deviance=deviance)

    first: Any = SimpleNamespace(base=scored(0.0), final=scored(-1000.0))
    upon: Any = SimpleNamespace(final=scored(-1060.0))
    soft: Any = SimpleNamespace(deviance=-alone, model=model_of(VISCOUS, CREEP))
    both, begun = scored(-1055.0), []
    monkeypatch.setattr(one_joint, "upon", lambda *given: begun.append(given) or upon)
    again: Any = SimpleNamespace(
        further=lambda found: ("further", found),
        creeping=lambda *given: both if given == (first.final, soft.model.terms[-1]) else None,
    )
    found = one_joint._upon_creep(first, soft, again, 1)
    assert found == (("further", upon) if warm else None)
    assert begun == [(first, soft, 1, both)] * warm


@pytest.mark.parametrize(("ahead", "begun"), [(50.0, ["creep"]), (30.0, ["", "creep"])])
def test_a_creep_likelier_than_every_hypothesis_comes_before_the_search(
    ahead: float, begun: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    given = model_of(VISCOUS, COULOMB)
    parts: Any = SimpleNamespace(fit=data_of(columns, given), choose=None)
    paid = 2 * np.log(sum(rec[0].informative for rec in parts.fit.records))
    base: Any = SimpleNamespace(deviance=0.0, model=given)
    creep = model_of(VISCOUS, COULOMB, CREEP)
    soft: Any = SimpleNamespace(deviance=-100.0 - ahead - paid, model=creep)
    searched: list[str] = []

    def search(_: Searcher, begin: Any) -> JointSearch:
        searched.append("creep" if begin is soft else "")
        return JointSearch(1, begin)

    rival: Any = SimpleNamespace(value=-100.0)
    monkeypatch.setattr(Rounds, "round", lambda *_: [rival])
    for name, result in (("softened", soft), ("late_log", None), ("_rotor", None)):
        monkeypatch.setattr(Searcher, name, lambda *_, result=result: result)
    monkeypatch.setattr(Searcher, "search", search)
    monkeypatch.setattr(one_joint, "is_white", lambda *_: False)
    monkeypatch.setattr(one_joint, "calibrate_joint", lambda *_: base)
    monkeypatch.setattr(one_joint, "with_fine_ripples", lambda _, found, __: found)
    monkeypatch.setattr(one_joint, "decide", lambda _, beneath, *__: beneath)
    found, beneath = one_joint._search_joint(parts, given, 1, 1, print)
    assert searched == begun and found.base is soft and beneath == creep


@pytest.mark.parametrize(
    ("effects", "level", "left", "creeps"),
    [
        (("coulomb", "elasticity"), 0.03, -500.0, True),
        (("coulomb", "presliding"), 0.03, -500.0, True),
        (("coulomb", "elasticity"), 0.03, -280.0, False),  # the spring explains more
        (("coulomb", "elasticity"), 0.034, -500.0, False),  # its level moves (a TX40)
        (("coulomb", "elasticity"), 0.0, -500.0, False),  # creep does not pay
        (("coulomb", "gravity"), 0.03, -500.0, False),  # nothing that imitates it
        (("elasticity",), 0.03, -500.0, False),  # no dry friction
    ],
)
def test_a_friction_that_is_found_may_creep_before_a_spring_is_believed_beside_it(
    effects: tuple[str, ...],
    level: float,
    left: float,
    creeps: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A spring of 17700 N m/rad (0.82) imitated a friction that rose within 0.011 rad/s, and a
    payload MuJoCo's (seeds 1003, case 87, and 902, case 91).
    """
    def scored(deviance: float, *terms: Any) -> Any:
        model = model_of(*terms) if terms else None
        return SimpleNamespace(deviance=deviance, model=model, data=None)

    def chosen(effect: str) -> Any:
        return Rival(effect, 1, scored(-100.0), 0.0, (Term(effect, 1, {}),), ())

    steps = [Step(chosen(effect), (), scored(0.0)) for effect in effects]
    first = JointSearch(1, scored(0.0), steps, scored(-300.0, VISCOUS, COULOMB))
    softened = scored(-400.0, VISCOUS, COULOMB, CREEP) if level else None
    searcher: Any = SimpleNamespace(softened=lambda _: softened, jobs=1, accept=None)
    monkeypatch.setattr(one_joint, "calibrate_joint", lambda *_: scored(0.0))
    monkeypatch.setattr(one_joint, "joint_handles", lambda *_: ())
    monkeypatch.setattr(one_joint, "fit_scored", lambda *_, **__: scored(-400.0))
    began: list[JointSearch] = []

    def further(_: Searcher, found: JointSearch) -> JointSearch:
        began.append(found)
        return replace(found, best=scored(left, VISCOUS, {**COULOMB, "level": level}, CREEP))

    monkeypatch.setattr(Searcher, "__init__", lambda *_: None)
    monkeypatch.setattr(Searcher, "further", further)
    parts: Any = SimpleNamespace(fit=None)
    found, beneath = one_joint._creeping_found(parts, model_of(VISCOUS), first, searcher, print)
    assert (found is not first) is creeps
    assert [t.effect for t in beneath.terms] == ["viscous", "creep"][: 1 + creeps]
    if creeps:  # it goes on from the friction, and no free number of the creep is claimed
        assert [s.chosen.effect for s in began[0].steps] == ["coulomb"]
        assert not any(q.free for q in beneath.terms[-1].parameters.values())
    # a friction does not creep twice: a decision then took one away for ever (seed 1710, case 45)
    crept = model_of(VISCOUS, COULOMB, CREEP)
    assert one_joint._creeping_found(parts, crept, first, searcher, print) == (first, crept)


@pytest.mark.parametrize("likelier", [True, False])
def test_creep_is_fitted_round_and_straight_where_the_known_one_is_worse(
    likelier: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    data = data_of(columns, model := model_of(VISCOUS, COULOMB))
    base: Any = SimpleNamespace(data=data, model=model, deviance=60.0 if likelier else 40.0)
    begun: list[tuple[float, bool]] = []  # shape, whether the lead is free

    def fitted(_: Data, model: Model, *__: Any, **___: Any) -> Any:
        term = model.terms[-1]
        begun.append((term.value("shape"), term.parameters["lead"].free))
        return SimpleNamespace(deviance=50.0 - len(begun), began=begun[-1])

    monkeypatch.setattr(forward, "fit_scored", fitted)
    searcher = Searcher(data, 1, lambda *_: True, 1, print)
    known = model_of(CREEP).terms[0]
    best: Any = searcher.creeping(base, known)
    assert begun == [(0.0, False)] * (1 if likelier else 2) + [(1.0, True)] * (not likelier)
    assert best.began == begun[-1]


@pytest.mark.parametrize(
    ("key", "lead", "none"),
    [
        ("speed", 0.0, True), ("lead", 0.1, True), ("lead", 0.0, False), ("level", 0.1, False),
        ("", 0.01, False),
    ],
)  # fmt: skip
def test_a_creep_larger_than_any_is_none(
    key: str, lead: float, none: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ripple at an arm's last joint was a creep that saw the speed 0.1 s ahead. A tanh has no
    lead.
    """
    columns = reality.simulate(reality.Machine(), reality.multisine(2.0, RATE, 3), RATE)
    data = data_of(columns, base_model := model_of(VISCOUS, COULOMB))
    base: Any = SimpleNamespace(data=data, model=base_model, deviance=0.0)
    model = model_of(VISCOUS, COULOMB, {**CREEP, "lead": lead})
    handles = [Handle("term", 1, "level"), Handle("term", 2, "speed"), Handle("term", 2, "lead")]
    fitted = SimpleNamespace(handles=handles, at_bound=[h.key == key for h in handles])
    best: Any = SimpleNamespace(model=model, fit=fitted, deviance=-900.0)
    monkeypatch.setattr(Searcher, "creeping", lambda *_: best)
    found = Searcher(data, 1, lambda *_: True, 1, print).softened(base)
    assert found is (None if none else best)


def test_the_creep_of_a_found_friction_is_asked_before_the_decision(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given, creeping = model_of(VISCOUS), model_of(VISCOUS, CREEP)
    base: Any = SimpleNamespace(deviance=0.0, model=given)
    springy, soft = JointSearch(1, base), JointSearch(1, base)
    monkeypatch.setattr(Searcher, "__init__", lambda *_: None)
    for name, result in (("softened", None), ("late_log", None), ("search", springy)):
        monkeypatch.setattr(Searcher, name, lambda *_, result=result: result)
    monkeypatch.setattr(one_joint, "is_white", lambda *_: True)
    monkeypatch.setattr(one_joint, "calibrate_joint", lambda *_: base)
    monkeypatch.setattr(one_joint, "with_fine_ripples", lambda _, found, __: found)
    monkeypatch.setattr(one_joint, "decide", lambda _, beneath, *__: beneath)
    monkeypatch.setattr(one_joint, "_creeping_found", lambda *_: (soft, creeping))
    parts: Any = SimpleNamespace(fit=None, choose=None)
    found, beneath = one_joint._search_joint(parts, given, 1, 1, print)
    assert found is soft and beneath is creeping


def test_a_creep_that_the_search_holds_is_no_law_with_a_wrong_number() -> None:
    """Freed, one of 0.07 rad/s became one of 0.9 mrad/s beside a Coulomb friction of 2 N m, whose
    name it took: both were fluid friction without a law.
    """
    held = {**COULOMB, "level": {"value": 0.03, "free": False}}
    model = model_of(held, CREEP)
    model = model.with_terms(tuple(t.held() for t in model.terms))
    (offered,) = loosened(model, 1)
    assert [candidate.effect for candidate in offered] == ["coulomb"]
