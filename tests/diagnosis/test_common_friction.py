"""Friction that every machine has, where the given model has none of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_claims import claim_of, of_one_claim

from zendsp.diagnosis.decide import believed, nameless, nothing_named, pieces
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide.claims import Claim, Decision, Piece, needed
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Estimate
from zendsp.diagnosis.explain import one_joint
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.axes import slow_limits
from zendsp.physics.model import Quantity, Term


def model(*effects: str) -> Any:
    """A model with these effects at joint 1."""
    terms = tuple(Term(e, 1, {"level": Quantity(1.0)}) for e in effects)
    return SimpleNamespace(at=lambda joint: terms if joint == 1 else (), terms=terms, called=None)


@pytest.mark.parametrize(
    ("effect", "given", "z", "goes_on"),
    [
        ("coulomb", (), 0.0, True),
        ("coulomb", (), -2.0, False),  # contradicted
        ("coulomb", ("viscous",), 0.0, True),
        ("viscous", ("coulomb",), 0.0, True),
        ("coulomb", ("stribeck",), 0.0, False),  # it has a dry friction
        ("ripple", (), 0.0, False),  # not every machine has one
        ("ripple", (), 1.5, True),
    ],
)
def test_the_search_goes_on_with_a_missing_common_friction_unless_it_is_contradicted(
    effect: str, given: tuple[str, ...], z: float, goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(one_joint, "compare", lambda *_: Evidence(10.0 * z, z, np.zeros(1)))
    before: Any = SimpleNamespace(deviance=0.0, model=model(*given))
    better: Any = SimpleNamespace(deviance=-500.0)
    asked = one_joint.Acceptance(SimpleNamespace())  # type: ignore[arg-type]
    rival = Rival(effect, 1, better, 0.0, (), ())
    assert asked(before, rival) is goes_on
    assert asked(before, rival, waits=True) is (z > -1.0)


@pytest.mark.parametrize(
    ("z", "log_e", "sure"), [(2.2, 4.0, True), (1.9, 4.0, False), (2.2, 2.9, False)]
)
def test_a_common_friction_that_the_model_lacks_needs_less_evidence(
    z: float, log_e: float, sure: bool
) -> None:
    test: Any = SimpleNamespace(joints=6)
    assert log_e < needed(6)
    term = Term("coulomb", 1, {})
    evidence = Evidence(100.0, z, np.array([1.0, -1.0]))
    piece = Piece("dry_friction", (term,), None, 0.3, evidence, log_e, expected=True)  # type: ignore[arg-type]
    assert pieces.sure(test, piece) is sure
    assert not pieces.sure(test, replace(piece, expected=False))


@pytest.mark.parametrize(
    ("given", "expected"), [((), True), (("viscous",), True), (("viscous", "coulomb"), False)]
)
def test_only_friction_that_the_given_model_lacks_is_expected(
    given: tuple[str, ...], expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scored: Any = SimpleNamespace(deviance=0.0, model=model())
    monkeypatch.setattr(pieces, "_without", lambda *_: scored)
    monkeypatch.setattr(pieces, "difference", lambda *_: 0.1)
    monkeypatch.setattr(pieces, "compare", lambda *_: Evidence(9.0, 9.0, np.ones(4)))
    monkeypatch.setattr(pieces, "log_e_value", lambda *_: 9.0)
    monkeypatch.setattr(pieces, "_lacks", lambda *_: True)
    test: Any = SimpleNamespace(joints=1)
    terms = (Term("coulomb", 1, {}),)
    monkeypatch.setattr(pieces, "_contains", lambda *_: True)
    found = pieces.piece_of(test, model(*given), scored, "dry_friction", terms, (scored,), 1)
    assert found.expected is expected


def doubted(effect: str, monkeypatch: pytest.MonkeyPatch) -> Decision:
    """A claim of which 53 in 100 are right, with Coulomb friction among its refinements."""
    monkeypatch.setattr(believed, "confidence", lambda *_: 0.53)
    monkeypatch.setattr(believed, "_is_likely", lambda c, *_: c.effect == "coulomb")
    monkeypatch.setattr(believed, "_goes_on", lambda *_: np.inf)
    monkeypatch.setattr(believed, "by_themselves", lambda *_: SimpleNamespace(model=None))
    monkeypatch.setattr(believed, "discrepancy", lambda *_: "bare")
    claim = replace(claim_of(Term(effect, 1, {}), 0.28), laws={effect: 1.0})
    found = of_one_claim(claim, 0.3, 0.04, SimpleNamespace(model=model()))
    coulomb = replace(claim_of(Term("coulomb", 1, {}), 0.08), same=("coulomb_asymmetry",))
    return replace(found, refinements=(coulomb,))


@pytest.mark.parametrize(("given", "stated"), [((), "coulomb"), (("coulomb",), "")])
def test_a_doubted_stribeck_curve_of_a_model_without_dry_friction_is_coulomb_friction(
    given: tuple[str, ...], stated: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Axis 3 of a KUKA KR300, all dry friction taken out of its model: 28 % of the torque, sure by
    13 standard deviations, and no law was stated.
    """
    monkeypatch.setattr(believed, "_turns_otherwise", lambda *_: True)
    parts: Any = SimpleNamespace(test=None)
    found = believed.believed(doubted("stribeck", monkeypatch), parts, model(*given), 1)
    assert [c.effect for c in found.claims] == [stated] * bool(stated)
    if stated:
        (claim,) = found.claims
        assert claim.size == 0.28 and claim.same == ("coulomb_asymmetry",)
        assert claim.laws == pytest.approx({"coulomb": 0.47, "stribeck": 0.53})
        assert [c.effect for c in found.refinements] == ["stribeck"]


@pytest.mark.parametrize(("given", "named"), [((), "coulomb"), (("coulomb",), "unknown")])
def test_a_missing_coulomb_friction_stands_beside_a_fluid_one_without_a_law(
    given: tuple[str, ...], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """EMPS, given its mass and viscous friction and nothing else, lacked "a fluid friction" (75 %),
    since its viscous friction has another number each way, and so left more than Coulomb may.
    """
    dry, drag = (
        replace(claim_of(Term(e, 1, {}), size), laws={e: 1.0})
        for e, size in (("coulomb", 0.15), ("viscous_asymmetry", 0.06))
    )
    drawn = [dry.term, drag.term]
    monkeypatch.setattr(believed, "_is_likely", lambda c, *_: c is dry)
    monkeypatch.setattr(believed, "_goes_on", lambda *_: np.inf)
    monkeypatch.setattr(believed, "_without_others", lambda claims, *_: [c.term for c in claims])
    monkeypatch.setattr(believed, "_hid", lambda _claim, terms, *_: terms != drawn)
    for name in ("told_apart", "_turns_otherwise"):
        monkeypatch.setattr(believed, name, lambda *_, so=name == "told_apart": so)
    monkeypatch.setattr(believed, "_beside_doubted", lambda *_: {})
    monkeypatch.setattr(believed, "by_its_variables", lambda c, *_: c)
    found = replace(of_one_claim(dry, 0.2, 0.02), claims=(dry, drag))
    outcome = believed.believed(found, None, model(*given), 1)  # type: ignore[arg-type]
    assert outcome.claims[0].effect == named


def test_a_fluid_friction_without_a_law_keeps_its_name_beside_a_dry_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Axis 1 of that robot without any friction had two findings of dry friction."""
    drag, dry = (
        replace(claim_of(Term(e, 1, {}), size), laws={e: 1.0})
        for e, size in (("viscous_asymmetry", 0.5), ("coulomb", 0.7))
    )
    monkeypatch.setattr(believed, "_is_likely", lambda c, *_: c.effect == "coulomb")
    monkeypatch.setattr(believed, "_goes_on", lambda *_: np.inf)
    monkeypatch.setattr(believed, "told_apart", lambda *_: True)
    monkeypatch.setattr(believed, "_without_others", lambda *_: None)
    monkeypatch.setattr(believed, "_beside_doubted", lambda *_: {})
    renamed: list[Claim] = []
    monkeypatch.setattr(believed, "by_its_variables", lambda c, *_: renamed.append(c) or c)
    found = replace(of_one_claim(drag, 1.0, 0.1), claims=(drag, dry))
    outcome = believed.believed(found, None, model(), 1)  # type: ignore[arg-type]
    assert [(c.effect, c.mechanism) for c in outcome.claims] == [
        ("unknown", "fluid_friction"), ("coulomb", "dry_friction"),
    ]  # fmt: skip
    assert not renamed
    believed.believed(replace(found, claims=(drag,)), None, model(), 1)  # type: ignore[arg-type]
    assert renamed


@pytest.mark.parametrize(
    ("beside", "alone", "blurred"), [(150.0, 6.0, True), (20.0, 6.0, False), (150.0, 60.0, False)]
)
def test_refinements_that_make_a_claimed_number_uncertain_are_left_out(
    beside: float, alone: float, blurred: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Axis 6: 108 ± 6 N m of Coulomb friction became 289 ± 150 beside a drift, and was no finding.
    """
    stds = {"final": beside, "alone": alone}
    monkeypatch.setattr(
        decision, "estimates", lambda fit, *_: {"level": Estimate(108.0, stds[fit], "N m")}
    )
    claim = claim_of(Term("coulomb", 1, {}), 0.5)
    found: Any = SimpleNamespace(
        joint=1, claims=(claim,), final=SimpleNamespace(fit="final"),
        alone=SimpleNamespace(fit="alone"),
    )  # fmt: skip
    given: Any = SimpleNamespace(
        joint_kind=lambda _: "rotary", torque_unit=lambda _: "N m",
        actuator=SimpleNamespace(command_unit="N m"),
    )  # fmt: skip
    assert decision._blurred(found, given) is blurred


def test_what_acts_in_the_first_half_second_of_ten_is_the_start_and_no_drift() -> None:
    facts: Any = SimpleNamespace(scale=SimpleNamespace(seconds=10.0))
    assert slow_limits(facts)[0] > 0.5


@pytest.mark.parametrize(
    ("effect", "share", "apart"),
    [
        ("ripple", 0.6, True), ("ripple", 0.47, False),
        ("dead_zone", 0.92, True), ("dead_zone", 0.6, False),  # the command follows what is borne
    ],
)  # fmt: skip
def test_a_doubted_mechanism_is_stated_only_where_its_variables_predict_most_of_what_lacks(
    effect: str, share: float, apart: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim = claim_of(Term(effect, 1, {}), 0.4)
    seen = {get_effect(effect).mechanism: Structure(0.3, share, 4.0)}
    monkeypatch.setattr(
        nameless, "structure", lambda *to, **_: seen.get(to[-1][0], Structure(0.0, 0.0, 0.0))
    )
    monkeypatch.setattr(nameless, "_hardly_varies", lambda *_: False)
    base: Any = SimpleNamespace(model=model())
    found = of_one_claim(claim, 0.33, 0.21, base)
    parts: Any = SimpleNamespace(each=())
    assert nameless.told_apart(claim, found, parts, model(), ()) is apart


@pytest.mark.parametrize("stands", [True, False])
def test_a_likelier_law_that_untouched_recordings_do_not_show_takes_no_place(
    stands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Axis 5: a hysteresis was likelier than Coulomb friction, which untouched recordings showed
    by 7.9 standard deviations; with the hysteresis nothing was claimed.
    """
    first, likelier = (
        of_one_claim(claim_of(Term(e, 1, {}), 0.3), 0.3, 0.1, SimpleNamespace(model=model()))
        for e in ("coulomb", "hysteresis")
    )
    searches: list[Any] = [
        SimpleNamespace(joint=1, base=first.base, steps=(), name=n) for n in ("a", "b")
    ]
    nothing = replace(first, kind=Verdict.UNEXPLAINED, claims=())
    for name, answer in {
        "worth_choosing": first.final, "discrepancy": first.before, "new_terms": ["some"],
        "grouped": {}, "with_reasons": [], "_makes_better": True, "beside": None,
        "nothing_named": nothing, "find_sounder": None, "_blurred": False,
    }.items():  # fmt: skip
        monkeypatch.setattr(decision, name, lambda *_, answer=answer: answer)
    monkeypatch.setattr(
        decision, "held_apart",
        lambda parts, given, search, *_: (["it"] if stands or search.name == "a" else [], []),
    )  # fmt: skip
    by_name = {"a": first, "b": likelier}
    monkeypatch.setattr(decision, "named", lambda parts, given, search, *_: by_name[search.name])
    monkeypatch.setattr(
        decision, "_exchanged",
        lambda parts, search, *_: searches[1] if search.name == "a" else None,
    )  # fmt: skip
    monkeypatch.setattr(decision, "believed", lambda found, *_: found)
    parts: Any = SimpleNamespace(each=[], test=None)
    found = decision._decided(parts, model(), searches[0], 1, lambda _: None)
    assert [c.effect for c in found.claims] == ["hysteresis" if stands else "coulomb"]


@pytest.mark.parametrize(("left", "words"), [(0.3, "30 % stays"), (18126.0, "more than all of it")])
def test_no_rejected_law_leaves_millions_of_per_cent(left: float, words: str) -> None:
    evidence = Evidence(100.0, 9.0, np.zeros(1))
    piece = Piece("dry_friction", (Term("coulomb", 1, {}),), None, 0.33, evidence, 9.0)  # type: ignore[arg-type]
    before, beside = (Size(x, 0.9 * x, 1.1 * x) for x in (0.31, left))
    base = SimpleNamespace(model=SimpleNamespace(kind="rotary"))
    search: Any = SimpleNamespace(joint=1, base=base)
    lost = nothing_named._lost("coulomb", search, 100.0, [piece], before, beside)
    assert words in lost.why and "33 % of the torque" in lost.why


@pytest.mark.parametrize(
    ("effect", "beside", "has", "z", "stays"),
    [
        ("coulomb", "coupling", False, -1.5, True),
        ("coulomb", "coupling", False, -2.5, False),
        ("coulomb", "coupling", True, -1.5, False),  # beside a dry friction of the given model
        ("coulomb", "hysteresis", False, -1.5, False),  # beside one that was found
        ("ripple", "coupling", False, -1.5, False),  # not every machine has one
    ],
)
def test_friction_that_every_machine_has_goes_only_where_it_surely_does_not_help(
    effect: str, beside: str, has: bool, z: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a real arm's axis the few seconds to choose by were likelier without it (-1.5), those to
    test on less likely (3.7).
    """
    terms = tuple(Term(name, 1, {}) for name in (effect, beside))
    final: Any = SimpleNamespace(model=SimpleNamespace(at=lambda _: terms))
    other: Any = SimpleNamespace(model=None)
    for name, does in {
        "new_terms": lambda _given, model, _joint: [] if model is None else list(terms),
        "taken_away": lambda *_: None,
        "informative": lambda *_: 1000,
        "hopeless": lambda *_: None,
        "has": lambda *_: has,
        "compare": lambda without, *_: SimpleNamespace(gain=-9.0, z=z)
        if without is other
        else SimpleNamespace(gain=9.0, z=3.0),
        "_without": lambda *of: other if of[3][0] is terms[0] else None,
    }.items():
        monkeypatch.setattr(pieces, name, does)
    search: Any = SimpleNamespace(joint=1, final=final)
    parts: Any = SimpleNamespace(choose=None)
    given: Any = None
    found: Any = pieces.worth_choosing(parts, given, search, 1)
    assert found is (final if stays else other)
