"""Which joint's link, that no sensor sees, explains what another joint lacks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.explain import linked

GIVEN: Any = SimpleNamespace(terms=())  # in which every sensor shows its link


class _Parts(SimpleNamespace):
    """Recordings in which some joints' links are felt."""


def _decision(joint: int, claims: int, given_up: Any = None) -> Any:
    claim = SimpleNamespace(mechanism="transmission")
    final = SimpleNamespace(model=SimpleNamespace(at=lambda _: ()))
    kind = Verdict.MISSING if claims else Verdict.UNEXPLAINED
    return SimpleNamespace(
        joint=joint, claims=(claim,) * claims, final=final, given_up=given_up, kind=kind
    )


def _explained(*decisions: Any) -> Any:
    improved = SimpleNamespace(terms=(), with_terms=lambda _: improved)
    return [None] * len(decisions), list(decisions), SimpleNamespace(improved=improved)


@pytest.fixture
def felt(monkeypatch: pytest.MonkeyPatch) -> dict[frozenset[int], tuple[Any, float]]:
    """For the joints whose links are felt: the explanation, and its error. Filled by a test."""
    answers: dict[frozenset[int], tuple[Any, float]] = {}
    both = frozenset({1, 2})
    monkeypatch.setattr(linked, "divided", lambda model: frozenset() if model is GIVEN else both)
    monkeypatch.setattr(
        linked, "with_links", lambda _, __, felt, **___: _Parts(fit=None, choose=felt, felt=felt)
    )
    monkeypatch.setattr(linked, "is_chain", lambda *_: False)
    monkeypatch.setattr(linked, "springs_of", lambda _: both)
    monkeypatch.setattr(linked, "with_bodies", lambda parts, _: parts)
    monkeypatch.setattr(linked, "explain", lambda parts, *_: answers[parts.felt][0])

    def cost(felt: frozenset[int], decisions: list[Any]) -> tuple[int, float]:
        return sum(len(d.claims) for d in decisions), answers[felt][1]

    monkeypatch.setattr(linked, "_cost", cost)
    return answers


def _ask(first: Any) -> tuple[Any, Any]:
    parts: Any = _Parts(fit=None, choose=frozenset(), felt=frozenset())
    return linked.with_their_links(parts, parts, GIVEN, GIVEN, (first, None), 1, lambda _: None)


def test_a_link_that_explains_worse_does_not_hide_one_that_explains_better(felt: Any) -> None:
    """The spring of joint 1 was two findings at joint 1 and a spring at joint 2, 0.86: joint 2's
    link left one finding and a larger error, and nothing else was looked at.
    """
    first = _explained(_decision(1, 2), _decision(2, 1))
    right = _explained(_decision(1, 2), _decision(2, 0))
    felt[frozenset()] = first, -20.2
    felt[frozenset({2})] = _explained(_decision(1, 0), _decision(2, 1)), -20.1
    felt[frozenset({1})] = right, -20.8
    felt[frozenset({1, 2})] = right, -20.8
    parts, (_, decisions, _) = _ask(first)
    assert parts.felt == frozenset({1}) and [len(d.claims) for d in decisions] == [2, 0]


@pytest.mark.parametrize("better", [True, False])
def test_a_link_is_felt_though_the_machine_was_worse_with_its_joint(
    better: bool, felt: Any
) -> None:
    """A gap of 22 mrad at joint 1 was given up, since joint 2, which felt the motor of joint 1,
    claimed a gap and an inertia of its own.
    """
    first = _explained(
        _decision(1, 0, _decision(1, 1)), _decision(2, 0, _decision(2, 2))
    )
    felt[frozenset()] = first, -11.7
    felt[frozenset({1})] = _explained(_decision(1, 1), _decision(2, 0)), -13.9 if better else -11.0
    felt[frozenset({2})] = _explained(_decision(1, 0), _decision(2, 2)), -11.0
    felt[frozenset({1, 2})] = felt[frozenset({1})]
    _, (_, decisions, _) = _ask(first)
    assert [len(d.claims) for d in decisions] == ([1, 0] if better else [0, 0])


def test_springs_that_all_encoders_need_are_explained_together(
    felt: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Springs of joints 2 and 3 of an arm: with the link of either one felt, one spring explains
    both with one claim less, and fifty times the error.
    """
    first = _explained(_decision(1, 1), _decision(2, 1))
    felt[frozenset()] = first, -34.0
    felt[frozenset({1})] = _explained(_decision(1, 1), _decision(2, 0)), -35.7
    felt[frozenset({2})] = _explained(_decision(1, 0), _decision(2, 1)), -35.8
    felt[frozenset({1, 2})] = first, -43.8
    parts, _ = _ask(first)
    assert len(parts.felt) == 1, "without encoders of all, one joint after the other"
    monkeypatch.setattr(linked, "is_chain", lambda *_: True)
    monkeypatch.setattr(linked, "needed_springs", lambda _, model, __: model)
    monkeypatch.setattr(linked, "_springs_after", lambda *_: None)
    monkeypatch.setattr(linked.Felt, "lacking", frozenset())
    parts, (_, decisions, _) = _ask(first)
    assert parts.felt == frozenset({1, 2}) and [len(d.claims) for d in decisions] == [1, 1]


@pytest.mark.parametrize("pays", [True, False])
def test_the_spring_that_all_encoders_need_is_explained_before_one_that_it_made_up(
    pays: bool, felt: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six joints whose third hangs on a spring: that of the second, which was none, took 107 of
    204 s.
    """
    first = _explained(_decision(1, 1), _decision(2, 1))
    asked = []

    def explain(parts: Any, *_: Any) -> Any:
        asked.append(set(parts.felt))
        return felt[parts.felt][0]

    felt[frozenset({1})] = _explained(_decision(1, 1), _decision(2, 0)), -35.7 if pays else -33.0
    felt[frozenset({2})] = _explained(_decision(1, 0), _decision(2, 1)), -35.8
    felt[frozenset()] = first, -34.0
    monkeypatch.setattr(linked, "explain", explain)
    monkeypatch.setattr(linked, "is_chain", lambda *_: True)
    monkeypatch.setattr(linked, "springs_of", lambda _: frozenset({1}))
    monkeypatch.setattr(linked, "needed_springs", lambda _, model, __: model)
    monkeypatch.setattr(linked, "_springs_after", lambda *_: None)
    monkeypatch.setattr(linked.Felt, "lacking", frozenset())
    parts, _ = _ask(first)
    assert parts.felt == frozenset({1} if pays else {2})
    assert asked == ([{1}] if pays else [{1}, {2}])


@pytest.mark.parametrize("gap", [True, False])
def test_of_several_springs_none_turns_into_a_gap_upon_links_that_move_as_springs_say(
    gap: bool, felt: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Springs of two joints were right after the first turn; after the second one was a gap, and
    all 47 s were for nothing.
    """
    both, model = frozenset({1, 2}), SimpleNamespace(called=None)
    first, second = (_explained(_decision(1, 1), _decision(2, 1)) for _ in range(2))
    left = [first, second, second, second]
    felt[both] = first, -40.0
    monkeypatch.setattr(linked, "explain", lambda *_: left.pop(0))
    monkeypatch.setattr(
        linked, "is_chain", lambda _, model, __: not (gap and model is second[2].improved)
    )
    monkeypatch.setattr(linked, "_springs_after", lambda *_: model)
    monkeypatch.setattr(linked, "_moved", lambda *_: len(left) > 2)
    parts: Any = _Parts(fit=None, choose=frozenset(), felt=frozenset())
    machine = linked._Machine(parts, GIVEN, GIVEN, 1, lambda _: None)
    anything: Any = model
    assert linked._in_turns(machine, anything, both).explained is (first if gap else second)


@pytest.mark.parametrize("rubs", [True, False])
def test_missing_dry_friction_is_no_spring_of_all_encoders(
    rubs: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real arm without the friction of its model had a spring of 1100 N m/rad at joint 6."""
    asked = []
    monkeypatch.setattr(linked, "divided", lambda _: frozenset())
    monkeypatch.setattr(linked, "may_be_chain", lambda *_: True)
    monkeypatch.setattr(linked, "has", lambda _, mechanism, joint: rubs or joint != 2)
    monkeypatch.setattr(linked, "first_springs", lambda *_: asked.append("springs"))
    arm: Any = SimpleNamespace(joints=2)
    parts: Any = _Parts(fit=None, choose=None)
    assert linked.by_all_encoders(parts, parts, arm, arm, 1, lambda _: None) is None
    assert asked == (["springs"] if rubs else [])
