"""Bodies beside what explains as much: a fault of a joint, calibration, a constant torque."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_claims import claim_of

from zendsp.diagnosis.decide import beside_bodies as beside
from zendsp.diagnosis.decide import decide_bodies, naming
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide_bodies import BodyClaim
from zendsp.diagnosis.decide.moved import bodies_wrong
from zendsp.diagnosis.explain import machine
from zendsp.diagnosis.search import bodies
from zendsp.diagnosis.search.bodies import FoundBody
from zendsp.diagnosis.search.body_explain import Explained
from zendsp.diagnosis.search.body_hypotheses import LIMITS, Hypothesis
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.robots.bodies import Links
from zendsp.tree import Body

GIVEN = Model("arm", 0.01, "urdf", {})


def explained(joint: int, *free: str, cost: float, behind: float) -> Explained:
    numbers = np.ones(len(free))
    h = Hypothesis("body", joint, f"link{joint}", free, cost)
    return Explained(h, numbers, numbers, 100.0, 5.0, behind, np.ones(3), np.ones(3))


def test_a_third_less_gain_at_all_actuators_at_once_is_implausible() -> None:
    """A payload of a planar arm, three fifths of its link's inertia, had become a gain of both
    joints.
    """
    solver: Any = SimpleNamespace(
        layout=SimpleNamespace(links=SimpleNamespace(bodies=())), limits=LIMITS
    )
    ratio = np.array([-0.35])
    assert not Solver.plausible(solver, Hypothesis("torque_gain", free=("ratio",)), ratio)
    assert Solver.plausible(solver, Hypothesis("torque_gain", 2, free=("ratio",)), ratio)
    assert Solver.plausible(solver, Hypothesis("torque_gain", free=("ratio",)), 0.5 * ratio)


@pytest.mark.parametrize(("p2", "wrong"), [(0.17, 0), (0.26, 1)])
def test_numbers_of_a_planar_arm_far_from_the_given_ones_are_a_finding_and_not_calibration(
    p2: float, wrong: int
) -> None:
    given = planar(0.15)
    assert bodies_wrong(given, planar(p2)) == wrong
    rough = replace(given.mechanism["p2"][0], std=0.05)
    loose = replace(given, mechanism={**given.mechanism, "p2": (rough,)})
    assert bodies_wrong(loose, planar(p2)) == 0


def planar(p2: float) -> Model:
    """An arm in the plane of which one number is free."""
    numbers = {"p1": 2.2, "p2": {"value": p2}, "p3": 0.2, "l1": 0.36, "l2": 0.34}
    held = {
        k: v if isinstance(v, dict) else {"value": v, "free": False} for k, v in numbers.items()
    }
    return parse_model(
        {"sample_time": 0.001, "mechanism": {"kind": "planar2r", "parameters": held}, "effect": []}
    )


@pytest.mark.parametrize(
    ("effect", "same"),
    [("torque_offset", ()), ("torque_gain", ()), ("dead_zone", ("torque_offset", "torque_gain"))],
)
@pytest.mark.parametrize(("com_std", "stands"), [(0.004, False), (0.0004, True)])
def test_a_constant_or_a_gain_within_the_uncertainty_of_a_bodys_centre_belongs_to_the_body(
    com_std: float, stands: bool, effect: str, same: tuple[str, ...]
) -> None:
    """With 8 kg, 4 mm make 0.3 N m, whatever the uncertainty of the mass. Beside a link's centre
    known to 15 mm an arm's drive had given 0.7 % less torque, with a confidence of 92 %; beside an
    exact tool, a dead zone of 0.04 % of the torque, with 71 %.
    """
    arm = SimpleNamespace(inertia=np.zeros(5), bias=np.zeros(5))

    def change(terms: list[Term], _joint: int) -> Any:
        weight = 80.0 * terms[0].value("com_x")  # N m a metre
        return SimpleNamespace(inertia=arm.inertia, bias=arm.bias + weight)

    record: Any = SimpleNamespace(
        n=5, links=SimpleNamespace(change=change), others=np.zeros((1, 3, 5)),
        scale=SimpleNamespace(torque=40.0),
    )  # fmt: skip
    test: Any = SimpleNamespace(records=[[record]])
    term = Term("body", 1, {"com_x": Quantity(0.02, free=False, std=com_std)})
    nothing: Any = None
    claim = Claim(effect, "actuator", Term(effect, 1, {}), 0.02, nothing, 0.0, {}, same, (), ())
    decision = Decision(1, "missing", (claim,), (), *[nothing] * 8)
    found = SimpleNamespace(term=term, indistinguishable=())
    body: Any = SimpleNamespace(sizes={1: 0.03}, found=found)
    (after,) = beside.beside_bodies([body], [decision], test)
    assert (after.claims == (claim,)) is stands
    nameless = replace(claim, effect="unknown", term=Term("torque_offset", 1, {}))
    law = replace(nameless, effect="torque_offset")
    (after,) = beside.beside_bodies([body], [replace(decision, claims=(nameless,))], test)
    assert after.refinements == (() if stands else (law,)), "a refinement is a law"


@pytest.mark.parametrize(
    ("effect", "lacks", "doubt"),
    [("gravity", 0.008, False), ("gravity", 0.08, True), ("delay", 0.008, True)],
)
def test_what_only_the_fit_shows_and_a_body_may_be_wrong_by_is_no_doubt(
    effect: str, lacks: float, doubt: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside 1.5 kg that are known to 7 %, 0.8 % of a joint's torque was a gravity that only the
    recordings of the fit showed, and no more than the weight may be wrong by.
    """
    monkeypatch.setattr(beside, "_wrong_by", lambda *_: 0.02)
    monkeypatch.setattr(beside, "discrepancy", lambda *_: SimpleNamespace(value=lacks))
    nothing: Any = None
    decision = Decision(4, "unexplained", (), (), SimpleNamespace(model=None), *[nothing] * 7)
    decision = replace(decision, doubted=((effect, 4),))
    body: Any = SimpleNamespace(found=SimpleNamespace(term=None))
    parts: Any = SimpleNamespace(fit=None, test=None)
    (after,) = beside.undoubted([body], [decision], parts)
    assert (after.kind, bool(after.doubted)) == ("unexplained" if doubt else "complete", doubt)
    assert beside.undoubted([], [decision], parts) == [decision]


@pytest.mark.parametrize(("order", "stands"), [(8.0, True), (1.0, False)])
def test_a_wave_that_no_body_can_draw_stands_beside_an_uncertain_body(
    order: float, stands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most of a payload's uncertainty came from the drives' gains. A ripple of eight waves a turn,
    smaller than that, became a refinement, although weight has one wave a turn.
    """
    t = np.arange(2000) * 0.002
    q = np.stack([np.sin(2.0 * t), np.sin(3.1 * t)])
    motion = np.stack([q, np.gradient(q, 0.002, axis=1), -q * [[4.0], [9.61]]], axis=1)
    at = np.array([0.0, 0.0, 0.4])
    bodies = [Body(k - 1, False, np.eye(3)[1], np.eye(3), at, 1.0, at, np.eye(3)) for k in (0, 1)]
    links = Links(tuple(bodies), np.array([0.0, 0.0, -9.81]), motion)
    others = SimpleNamespace(torque=1.0)
    record: Any = SimpleNamespace(n=t.size, links=links, others=motion, scale=others)
    test: Any = SimpleNamespace(records=[[record, record]])
    monkeypatch.setattr(beside, "trace", lambda *_: np.cos(order * q[0] + 0.3))
    claim = claim_of(Term("ripple", 1, {"order": Quantity(order)}), 0.02)
    nothing: Any = None
    decision = Decision(1, "missing", (claim,), (), *[nothing] * 8)
    decision = replace(decision, final=SimpleNamespace(model=GIVEN))
    found = SimpleNamespace(term=SimpleNamespace(parameters={}), indistinguishable=())
    body: Any = SimpleNamespace(sizes={1: 0.9}, found=found)
    (after,) = beside.beside_bodies([body], [decision], test)
    assert (after.claims == (claim,)) is stands


@pytest.mark.parametrize("same", ["calibration", "torque_gain"])
def test_an_inertia_beside_a_body_that_calibration_can_absorb_is_not_a_finding(same: str) -> None:
    term, law = SimpleNamespace(parameters={}), SimpleNamespace(effect="inertia")
    found = SimpleNamespace(term=term, indistinguishable=(same,))
    body: Any = SimpleNamespace(sizes={1: 0.3}, found=found)
    record: Any = SimpleNamespace(n=1, scale=SimpleNamespace(torque=1.0))
    test: Any = SimpleNamespace(records=[[record]])
    claim: Any = SimpleNamespace(
        effect="inertia", mechanism="inertia", size=0.2, term=law, is_rigid_coupling=False
    )
    nothing: Any = None
    decision = Decision(1, "missing", (claim,), (), *[nothing] * 8)
    (after,) = beside.beside_bodies([body], [decision], test)
    assert (after.refinements == (claim,)) is (same == "calibration")


@pytest.mark.parametrize(
    ("law", "size", "stands"), [(0.0, 0.02, False), (0.0, 0.2, True), (2.0, 0.02, True)]
)
def test_a_small_coupling_that_bodies_have_too_corrects_the_body(
    law: float, size: float, stands: bool
) -> None:
    """Beside 0.5 kg at a double pendulum, whose own inertia came out too small, a coupling by the
    other joint's acceleration stood with 73 %.
    """
    found = SimpleNamespace(term=SimpleNamespace(parameters={}), indistinguishable=())
    body: Any = SimpleNamespace(sizes={1: 0.3}, found=found)
    record: Any = SimpleNamespace(n=1, scale=SimpleNamespace(torque=1.0))
    test: Any = SimpleNamespace(records=[[record]])
    claim = claim_of(Term("coupling", 1, {"law": Quantity(law)}), size)
    nothing: Any = None
    decision = Decision(1, "missing", (claim,), (), *[nothing] * 8)
    (after,) = beside.beside_bodies([body], [decision], test)
    assert (after.claims == (claim,)) is stands
    assert after.refinements == (() if stands else (claim,))


@pytest.mark.parametrize(("behind", "remembered"), [(0.4, True), (4.0, False)])
def test_a_body_that_explains_as_much_as_a_joints_own_fault_is_remembered(
    behind: float, remembered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Link 2 of an arm, 3.6 kg heavier, loads joint 2 alone, so a gain explains as much. The joint
    had been set aside, and ended with a torque over the position without a law.
    """
    gain = replace(
        explained(2, "ratio", cost=1.0, behind=0.0),
        hypothesis=Hypothesis("torque_gain", 2, "", ("ratio",), 1.0),
    )
    body = replace(explained(2, "mass", cost=2.0, behind=behind), gain=100.0 - 10.0 * behind)
    nothing = replace(gain, gain=0.0, z=0.0)
    rounds = iter([[gain, body], [nothing]])
    monkeypatch.setattr(bodies, "hypotheses", lambda *_: [])
    monkeypatch.setattr(bodies, "Solver", lambda *_, **__: None)
    monkeypatch.setattr(bodies, "explain", lambda *_: next(rounds))
    layout: Any = SimpleNamespace(model=None, links=None)
    _, aside, (turn,) = bodies._round(None, None, layout, LIMITS)  # type: ignore[arg-type]
    assert aside == {2} and (turn.joint, turn.before) == (2, frozenset())
    assert (turn.body(LIMITS) is body) is remembered


@pytest.mark.parametrize(("place", "remembered"), [(1e-4, False), (0.2, True)])
def test_a_body_at_its_joints_axis_is_no_more_than_an_inertia_of_the_joint_before(
    place: float, remembered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A payload of 2.46 kg, 0.09 ± 0.02 mm from the elbow, stood for a rotor (97 %)."""
    rotor = replace(
        explained(1, "amount", cost=1.0, behind=0.0),
        hypothesis=Hypothesis("inertia", 1, "", ("amount",), 1.0),
    )
    load = replace(
        explained(2, "mass", "com_x", cost=2.0, behind=0.1),
        hypothesis=Hypothesis("payload", 2, "", ("mass", "com_x"), 2.0),
        values=np.array([2.46, place]), std=np.array([0.01, 2e-5]),
    )  # fmt: skip
    rounds = iter([[rotor, load], [replace(rotor, gain=0.0, z=0.0)]])
    monkeypatch.setattr(bodies, "hypotheses", lambda *_: [])
    monkeypatch.setattr(bodies, "Solver", lambda *_, **__: None)
    monkeypatch.setattr(bodies, "explain", lambda *_: next(rounds))
    layout: Any = SimpleNamespace(model=None, links=None)
    _, aside, (turn,) = bodies._round(None, None, layout, LIMITS)  # type: ignore[arg-type]
    assert aside == {1} and (turn.body(LIMITS) is load) is remembered


@pytest.mark.parametrize(
    ("mechanism", "effect", "weighs"),
    [
        ("position_torque", "gravity", True),
        ("actuator", "torque_offset", True),
        ("actuator", "torque_gain", True),
        ("actuator", "delay", False),
        ("dry_friction", "coulomb", False),
    ],
)
def test_a_joints_claim_may_be_the_weight_of_a_body(
    mechanism: str, effect: str, weighs: bool
) -> None:
    nothing: Any = None
    term = Term(effect, 2, {})
    claim = Claim(effect, mechanism, term, 0.1, nothing, 0.0, {}, (), (), ())
    decision: Any = SimpleNamespace(claims=(claim,))
    assert machine._weighs(decision) is weighs
    assert not machine._weighs(SimpleNamespace(claims=()))  # type: ignore[arg-type]
    nameless = replace(claim, effect="unknown", mechanism="dry", term=Term("unknown", 2, {}))
    assert not machine._weighs(SimpleNamespace(claims=(nameless,)))  # type: ignore[arg-type]


def claim(effect: str, mechanism: str, size: float) -> Claim:
    nothing: Any = None
    return Claim(effect, mechanism, Term(effect, 2, {}), size, nothing, 0.0, {}, (), (), ())


GAIN, ENCODER = claim("torque_gain", "actuator", 0.09), claim("unknown", "measurement", 0.03)


def says(joint: int, *claims: Claim) -> Any:
    """A joint that lacks torque, without a name where it claims nothing."""
    kind = Verdict.MISSING if claims else Verdict.UNEXPLAINED
    return SimpleNamespace(joint=joint, claims=claims, kind=kind)


@pytest.mark.parametrize(
    ("joints", "asked"),
    [
        ([says(1), says(2, GAIN, ENCODER)], "forearm"),
        ([says(1), says(2, GAIN, replace(ENCODER, size=0.2))], None),
        ([says(1, GAIN), says(2)], "upper"),
        ([says(1, ENCODER), says(2)], "forearm"),
    ],
)
def test_a_body_is_asked_for_by_a_joints_largest_claim_or_where_it_has_none(
    joints: list[Any], asked: str | None
) -> None:
    """A forearm 12 % heavier was a gain (97 %) and an eccentric encoder, beside a balancer that
    left a quarter of the other joint's torque without a name.
    """
    found: Any = SimpleNamespace(claims=(), decisions=joints)
    instead = (("upper", 1), ("forearm", 2)) if joints[0].claims else (("forearm", 2),)
    search: Any = SimpleNamespace(instead=instead, small=None, found=())
    assert machine._for_the_joints(search, found) == asked


@pytest.mark.parametrize(
    ("claims", "error", "before", "plainer", "stands"),
    [
        ((GAIN,), 1.0, 1.0, False, True),
        ((GAIN,), 80.0, 90.0, False, False),
        ((GAIN,), 1.5, 900.0, False, True),  # but for a thousandth of what they explain
        ((GAIN,), 1.5, 90.0, False, False),
        ((GAIN, ENCODER), 1.0, 1.0, True, True),
        ((GAIN, ENCODER), 1.0, 1.0, False, False),
    ],
)
def test_a_body_in_place_of_joints_claims_predicts_as_well_as_these(
    claims: tuple[Claim, ...],
    error: float,
    before: float,
    plainer: bool,
    stands: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A gain of 0.9 beside a balancer was a payload (61 %), with 80 times the error."""
    monkeypatch.setattr(machine, "plainer", lambda *_: plainer)
    monkeypatch.setattr(machine, "model_error", lambda _, improved: improved)
    monkeypatch.setattr(machine, "noise_floor", lambda _: 0.1)
    given: Any = None

    def found(improved: float, claims: tuple[Any, ...], *decisions: Any) -> Any:
        bare = SimpleNamespace(test=None)
        whole = SimpleNamespace(improved=improved, calibrated=before)
        return SimpleNamespace(
            bare=bare, whole=whole, claims=claims, decisions=decisions, explained=None
        )

    joints = found(1.0, (), says(1), says(2, *claims), says(3, ENCODER))
    body = SimpleNamespace(sizes={1: 0.1, 2: 0.2})
    assert machine._replaces(found(error, (body,)), joints, given) is stands
    assert not machine._replaces(found(error, ()), joints, given)


@pytest.mark.parametrize(
    ("mechanism", "left_open", "after"),
    [
        ("position_torque", {2, 5}, 1.0),
        ("actuator", {2, 5}, 1.0),
        ("dry_friction", {5}, 1.0),
        ("actuator", {2, 5}, 2.0),  # slow motion: 1.5 kg became -4.9
    ],
)
def test_a_body_is_refitted_with_the_gravity_of_its_joint_free_beside_a_spring_or_a_gain(
    monkeypatch: pytest.MonkeyPatch, mechanism: str, left_open: set[int], after: float
) -> None:
    """A real arm carried 150 kg, found as 159. Refitted beside the spring of its balancer it had
    become 175 ± 5. Numbers that predict worse are not taken.
    """
    errors = iter((1.0, after))
    monkeypatch.setattr(decide_bodies, "model_error", lambda *_: next(errors))
    asked: list[frozenset[int]] = []

    def found_again(*args: Any) -> Any:
        asked.append(args[-1])
        return "again"

    monkeypatch.setattr(decide_bodies, "agreed", found_again)
    monkeypatch.setattr(decide_bodies, "stated", lambda _layout, again: again)
    monkeypatch.setattr(decide_bodies, "Layout", lambda *_args: None)
    record = SimpleNamespace(links=SimpleNamespace())
    part = SimpleNamespace(records=[[record]])
    parts: Any = SimpleNamespace(fit=part, choose=part, test=None)
    first = explained(1, "mass", cost=2.0, behind=0.0)
    found = FoundBody(Term("payload", 6, {}), "tool", first, (), (), frozenset({5}))
    claim = BodyClaim(found, {}, 1.0, 0.9)
    at: Any = [SimpleNamespace(joint=2, claims=[SimpleNamespace(mechanism=mechanism)])]
    (settled,), _ = decide_bodies.settled(parts, planar(0.15), [claim], planar(0.15), at, 1)
    assert asked == [left_open]
    assert (settled.found.explained == "again") == (after <= 1.0)


def test_rivals_of_a_body_are_effects_in_the_report_and_words_in_its_sentence() -> None:
    term = Term("body", 2, {"mass": Quantity(0.3)})
    explained: Any = SimpleNamespace(
        hypothesis=Hypothesis("body", 2, "link2", ("mass",)),
        values=np.array([0.3]),
        std=np.array([0.03]),
        of_gain=None,
        of_inertia=None,
    )
    others = ("payload of link2", "body of link3", "gravity_scale", "calibration")
    found = FoundBody(term, "link2", explained, others, ())
    told = decide_bodies.body_finding(BodyClaim(found, {2: 0.1}, 100.0, 0.5), 0.02, GIVEN)
    assert told.indistinguishable == ("payload", "body of link3", "gravity")
    assert "another strength of gravity, other values of the model's own free" in told.sentence


def test_a_body_says_where_its_uncertainty_is_that_of_the_torque_gains() -> None:
    """Masses were within a tenth of their ±, since 5 % of the torque constants are in it."""
    term = Term("body", 2, {"mass": Quantity(0.3)})

    def told(of_gain: float, *stated: float) -> str:
        given = replace(GIVEN, actuator=replace(GIVEN.actuator, gain_std=stated))
        e = replace(explained(2, "mass", cost=2.0, behind=0.0), of_gain=np.array([of_gain]))
        found = FoundBody(term, "link2", e, (), ())
        claim = BodyClaim(found, {2: 0.1}, 100.0, 0.5)
        return decide_bodies.body_finding(claim, 0.02, given).sentence

    assert "± comes from the torque gains of the drives (5 %, since [actuator] gain" in told(0.9)
    assert "(0.5 %, as [actuator] gain states)" in told(0.9, 0.005)
    assert "torque gains" not in told(0.5)


def test_a_gain_that_a_body_explains_as_well_is_the_less_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A last link 10 % heavier was a gain of -9 % at either joint, each at 97 %."""

    def tried(effect: str, joint: int, gain: float, bodily: bool) -> Any:
        hypothesis = SimpleNamespace(effect=effect, joint=joint, of_bodies=bodily)
        return SimpleNamespace(hypothesis=hypothesis, gain=gain)

    monkeypatch.setattr(decide_bodies, "seen", lambda e: e.gain > 100.0)
    monkeypatch.setattr(decide_bodies, "tied", lambda e, top: e.gain > 0.9 * top.gain)
    nothing: Any = None

    def left(
        body: float, effect: str = "torque_gain", mechanism: str = "actuator", gap: str = ""
    ) -> Claim:
        of_bodies = [tried("body", 2, body, True), tried("payload", 2, 50.0, True)]
        own = [tried("torque_gain", 0, 900.0, False), tried("unknown", 2, 900.0, False)]
        forearm = SimpleNamespace(term=Term("body", 2, {}))
        search: Any = SimpleNamespace(tried=[*of_bodies, *own], instead=((forearm, 2),))
        term = Term(effect, 2, {})
        claim = Claim(effect, mechanism, term, 0.1, nothing, 0.0, {}, (), (), ())
        decision = Decision(2, Verdict.MISSING, (claim,), (), *[nothing] * 8)
        other = replace(decision, joint=1, kind=Verdict(gap or "missing"))
        return decide_bodies.or_bodies(search, [decision, other])[0].claims[0]

    assert (left(850.0).same, left(850.0).most) == (("body",), 0.75)
    assert (left(500.0).same, left(500.0).most) == ((), 1.0)
    # judged beside a joint that lacks torque without a name
    assert left(500.0, gap="unexplained").same == ("body",)
    assert left(500.0, "delay", gap="unexplained").same == ()
    assert left(850.0, "delay").same == ()
    assert left(850.0, "unknown", "position_torque").same == ("body",)
    assert left(850.0, "unknown", "dry_friction").same == ()


def test_a_body_is_named_before_the_laws_that_were_found_beside_it(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real arm's balancer, counted beside 150 kg at the tool, cost more than these 150 kg, of
    which other numbers of the joints took a part.
    """
    claim: Any = SimpleNamespace(
        effect="stiffness", size=1.0, evidence=SimpleNamespace(gain=2115.0), lost=(),
        term=SimpleNamespace(effect="stiffness"),
    )  # fmt: skip
    decision: Any = SimpleNamespace(
        joint=2, claims=(claim,), refinements=(), lost=(), before=SimpleNamespace(value=0.9),
        bursts=None, kind="missing",
    )  # fmt: skip
    body: Any = SimpleNamespace(gain=1236.0, square=0.28)
    monkeypatch.setattr(naming, "body_finding", lambda *_: SimpleNamespace(effect="payload"))
    law = SimpleNamespace(effect="stiffness", parameters={})
    monkeypatch.setattr(naming, "_finding", lambda *_: law)
    monkeypatch.setattr(naming, "numbers_of", lambda *_: {})
    monkeypatch.setattr(naming, "is_no_law", lambda *_: False)
    monkeypatch.setattr(naming, "shifted", lambda *_: ())
    monkeypatch.setattr(naming, "at_once", lambda _: ())
    nothing: Any = None
    findings, _, _ = naming.name_findings(nothing, nothing, [decision], nothing, [body])
    assert [f.effect for f in findings] == ["payload", "stiffness"]
