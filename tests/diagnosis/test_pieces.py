"""The worth of each mechanism of a proposed model on untouched recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from made_claims import PARTS, piece
from small_models import VISCOUS, data_of, model_of

from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import law_torque, patchwork, pieces
from zendsp.diagnosis.decide.claims import Claim, Decision, Known, Piece
from zendsp.diagnosis.decide.notes import left_over
from zendsp.diagnosis.measure.discrepancy import Size, difference
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Quantity, Term

SEARCH: Any = SimpleNamespace(joint=1)
FINAL: Any = SimpleNamespace(model=None)

Held = Callable[..., tuple[list[Piece], list[Piece]]]
NOTHING = Structure(0.0, 0.0, 0.0)


@pytest.fixture
def held_apart(monkeypatch: pytest.MonkeyPatch) -> Held:
    """The claimed and the refused pieces where all of them together leave ``left``."""

    def ask(
        *found: Piece,
        left: Size,
        structure: Structure = NOTHING,
        known: Known | None = None,
        search: Any = SEARCH,
        final: Any = FINAL,
        beside: Sequence[Term] = (),
        kind: str = "rotary",
    ) -> tuple[list[Piece], list[Piece]]:
        given: Any = SimpleNamespace(kind=kind)
        monkeypatch.setattr(pieces, "discrepancy", lambda *_: left)
        monkeypatch.setattr(pieces, "structure", lambda *_: structure)
        monkeypatch.setattr(pieces, "kept_laws", lambda *_: list(beside))
        monkeypatch.setattr(pieces, "known_discrepancy", lambda *_: known or Known())
        return pieces.held_apart(PARTS, given, search, final, list(found))

    return ask


@pytest.fixture
def moving(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing acts where the joint turns round."""
    monkeypatch.setattr(pieces, "_rubbing", lambda *_: [])


@pytest.mark.usefixtures("moving")
@pytest.mark.parametrize(("size", "claims"), [(0.021, True), (0.019, False)])
def test_what_is_not_twice_what_a_machine_is_known_to_leave_may_be_a_part_of_it(
    held_apart: Held, size: float, claims: bool
) -> None:
    one = piece(size, 5.0, 20.0)
    claimed, _ = held_apart(one, left=Size(0.0, 0.0, 0.0), known=Known(0.01, 0.01))
    assert claimed == ([one] if claims else [])


@pytest.mark.parametrize(("apart", "curve"), [(0.2, True), (5.0, False)])
def test_two_ripples_that_the_travel_cannot_separate_are_not_both_claimed(
    apart: float, curve: bool
) -> None:
    """Over 3 rad they differ by a fifth of a wave, or by more than two."""
    found = [
        replace(piece(0.1, 5.0, 20.0), terms=(Term("ripple", 1, {"order": Quantity(order)}),))
        for order in (12.0, 12.0 + apart)
    ]
    assert patchwork.is_curve(found, 3.0) is curve


@pytest.mark.parametrize(
    ("turning", "softer", "claims"), [(0.8, 20.0, False), (0.8, 5.0, True), (0.2, 20.0, True)]
)
def test_what_acts_at_reversals_must_exceed_the_error_of_the_dry_friction(
    monkeypatch: pytest.MonkeyPatch, held_apart: Held, turning: float, softer: float, claims: bool
) -> None:
    """A lag of 0.4 % beside dry friction of 20 %, whose law is good to 3 % of that. Bristles gain a
    part of what the lag gains.
    """
    monkeypatch.setattr(pieces, "at_reversals", lambda *_: turning)
    monkeypatch.setattr(law_torque, "difference", lambda *_: 0.2)
    friction = Term("coulomb", 1, {})
    model = SimpleNamespace(terms=(friction,), at=lambda _: (friction,), with_terms=lambda _: None)
    lag = piece(0.004, 5.0, 50.0, "lag")
    bristles = SimpleNamespace(effect="presliding", value=100.0 - softer)
    claimed, rest = held_apart(
        lag,
        left=Size(0.0025, 0.0, 0.01),
        search=SimpleNamespace(joint=1, base=SimpleNamespace(deviance=100.0), tried=[bristles]),
        final=SimpleNamespace(model=model, deviance=0.0),
    )
    assert (claimed, rest) == (([lag], []) if claims else ([], [lag]))


@pytest.mark.parametrize(
    ("effect", "size", "turning", "claims"),
    [
        ("hysteresis", 0.004, 0.8, False),
        ("hysteresis", 0.008, 0.8, True),
        ("hysteresis", 0.004, 0.2, True),
        ("stribeck", 0.004, 0.8, True),
    ],
)
def test_how_given_dry_friction_behaves_at_reversals_is_no_finding_within_its_error(
    monkeypatch: pytest.MonkeyPatch,
    held_apart: Held,
    effect: str,
    size: float,
    turning: float,
    claims: bool,
) -> None:
    """Hysteresis of 0.4 % beside a given dry friction of 20 %, whose law is good to 3 % of that.
    The softness of MuJoCo's friction had been called hysteresis. A Stribeck curve is no softness.
    """
    monkeypatch.setattr(pieces, "at_reversals", lambda *_: turning)
    monkeypatch.setattr(pieces, "_keeps_its_numbers", lambda *_: False)
    monkeypatch.setattr(pieces, "torque_of", lambda *_: 0.2)
    loop = piece(size, 5.0, 50.0, effect)
    claimed, _ = held_apart(loop, left=Size(0.0005, 0.0, 0.01), beside=[Term("coulomb", 1, {})])
    assert claimed == ([loop] if claims else [])


def test_a_friction_law_that_leaves_nothing_over_the_speed_is_not_the_error_of_another(
    monkeypatch: pytest.MonkeyPatch, held_apart: Held
) -> None:
    """A Stribeck curve of 0.4 % beside Coulomb friction of 20 %, whose law is good to 3 % of that,
    where 0.1 % of the torque stays that depends on nothing, or on the speed.
    """
    monkeypatch.setattr(pieces, "torque_of", lambda *_: 0.2)
    monkeypatch.setattr(pieces, "at_reversals", lambda *_: 0.0)
    curve = piece(0.004, 5.0, 50.0, "stribeck")
    for over_speed, claims in ((0.0, True), (0.001, False)):
        claimed, _ = held_apart(
            curve,
            left=Size(0.001, 0.0, 0.002),
            structure=Structure(over_speed, 0.5, 1.0),
            beside=[Term("coulomb", 1, {})],
        )
        assert claimed == ([curve] if claims else [])


def test_a_wave_faster_than_the_observer_has_its_whole_torque() -> None:
    """A ripple of 0.01 N m RMS, with 200 periods a turn and with two."""
    model = model_of(VISCOUS, rate=reality.FAST)
    motion = 1.5 * np.sin(2.0 * np.pi * np.arange(round(6.0 * reality.FAST)) / reality.FAST)
    run = reality.simulate(reality.Machine(coulomb=0.0), motion, reality.FAST)
    data = data_of(run, model, reality.FAST)
    seen, whole = [], []
    for order in (200.0, 2.0):
        wave = make_term(
            get_effect("ripple"), 1, {"order": order, "amplitude": 0.014142, "phase": 0.3}
        )
        whole.append(pieces._unseen(data, model, (wave,), 1))
        with_it = model.with_terms((*model.terms, wave))
        seen.append(difference(data, model, with_it, 1) * law_torque.rms_torque(data, 1))
    assert seen[0] < 0.004 and whole[0] * seen[0] == pytest.approx(0.01, rel=0.15)
    assert whole[1] == pytest.approx(1.0, abs=0.1)
    friction = make_term(get_effect("coulomb"), 1, {"level": 0.01})
    assert pieces._unseen(data, model, (friction,), 1) == 1.0


@pytest.mark.parametrize(
    ("effect", "lacked", "falls", "unseen", "lacks"),
    [
        ("ripple", 0.05, False, 0.0, False),
        ("ripple", 0.06, False, 0.2, True),
        ("ripple", 0.0, True, 0.0, True),
        ("elasticity", 0.0, True, 0.0, False),  # so looks a command that other rows would show
        ("elasticity", 0.06, True, 0.1, True),
        ("elasticity", 0.06, True, 0.12, False),
        ("column_shift", 0.06, True, 0.12, False),
    ],
)
def test_what_is_likelier_and_is_no_torque_that_lacked_is_not_claimed(
    effect: str,
    lacked: float,
    falls: bool,
    unseen: float,
    lacks: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of complete arms at 100 Hz, whose loops ran at 500 Hz behind coarse encoders, a spring, a
    filter and a shift of 1.3 to 10 % of the torque were named, all of 95 % and more; commands that
    nobody saw make up to 14 %.
    """
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.0, 0.0, lacked))
    monkeypatch.setattr(pieces, "unseen_commands", lambda *_: unseen)
    monkeypatch.setattr(pieces, "falls", lambda *_: falls)
    terms, none = [Term(effect, 1, {})], SimpleNamespace()
    assert pieces._lacks(PARTS.test, none, none, terms, 0.11) is lacks  # type: ignore[arg-type]
    one = replace(piece(0.11, 5.0, 20.0, effect), lacks=lacks)
    assert pieces.sure(PARTS.test, one) is lacks


@pytest.mark.usefixtures("moving")
@pytest.mark.parametrize(("losing", "claims"), [(4, True), (5, False)])
def test_what_gains_almost_everywhere_is_claimed_though_it_gains_most_in_few_places(
    held_apart: Held, losing: int, claims: bool
) -> None:
    """20 gaining blocks of 24 are 3.3 standard deviations, 19 are 2.9."""
    one = piece(0.1, 1.0, 20.0)
    gains = np.r_[np.ones(24 - losing), -np.ones(losing)]
    one = replace(one, evidence=replace(one.evidence, blocks=gains))
    claimed, _ = held_apart(one, left=Size(0.0, 0.0, 0.0))
    assert claimed == ([one] if claims else [])


@pytest.mark.usefixtures("moving")
def test_only_what_untouched_recordings_bear_out_by_chance_too_rarely_is_claimed(
    held_apart: Held,
) -> None:
    sure = piece(0.1, 5.0, 20.0)
    unlikely = piece(0.1, 5.0, 3.0)
    uneven = piece(0.1, 1.0, 20.0)
    small = piece(0.005, 5.0, 20.0)
    left, structure = Size(0.01, 0.0, 0.02), Structure(0.01, 0.5, 1.0)
    claimed, rest = held_apart(sure, unlikely, uneven, small, left=left, structure=structure)
    assert claimed == [sure] and rest == [unlikely, uneven, small]


def test_what_a_wrong_model_lacks_does_not_make_its_evidence_less(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the spring the innovations are correlated over 80 samples, because of the spring."""
    alike = {"without": 80.0, "final": 2.0}
    monkeypatch.setattr(pieces, "dependence", lambda scored, *_: alike[scored])
    models: list[Any] = ["without", "final", None]
    held = Evidence(400.0, 5.0, np.zeros(1))
    assert pieces.log_e_value(held, *models, 1) == 100.0
    alike["final"] = 90.0  # where something unknown acts in both
    assert pieces.log_e_value(held, *models, 1) == 2.5


@pytest.mark.usefixtures("moving")
@pytest.mark.parametrize(
    ("effect", "size", "claims"),
    [("elasticity", 0.002, False), ("elasticity", 0.003, True), ("ripple", 0.002, True)],
)
def test_the_effect_of_another_integration_step_is_not_called_a_spring(
    held_apart: Held, effect: str, size: float, claims: bool
) -> None:
    one = piece(size, 5.0, 20.0, effect)
    claimed, _ = held_apart(one, left=Size(0.0001, 0.0, 0.01))
    assert claimed == ([one] if claims else [])


@pytest.mark.usefixtures("moving")
@pytest.mark.parametrize(
    ("kind", "size", "claims"),
    [("rotary", 5e-4, True), ("rotary", 2e-4, False), ("urdf", 5e-4, False), ("urdf", 2e-3, True)],
)
def test_nothing_is_claimed_below_what_the_digits_of_a_files_masses_leave(
    held_apart: Held, kind: str, size: float, claims: bool
) -> None:
    """A complete arm, its file written to three digits, had a friction of 0.03 %."""
    one = piece(size, 5.0, 20.0)
    claimed, _ = held_apart(one, left=Size(0.0, 0.0, 0.0), kind=kind)
    assert claimed == ([one] if claims else [])


@pytest.fixture
def one_term(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Any], None]:
    """A search that proposes one effect with the score ``final``."""

    def propose(effect: str, final: Any) -> None:
        term = Term(effect, 1, {})
        group = {(mechanism_of(effect), 0): (term,)}
        monkeypatch.setattr(decision, "worth_choosing", lambda *_: final)
        monkeypatch.setattr(decision, "new_terms", lambda *_: [term])
        monkeypatch.setattr(decision, "grouped", lambda *_: group)

    return propose


def test_what_a_mechanism_is_worth_is_asked_of_the_recordings_to_test_on(
    monkeypatch: pytest.MonkeyPatch, one_term: Callable[[str, Any], None]
) -> None:
    asked: list[object] = []

    def ask(data: object, *_: object) -> Piece:
        asked.append(data)
        return piece(0.1, 0.0, 0.0)

    one_term("ripple", FINAL)
    monkeypatch.setattr(decision, "discrepancy", lambda *_: None)
    monkeypatch.setattr(decision, "piece_of", ask)
    monkeypatch.setattr(decision, "held_apart", lambda *_: ([], []))
    nothing: Any = SimpleNamespace(kind="complete")
    monkeypatch.setattr(decision, "nothing_named", lambda *_: nothing)
    search: Any = SimpleNamespace(joint=1, base=FINAL, steps=[])
    outcome: Any = decision._decided(PARTS, None, search, 1, lambda _: None)  # type: ignore[arg-type]
    assert outcome is nothing and asked == [PARTS.test]


@pytest.mark.parametrize(("after", "stands"), [(0.2, True), (0.6, False), (2.5e8, False)])
def test_a_law_that_leaves_more_unexplained_than_before_is_no_finding(
    monkeypatch: pytest.MonkeyPatch,
    one_term: Callable[[str, Any], None],
    after: float,
    stands: bool,
) -> None:
    """A spring that holds the joint at its recorded position follows every recording."""
    before = Size(0.5, 0.4, 0.6) if after < 1.0 else Size(3.6e9, 2e9, 5e9)
    left = Size(after, after, after)
    term, evidence = Term("stiffness", 1, {}), Evidence(50.0, 9.0, np.zeros(1))
    claim = Claim("stiffness", "position_torque", term, 9.0, evidence, 25.0, {}, (), (), ())
    model: Any = SimpleNamespace(at=lambda _: (), torque_unit=lambda _: "N m")
    one: Any = SimpleNamespace(model=model)
    found = Decision(1, "missing", (claim,), (), one, one, before, left, NOTHING, left, one, 7.0)
    one_term("stiffness", one)
    other: Any = SimpleNamespace(claims=(), kind="complete")
    for name, answer in {
        "discrepancy": before,
        "piece_of": piece(0.1, 9.0, 50.0, "stiffness"),
        "held_apart": ([piece(0.1, 9.0, 50.0, "stiffness")], []),
        "named": found,
        "believed": found,
        "window_error": np.zeros(3),
        "beside": None,
        "nothing_named": other,
    }.items():
        monkeypatch.setattr(decision, name, lambda *_, answer=answer: answer)
    search: Any = SimpleNamespace(joint=1, base=one, steps=[])
    outcome = decision._decided(PARTS, None, search, 1, lambda _: None)  # type: ignore[arg-type]
    assert outcome.claims is (found if stands else other).claims
    if after > 1.0:
        there = np.linspace(0.0, 1.0, 8000)
        for q, said in ((there, True), (np.sin(9.0 * there), False)):
            record = SimpleNamespace(others=q[None, None], n=len(q), sample_time=0.001)
            fit: Any = SimpleNamespace(records=[[record]])
            words = left_over([found], model, fit)
            assert "does not follow" in words and "%" not in words
            assert ("8 s, and go one way" in words) == said


@pytest.mark.parametrize(
    ("hopeless", "gain", "refitted"),
    [(True, 500.0, 0), (True, 5.0, 2), (False, 500.0, 2)],
)
def test_no_term_is_dropped_without_which_all_recordings_are_far_less_likely(
    hopeless: bool, gain: float, refitted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only terms that a short fit leaves in doubt get a long one."""
    terms = tuple(Term(name, 1, {}) for name in ("coulomb", "ripple"))
    final: Any = SimpleNamespace(model=SimpleNamespace(at=lambda _: terms))
    other: Any = SimpleNamespace()
    long: list[Term] = []
    for name, does in {
        "new_terms": lambda *_: list(terms),
        "taken_away": lambda *_: other,
        "informative": lambda *_: 1000,
        "hopeless": lambda *_: other if hopeless else None,
        "compare": lambda *_: SimpleNamespace(gain=gain),
        "_without": lambda *given: long.append(given[3][0]) or other,
    }.items():
        monkeypatch.setattr(pieces, name, does)
    search: Any = SimpleNamespace(joint=1, final=final)
    parts: Any = SimpleNamespace(choose=None)
    given: Any = None
    assert pieces.worth_choosing(parts, given, search, 1) is final
    assert len(long) == refitted


@pytest.mark.parametrize(
    ("has", "bandwidth", "within"), [
        (("elasticity",), 64.0, True), (("elasticity", "lag"), 64.0, False),
        (("elasticity",), 32.0, False), ((), 64.0, True),
    ],
)  # fmt: skip
def test_a_mechanism_is_not_worth_more_than_against_a_model_from_the_way(
    has: tuple[str, ...], bandwidth: float, within: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A coupling beside a spring was worth as much as both (log e 639, and 168 beside the spring as
    it was found): without the coupling the spring had run away from its own numbers.
    """
    monkeypatch.setattr(pieces, "new_terms", lambda _, model, __: model)

    def scored(deviance: float, *effects: str, bandwidth: float = 64.0) -> Any:
        data = SimpleNamespace(bandwidth=(bandwidth,))
        return SimpleNamespace(
            deviance=deviance, model=[Term(e, 1, {}) for e in effects], data=data
        )

    final, away = scored(-9.0, "elasticity", "coupling"), scored(0.0, "elasticity")
    base, way = scored(-1.0), scored(-5.0, *has, bandwidth=bandwidth)
    for name, does in {
        "_without": lambda *_: away, "difference": lambda *_: 0.1, "_unseen": lambda *_: 1.0,
        "compare": lambda *_: Evidence(9.0, 9.0, np.ones(4)), "log_e_value": lambda *_: 0.0,
        "_lacks": lambda *_: False,
    }.items():  # fmt: skip
        monkeypatch.setattr(pieces, name, does)
    test: Any = SimpleNamespace(joints=2)
    terms, given = (Term("coupling", 1, {}),), model_of(VISCOUS)
    found = pieces.piece_of(test, given, final, "inertia", terms, (base, way), 1)
    assert found.without is (way if within else base)


def test_a_piece_is_not_worth_more_than_all_that_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Viscous friction of 380 N m s/rad and another joint's of -360: of two joints that moved alike
    each was "missing" at 95 %, since without one the other ran away.
    """
    base, final = (SimpleNamespace(deviance=d, model=d) for d in (0.0, -9.0))
    away = SimpleNamespace(deviance=-5.0, model=-5.0)
    sizes = {away.model: 14.0, base.model: 0.6}
    monkeypatch.setattr(pieces, "_without", lambda *_: away)
    monkeypatch.setattr(pieces, "difference", lambda _, without, *__: sizes[without])
    monkeypatch.setattr(pieces, "compare", lambda *_: Evidence(9.0, 9.0, np.ones(4)))
    monkeypatch.setattr(pieces, "log_e_value", lambda *_: 0.0)
    monkeypatch.setattr(pieces, "_lacks", lambda *_: True)
    new: list[Term] = []
    monkeypatch.setattr(pieces, "new_terms", lambda *_: new)
    monkeypatch.setattr(pieces, "_contains", lambda *_: True)
    test: Any = SimpleNamespace(joints=1)
    terms = (Term("viscous", 1, {"coefficient": Quantity(380.0)}),)

    def asked() -> Piece:
        given: Any = SimpleNamespace(at=lambda _: ())
        return pieces.piece_of(test, given, final, "fluid_friction", terms, (base,), 1)  # type: ignore[arg-type]

    assert (asked().without, asked().size) == (base, 0.6)
    new.append(Term("quadratic_drag", 1, {"coefficient": Quantity(1.0)}))
    assert (asked().without, asked().size) == (away, 14.0), "a law that another one needs"
    new.clear()
    sizes[away.model] = 0.5
    assert (asked().without, asked().size) == (away, 0.5)
