"""Terms that untouched recordings do not surely show: neither kept beside a claim, nor hiding what
a law leaves.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_claims import PARTS, claim_of, of_one_claim, piece

from zendsp.diagnosis.decide import believed, decide
from zendsp.diagnosis.decide.claims import Piece
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.physics.model import Quantity, Term


def split(
    monkeypatch: pytest.MonkeyPatch,
    proposed: dict[str, dict[str, float]],
    *leads: str,
    expected: tuple[str, ...] = (),
    back: str = "",
) -> tuple[str, list[str], list[str]]:
    """What stays of proposed models: of each, by the names of its effects, how sure untouched
    recordings are of each effect. ``leads`` are claimed where they are sure; of ``expected`` ones
    the given model has none. ``back`` comes back in place of what is taken away.
    """

    def made(model: str, effect: str) -> Piece:
        found = piece(0.05, proposed[model][effect], proposed[model][effect], effect)
        object.__setattr__(found, "expected", effect in expected)
        rest = "+".join([*(e for e in model.split("+") if e != effect), *([back] if back else [])])
        object.__setattr__(found, "without", SimpleNamespace(model=rest))
        return found

    def apart(*given: Any) -> tuple[list[Piece], list[Piece]]:
        each = given[-1]
        claimed = [p for p in each if p.effects[0] in leads and p.evidence.z > 3.0]
        return claimed, [p for p in each if p not in claimed]

    def terms(_given: Any, model: str, _joint: int) -> list[str]:
        return model.split("+")

    monkeypatch.setattr(decide, "new_terms", terms)
    monkeypatch.setattr(decide, "grouped", lambda _g, _m, new: {(e, 0): (e,) for e in new})
    monkeypatch.setattr(decide, "piece_of", lambda _t, _g, final, e, *_: made(final.model, e))
    monkeypatch.setattr(decide, "held_apart", apart)
    monkeypatch.setattr(decide, "sure", lambda _, p: p.evidence.z > 3.0)
    search: Any = SimpleNamespace(joint=1, base=None, steps=())
    whole: Any = SimpleNamespace(model=next(iter(proposed)))
    given: Any = None
    final, claimed, rest = decide._surely_shown(PARTS, given, search, whole, 1)
    model: Any = final.model
    return model, [p.effects[0] for p in claimed], [p.effects[0] for p in rest]


def test_a_refinement_that_untouched_recordings_do_not_surely_show_leaves_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside a viscosity that grows with the place a limit of the supply took 0.1 % of the torque.
    In a motion with larger torques it made the error half as large again.
    """
    proposed = {
        "position_friction+voltage_limit": {"position_friction": 4.1, "voltage_limit": 2.3},
        "position_friction": {"position_friction": 4.0},
    }
    assert split(monkeypatch, proposed, "position_friction") == (
        "position_friction", ["position_friction"], []
    )  # fmt: skip


def test_what_comes_back_in_place_of_an_unsure_term_is_not_taken_away_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A creep of the given model, which had another: no answer within 300 s (seed 1710)."""
    proposed = {"stiffening+load_friction": {"stiffening": 9.0, "load_friction": 1.0}}
    assert split(monkeypatch, proposed, "stiffening", back="creep") == (
        "stiffening+load_friction", ["stiffening"], ["load_friction"]
    )  # fmt: skip


def test_of_two_that_stand_in_for_one_another_one_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is unsure beside the other, and sure alone."""
    proposed = {
        "stiffness+delay+lag": {"stiffness": 9.0, "delay": 1.0, "lag": 0.5},
        "stiffness+delay": {"stiffness": 9.0, "delay": 8.0},
    }
    assert split(monkeypatch, proposed, "stiffness") == (
        "stiffness+delay", ["stiffness"], ["delay"]
    )  # fmt: skip


@pytest.mark.parametrize(("expected", "stays"), [(("coulomb",), True), ((), False)])
def test_a_refinement_stays_where_friction_that_every_machine_has_is_sure_only_beside_it(
    expected: tuple[str, ...], stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So an axis of a real arm had no dry friction, beside the spring of its balancer."""
    proposed = {
        "stiffness+coulomb+viscous_asymmetry": {
            "stiffness": 9.4, "coulomb": 9.0, "viscous_asymmetry": 1.0
        },
        "stiffness+coulomb": {"stiffness": 9.3, "coulomb": 0.0},
    }
    leads = ("stiffness", "coulomb")
    model, claimed, _ = split(monkeypatch, proposed, *leads, expected=expected)
    assert ("viscous_asymmetry" in model, "coulomb" in claimed) == (stays, stays)


@pytest.mark.parametrize(
    ("beside", "alone"),
    [("viscous", 9.0), ("ripple", 1.0)],  # friction of every machine; the claim is nothing alone
)
def test_what_every_machine_has_or_a_claim_needs_stays(
    beside: str, alone: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    proposed = {f"coulomb+{beside}": {"coulomb": 9.0, beside: 1.0}, "coulomb": {"coulomb": alone}}
    assert split(monkeypatch, proposed, "coulomb")[0] == f"coulomb+{beside}"


@pytest.mark.parametrize(
    ("law", "alone", "hid"),
    [
        ("quadratic_drag", 0.025, True),
        ("quadratic_drag", 0.015, False),  # less than a fifth of its size
        ("quadratic_drag", 0.0, False),
        ("stiffness", 0.015, True),  # of two numbers: a twentieth
        ("elasticity", 0.025, False),  # no function of the state
    ],
)
def test_what_a_law_leaves_is_not_hidden_by_terms_that_are_not_stated(
    law: str, alone: float, hid: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drag that differs along the travel had been a quadratic drag: frictions that were fitted
    beside it, and that untouched recordings did not show, took what it left.
    """
    numbers = {"stiffness": ("coefficient", "neutral"), "elasticity": ("stiffness",)}
    names = numbers.get(law, ("coefficient",))
    claim = claim_of(Term(law, 1, {name: Quantity(1.0) for name in names}), 0.1)
    left = {"alone": Structure(alone, 0.9, 9.0), "whole": Structure(0.0, 0.0, 0.0)}
    monkeypatch.setattr(believed, "structure", lambda _parts, model, *_: left[model])
    whole, bare = (SimpleNamespace(model=name) for name in ("whole", "alone"))
    decision: Any = of_one_claim(claim, 0.1, 0.0, whole)
    assert believed._hid(claim, bare, decision, PARTS) is hid  # type: ignore[arg-type]
    assert not believed._hid(claim, whole, decision, PARTS)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("law", "refinement", "z", "known", "stays"),
    [
        ("friction_drift", "friction_temperature", 9.0, False, False),
        ("friction_drift", "coulomb", 9.0, False, True),
        ("ripple", "hysteresis", 9.0, True, True),
        ("ripple", "hysteresis", 2.0, True, False),
        ("ripple", "hysteresis", 9.0, False, False),
        ("ripple", "stribeck", 9.0, True, False),
    ],
)
def test_a_law_stands_alone_without_refinements_but_those_that_turn_a_known_friction(
    law: str, refinement: str, z: float, known: bool, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drift of all friction (0.97) where only the viscous part fell: a Coulomb friction that rose
    with the temperature took up what it left. A ripple that left nothing was none (0.29) beside a
    hysteresis, which is how the model's own dry friction turns round.
    """
    terms = tuple(Term(name, 1, {}) for name in (law, refinement))
    one, more = (claim_of(term, 0.1, Evidence(100.0, z, np.zeros(1))) for term in terms)
    final: Any = SimpleNamespace(model=SimpleNamespace(terms=terms), data=None)
    gone: list[Term] = []
    own = [Term("coulomb", 1, {}), Term("viscous", 1, {})]
    monkeypatch.setattr(believed, "kept_laws", lambda *_: own if known else own[1:])
    monkeypatch.setattr(believed, "both_needed", lambda *_: False)
    monkeypatch.setattr(believed, "_hiding", lambda _final, _claims, more: {id(c) for c in more})
    monkeypatch.setattr(believed, "taken_away", lambda *of: gone.extend(of[3]))
    monkeypatch.setattr(believed, "joint_handles", lambda *_: ())
    monkeypatch.setattr(believed, "fit_scored", lambda *_, **__: "alone")
    given: Any = None
    alone = believed.by_themselves(given, final, 1, [one], [more], 1)
    assert (alone is final) is stays and gone == ([] if stays else [terms[1]])
