"""What is said of the torque that no claimed law explains, and of laws that were tried."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_claims import PARTS, piece
from small_models import model_of

from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import naming, nothing_named, pieces
from zendsp.diagnosis.decide.claims import Claim, Decision, Near
from zendsp.diagnosis.decide.contract import Reason, Rejected
from zendsp.diagnosis.decide.near import bent, likeness, nearest_law
from zendsp.diagnosis.decide.notes import left_over
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.measure.where import Missing
from zendsp.physics.model import Model, Term

NOTHING = Structure(0.0, 0.0, 0.0)


def test_a_torque_without_a_law_is_shown_free_of_what_else_was_found() -> None:
    """Its own pieces and refinements are removed, and the given friction that one replaced is
    restored.
    """

    def model(*effects: str) -> Model:
        return Model("m", 1e-3, "rotary", {}, tuple(Term(e, 1, {}) for e in effects))

    def shown(mechanism: str, *named: str) -> list[str]:
        calibrated = model("viscous", "coulomb")
        improved = model("viscous", "coulomb_asymmetry", "quadratic_drag", "gravity", "ripple")
        beside = pieces.beside_unknown(calibrated, improved, 1, mechanism, named)
        return sorted(t.effect for t in beside.terms)

    frictions = ["coulomb_asymmetry", "quadratic_drag", "viscous"]
    assert shown("position_torque", "coulomb_asymmetry") == frictions
    assert shown("dry_friction", "quadratic_drag", "gravity") == [
        "coulomb", "gravity", "quadratic_drag", "ripple", "viscous",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("size", "z", "left", "reason", "why"),
    [
        (0.0001, 5.0, 0.01, "too_small", "too small to be told"),
        (0.1, 5.0, 0.01, "near", "not surely this law: 10 % of the torque, and up to 1 % may stay"),
        (0.1, 5.0, 0.09, "other", "not what is missing: 10 % of the torque, and 9 % stays"),
        (0.1, 0.5, 0.01, "other", "is not what is missing, on the recordings held out"),
    ],
)
def test_a_tried_law_that_is_no_finding_says_why(
    size: float, z: float, left: float, reason: str, why: str
) -> None:
    seen = replace(piece(size, z, 20.0), why="known laws may be wrong by as much")
    before, after = Size(0.1, 0.1, 0.1), Size(left, left, left)
    base = SimpleNamespace(model=SimpleNamespace(kind="rotary"))
    search: Any = SimpleNamespace(joint=2, base=base)
    lost = nothing_named._lost("ripple", search, 100.0, [seen], before, after)
    assert (lost.effect, lost.joint, lost.score) == ("ripple", 2, 50.0)
    assert lost.why.startswith(why)
    assert lost.reason == reason
    near = nearest_law([lost], [seen], before, after)
    assert (near is not None) == (lost.reason is Reason.NEAR)
    if near is not None:
        assert lost.why.endswith("; known laws may be wrong by as much")
        assert likeness(near) == (
            "It is most like ripple: with it 1 % of the torque stays unexplained, without it 10 %."
            " It is not called that: known laws may be wrong by as much"
        )


@pytest.mark.parametrize("state", [Structure(0.1, 0.9, 5.0), NOTHING])
def test_what_short_or_one_way_recordings_leave_open_is_reported(state: Structure) -> None:
    drive = SimpleNamespace(hold=None)
    model: Any = SimpleNamespace(torque_unit=lambda _: "N m", actuator=drive)
    one: Any = SimpleNamespace(model=model)
    left = Size(0.3, 0.2, 0.4)
    found = Decision(1, "unexplained", (), (), one, one, left, left, state, left, one, 7.0)
    for q, said in ((np.linspace(0.0, 1.0, 1300), True), (np.sin(np.arange(9000) / 100), False)):
        record = SimpleNamespace(others=q[None, None], n=len(q), sample_time=0.001, between=1.0)
        fit: Any = SimpleNamespace(records=[[record]])
        words = left_over([found], model, fit)
        assert ("1.3 s, and go one way: too little" in words) == said


@pytest.mark.parametrize("state", [Structure(0.1, 0.9, 5.0), NOTHING])
def test_a_remainder_that_a_library_law_nearly_describes_is_not_called_unknown(
    state: Structure
) -> None:
    """The report had said that no known effect describes a torque of which hysteresis explains six
    sevenths.
    """
    model: Any = SimpleNamespace(torque_unit=lambda _: "N m", actuator=SimpleNamespace(hold=0.001))
    one: Any = SimpleNamespace(model=model)
    lacks = Size(0.3, 0.2, 0.4)
    found = Decision(1, "unexplained", (), (), one, one, lacks, lacks, state, lacks, one, 7.0)
    record = SimpleNamespace(
        others=np.sin(np.arange(9000) / 100)[None, None], n=9000, sample_time=0.001, between=1.0
    )
    fit: Any = SimpleNamespace(records=[[record]])
    none = left_over([found], model, fit)
    assert "none of the known effects" in none or "neither a known effect" in none
    law = Near("hysteresis", 0.3, 0.05, "known laws may be wrong by as much", ("lag",))
    words = left_over([replace(found, near=law)], model, fit)
    assert "known effect" not in words, words
    assert "most like hysteresis: with it and lag 5 % of the torque stays unexplained" in words
    assert "It is not called that: known laws may be wrong by as much" in words


def test_a_mechanism_without_a_law_names_the_one_that_it_is_most_like() -> None:
    term, evidence = Term("unknown", 1, {}), Evidence(9, 9, np.ones(2))
    claim = Claim("unknown", "dry_friction", term, 0.3, evidence, 9, {}, (), (), ())
    # a refinement explains what the law leaves
    plain: Any = SimpleNamespace(near=None, after=Size(0.0, 0.0, 0.0), bare=Size(0.01, 0.01, 0.01))
    assert naming._nearest(claim, plain) == "none of the known laws describes it"
    plain.near = Near("position_friction", 0.3, 0.05, bent(["ripple"]))
    assert naming._nearest(claim, plain) == (
        "it is most like position_friction, with which 5 % of the torque stays unexplained, and is"
        " not called that: a curve that differs from it a little, which is no law with a name,"
        " predicts as well; so may ripple"
    )
    drawn = replace(claim, term=Term("ripple", 1, {}), why="the travel shows no whole period of it")
    said = naming._nearest(drawn, plain)
    assert "most like ripple, with which 1 %" in said and said.endswith("no whole period of it")


@pytest.mark.parametrize(
    ("other", "joints", "said"),
    [
        (0.0, 3, "position of joint 3 is"),
        (3.0, 3, "position of joint 3, or of joints beside it, is"),
        (3.0, 1, "position of joint 3 is"),
    ],
)
def test_torque_over_the_places_of_several_joints_is_not_put_down_to_its_own_alone(
    monkeypatch: pytest.MonkeyPatch, other: float, joints: int, said: str
) -> None:
    """A hose from the wall to a gantry's head pulled at the yaw by where the slides stood."""
    time = np.arange(8000) * 2e-3
    q, beside = np.sin(time), np.sin(1.7 * time)
    rows = Missing(time, q + other * beside, np.ones(8000), {"position": q})
    monkeypatch.setattr(naming, "confidence", lambda *_: 0.5)
    monkeypatch.setattr(naming, "_nearest", lambda *_: "no law")
    given: Any = SimpleNamespace(joints=joints, terms=(), torque_unit=lambda _: "N m")
    monkeypatch.setattr(naming, "units", lambda *_: {"position": "rad"})
    monkeypatch.setattr(naming, "_replaced", lambda *_: ())
    term, evidence = Term("unknown", 3, {}), Evidence(9, 9, np.ones(2))
    claim = Claim("unknown", "position_torque", term, 0.3, evidence, 9, {}, (), (), ())
    decision: Any = SimpleNamespace(joint=3, scale=1.0, strap=())
    whole: Any = None
    assert said in naming._unknown(given, decision, whole, claim, 0.5, [rows]).sentence


@pytest.mark.parametrize(("kind", "said"), [("planar2r", True), ("rotary", False)])
def test_torque_beside_another_joints_backlash_is_put_down_to_the_link_behind_it(
    kind: str, said: bool
) -> None:
    """The link behind the gap moved unlike its motor, and joint 2 felt the difference."""
    drive = SimpleNamespace(hold=0.001)
    model: Any = SimpleNamespace(kind=kind, torque_unit=lambda _: "N m", actuator=drive)
    one: Any = SimpleNamespace(model=model)
    left, gap = Size(0.11, 0.1, 0.12), Term("backlash", 1, {})
    claim = Claim(
        "backlash", "transmission", gap, 0.3, Evidence(9, 9, np.ones(2)), 9, {}, (), (), ()
    )
    decisions = [
        Decision(
            1, "missing", (claim,), (), one, one, left, Size(0, 0, 0), NOTHING, left, one, 7.0
        ),
        Decision(2, "unexplained", (), (), one, one, left, left, NOTHING, left, one, 7.0),
    ]
    record = SimpleNamespace(
        others=np.sin(np.arange(9000) / 100)[None, None].repeat(2, 0),
        n=9000, sample_time=0.001, between=1.0,
    )  # fmt: skip
    fit: Any = SimpleNamespace(records=[[record, record]])
    assert ("link behind joint 1 moves otherwise" in left_over(decisions, model, fit)) == said


@pytest.mark.parametrize(
    ("reason", "said"), [(Reason.OTHER, True), (Reason.NEAR, True), (Reason.TOO_SMALL, False)]
)
def test_untouched_recordings_are_not_doubted_for_an_effect_that_is_too_small(
    reason: Reason, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = _concluded((Rejected("stiffness", 1, "", 5000.0, reason),), monkeypatch)
    assert bool(found.doubted) == said


@pytest.mark.parametrize(("lacks", "said"), [(0.006, True), (0.00015, False)])
def test_what_is_likelier_in_the_fit_and_is_no_torque_that_lacks_there_leaves_nothing_open(
    lacks: float, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A filter of the log makes a sensor's errors alike: a complete cart was likelier by 3334 with
    a Stribeck curve, of 0.014 % of its torque.
    """
    lost, fit = (Rejected("stribeck", 1, "", 3334.0),), Size(lacks, lacks, lacks)
    found = _concluded(lost, monkeypatch, fit)
    assert bool(found.doubted) == said


@pytest.mark.parametrize(("untouched", "said"), [(0.0011, True), (0.0025, False)])
def test_what_the_fit_does_not_surely_lack_more_than_the_untouched_leaves_nothing_open(
    untouched: float, said: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stamps that jitter: commands that step were at other times, as a voltage limit of 0.1 % of
    the torque, with which a complete arm was likelier by 1700.
    """
    lost = (Rejected("voltage_limit", 1, "", 1700.0),)
    found = _concluded(lost, monkeypatch, Size(0.0031, 0.0018, 0.0055), Size(0.001, 0.0, untouched))
    assert bool(found.doubted) == said


LACKS, LACKS_NOTHING = Size(0.01, 0.01, 0.01), Size(0.0, 0.0, 0.0)


def _concluded(
    lost: tuple[Rejected, ...], monkeypatch: pytest.MonkeyPatch,
    fit: Size = LACKS, left: Size = LACKS_NOTHING,
) -> Decision:
    """The decision where untouched recordings and those of the fit lack so much torque, and the
    given laws were rejected.
    """
    one: Any = SimpleNamespace(model=None)
    d = Decision(1, "complete", (), (), one, one, left, left, NOTHING, left, one, 7.0, lost=lost)
    for name, answer in (("_decided", d), ("rubs", True), ("lost", True), ("discrepancy", fit)):
        monkeypatch.setattr(decision, name, lambda *_, answer=answer: answer)
    search: Any = SimpleNamespace(joint=1, base=one)
    given: Any = None
    return decision.decide(PARTS, given, search, 1, lambda _: None)


@pytest.mark.parametrize(("names", "loads"), [("aaa", ()), ("aab", ("b",))])
def test_another_load_is_mentioned_only_where_there_are_several_recordings(
    names: str, loads: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    one: Any = SimpleNamespace(model=None)
    left = Size(0.3, 0.2, 0.4)
    found = Decision(1, "unexplained", (), (), one, one, left, left, NOTHING, left, one, 7.0)
    for name, answer in {
        "worth_choosing": one, "discrepancy": left, "new_terms": [], "nothing_named": found,
        "by_own_numbers": ("b",),
    }.items():  # fmt: skip
        monkeypatch.setattr(decision, name, lambda *_, answer=answer: answer)
    data = [SimpleNamespace(records=[[SimpleNamespace(recording=name)]]) for name in names]
    parts: Any = SimpleNamespace(each=data, test=data[-1])
    search: Any = SimpleNamespace(joint=1, base=one)
    given: Any = None
    assert decision._decided(parts, given, search, 1, lambda _: None).loads == loads


@pytest.mark.parametrize(("score", "open_"), [(10368.0, True), (626.0, False)])
def test_what_only_the_recordings_of_the_fit_show_leaves_a_joint_open(
    score: float, open_: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint was late by 5 ms, and the held-out motion was too slow to show it."""
    lost = (Rejected("delay", 1, "", score), Rejected("lag", 1, "", 12.0))
    found = _concluded(lost, monkeypatch)
    assert found.doubted == ((("delay", 1),) if open_ else ())
    assert found.kind == ("unexplained" if open_ else "complete")
    fit: Any = None
    said = left_over([found], model_of(), fit)
    assert ("only the recordings of the fit show delay" in said) is open_
