"""Joints that lack the same torque or delay at once get one common explanation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

from zendsp.diagnosis.decide import across
from zendsp.diagnosis.decide.claims import Claim, Decision, Near
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.search.hypothesis import Rival
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Term


def lacking(joint: int, name: str, **values: float) -> Decision:
    term = make_term(get_effect(name), joint, values)
    evidence = Evidence(100.0, 5.0, np.zeros(1))
    claim = Claim(name, mechanism_of(name), term, 0.1, evidence, 50.0, {name: 1.0}, (), (), ())
    size = Size(0.001, 0.0, 0.002)
    model = fitted(term)
    state = Structure(0.0, 0.0, 0.0)
    return Decision(
        joint, "missing", (claim,), (), model, model, size, size, state, size, model, 1.0
    )  # type: ignore[arg-type]


def fitted(term: object, deviance: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(model=SimpleNamespace(at=lambda _: (term,)), deviance=deviance)


def named(decisions: list[Decision]) -> list[list[tuple[str, str, tuple[str, ...]]]]:
    return [[(c.effect, c.mechanism, c.same) for c in d.claims] for d in decisions]


def test_torques_over_the_position_at_two_joints_are_not_named_as_a_law_of_each() -> None:
    pulled = [lacking(1, "stiffness", coefficient=2.0), lacking(2, "stiffness", coefficient=1.0)]
    assert named(across.across_joints(pulled)) == [[("unknown", "position_torque", ())]] * 2
    other = [pulled[0], lacking(2, "coulomb", level=1.0)]
    assert across.across_joints(other) == other


@pytest.mark.parametrize(("size", "law"), [(0.6, "unknown"), (0.4, "stiffness")])
def test_no_law_over_position_is_named_beside_a_joint_that_lacks_as_much_without_a_law(
    size: float, law: str
) -> None:
    pulled = lacking(1, "stiffness", coefficient=2.0)
    pulled = replace(pulled, claims=(replace(pulled.claims[0], size=1.0),))
    nobody = replace(lacking(2, "coulomb", level=1.0), kind="unexplained", claims=())
    nobody = replace(nobody, state=Structure(size, 0.9, 5.0))
    found = across.across_joints([pulled, nobody])
    assert named(found)[0] == [(law, "position_torque", ())]


def test_no_law_over_position_is_named_where_another_joint_lacks_a_similar_one() -> None:
    """A hose over six joints had been called gravity at one of them; the others had no law."""
    pulled = lacking(1, "gravity", torque=2.0, angle=0.0)
    other = replace(lacking(2, "coulomb", level=1.0), kind="unexplained", claims=())
    other = replace(other, state=Structure(0.01, 0.9, 5.0))
    for like, law in (("stiffness", "unknown"), ("ripple", "gravity"), ("stribeck", "gravity")):
        near = replace(other, near=Near(like, 0.2, 0.1, ""))
        assert named(across.across_joints([pulled, near]))[0][0][0] == law
    assert named(across.across_joints([replace(pulled, claims=()), near])) == [[], []]


@pytest.mark.parametrize(
    ("kind", "size", "stays"),
    [("unexplained", 0.3, False), ("unexplained", 0.01, True), ("missing", 0.3, True)],
)
def test_beside_a_joint_where_as_much_depends_on_the_state_nothing_is_a_push(
    kind: Literal["unexplained", "missing"], size: float, stays: bool
) -> None:
    large = Size(0.3, 0.2, 0.4)
    other = replace(lacking(1, "coulomb", level=1.0), kind=kind, state=Structure(size, 0.9, 5.0))
    pushed = replace(lacking(2, "coulomb", level=1.0), kind="disturbance", before=large)
    assert [d.kind for d in across.pushed_alone([other, pushed])] == [
        kind,
        "disturbance" if stays else "unexplained",
    ]


@pytest.mark.parametrize(("of_filter", "law"), [(10.0, "position_filter"), (30.0, "lag")])
def test_joints_with_equal_delays_get_one_law(
    of_filter: float, law: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = [
        lacking(1, "lag", time_constant=0.0040),
        lacking(2, "position_filter", time_constant=0.0035),
        lacking(3, "coulomb", level=1.0),
    ]

    def in_place(decision: Decision, _: Claim, name: str, __: int) -> SimpleNamespace:
        term = make_term(get_effect(name), decision.joint, {"time_constant": 0.0038})
        return fitted(term, of_filter if name == "position_filter" else 20.0)

    monkeypatch.setattr(across, "_in_place", in_place)
    monkeypatch.setattr(across, "window_error", lambda *_: np.ones(3))
    parts = SimpleNamespace(test=None)
    (other,) = {"lag", "position_filter"} - {law}
    one = [(law, mechanism_of(law), (other,))]
    found = across.same_timing(parts, late, 1)  # type: ignore[arg-type]
    assert named(found) == [one, one, [("coulomb", "dry_friction", ())]]


@pytest.mark.parametrize(("law", "parameter", "other"), [
    ("lag", "time_constant", "position_filter"), ("delay", "time", "column_shift"),
])
def test_where_all_joints_are_equally_late_a_late_command_and_a_late_position_are_indistinguishable(
    law: str, parameter: str, other: str
) -> None:
    late = [lacking(1, law, **{parameter: 0.0040}), lacking(2, law, **{parameter: 0.0038})]
    found = across.same_timing(SimpleNamespace(), late, 1)  # type: ignore[arg-type]
    assert named(found) == [[(law, mechanism_of(law), (other,))]] * 2
    assert across.same_timing(SimpleNamespace(), late[:1], 1) == late[:1]  # type: ignore[arg-type]


def test_a_joint_as_late_as_the_others_gets_the_law_of_the_others() -> None:
    late = [lacking(joint, "delay", time=0.0072) for joint in (1, 2, 3, 4)]
    for k, time in ((2, 0.008), (3, 0.020)):
        (claim,) = lacking(k + 1, "delay", time=time).claims
        late[k] = replace(late[k], claims=(replace(claim, effect="unknown"),))
        late[k] = replace(late[k], final=fitted(claim.term))  # type: ignore[arg-type]
    found = across.same_timing(SimpleNamespace(), late, 1)  # type: ignore[arg-type]
    assert [d.claims[0].effect for d in found] == ["delay", "delay", "delay", "unknown"]


@pytest.mark.parametrize(
    ("times", "shown", "claimed"),
    [
        ((0.0041, 0.0046, 0.0039), (3.0, 4.0, 6.0), 3),
        ((0.0041, 0.0046, 0.0009), (3.0, 4.0, 6.0), 0),  # not by as much
        ((0.0011, 0.0012, 0.0010), (3.0, 4.0, 6.0), 0),  # by half a row: simulators differ so
        ((0.0041, 0.0046, 0.0039), (0.5, 0.2, 0.9), 0),  # untouched recordings do not say so
        ((0.0041, 0.0046), (30.0, 40.0), 0),  # two joints are not many
    ],
)
def test_delays_too_small_to_be_sure_at_each_joint_are_sure_over_all_joints(
    times: tuple[float, ...],
    shown: tuple[float, ...],
    claimed: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All six commands of an arm were one row late, which cost each joint 0.2 % of the torque."""
    searches, decisions = [], []
    for joint, time in enumerate(times, 1):
        term = make_term(get_effect("delay"), joint, {"time": time})
        scored: Any = fitted(term, -100.0)
        rival = Rival("delay", joint, scored, 10.0, (term,), ())
        base = SimpleNamespace(deviance=0.0)
        searches.append(SimpleNamespace(joint=joint, tried=[rival], base=base))
        decisions.append(replace(lacking(joint, "delay", time=time), kind="complete", claims=()))
    record = SimpleNamespace(sample_time=0.002, between=0.0)
    parts = SimpleNamespace(fit=SimpleNamespace(records=[[record] * 3]), test=None)

    def of_many(*asked: Any) -> Claim:
        joint = asked[3].joint
        claim = lacking(joint, "delay", time=times[joint - 1]).claims[0]
        return replace(claim, log_e=shown[joint - 1])

    monkeypatch.setattr(across, "_of_many", of_many)
    monkeypatch.setattr(across, "discrepancy", lambda *_: Size(0.0, 0.0, 0.0))
    found = across.all_late(parts, None, searches, decisions, 1)  # type: ignore[arg-type]
    assert sum(len(d.claims) for d in found) == claimed
    assert all(c.effect == "delay" and "column_shift" in c.same for d in found for c in d.claims)


def test_joints_with_different_delays_keep_their_own_laws() -> None:
    late = [
        lacking(1, "lag", time_constant=0.010),
        lacking(2, "position_filter", time_constant=0.0035),
    ]
    assert across.same_timing(SimpleNamespace(), late, 1) == late  # type: ignore[arg-type]


def test_a_body_is_looked_for_beside_missing_joint_friction() -> None:
    """A forearm 10 % heavier was a torque gain of two joints, beside friction that falls with the
    speed at five.
    """
    nameless = lacking(3, "stribeck", level=1.0)
    bare = replace(nameless.claims[0], effect="unknown", term=Term("unknown", 3, {}))
    decisions = [
        lacking(1, "coulomb", level=1.0),
        lacking(2, "torque_gain", ratio=0.03),
        replace(nameless, claims=(bare,)),
    ]
    assert [(t.effect, t.joint) for t in across.friction_beside(decisions)] == [("coulomb", 1)]


def test_delays_are_not_compared_across_joints_beside_a_mechanism_without_a_law() -> None:
    nameless = lacking(1, "coulomb", level=1.0)
    claim = nameless.claims[0]
    bare = replace(claim, effect="unknown", term=Term("unknown", 1, {}))
    decisions = [replace(nameless, claims=(bare,))]
    search: Any = SimpleNamespace(joint=1, tried=[], base=None)
    record = SimpleNamespace(sample_time=0.002, between=0.0)
    parts: Any = SimpleNamespace(fit=SimpleNamespace(records=[[record]]))
    given: Any = None
    assert across.all_late(parts, given, [search], decisions, 1) == decisions
