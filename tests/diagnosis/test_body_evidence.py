"""How sure it is that one explanation of bodies predicts better than another."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide_bodies import Heard, borne
from zendsp.diagnosis.explain import joints, machine
from zendsp.diagnosis.search import bodies
from zendsp.diagnosis.search.bodies import FoundBody
from zendsp.diagnosis.search.body_columns import NUISANCE
from zendsp.diagnosis.search.body_explain import Explained, explain, first_of
from zendsp.diagnosis.search.body_hypotheses import COST, LIMITS, Hypothesis
from zendsp.diagnosis.search.body_numbers import own_mass, unsure, weightless
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.model import Term

BLOCKS, SAMPLES = 16, 150
# how far the arm swings in each block: it does most of its motion in three of them
SWINGS = np.array([1, 1, 1, 30, 1, 1, 1, 1, 20, 1, 1, 1, 25, 1, 1, 1], float)


def sums(torque: float, rng: np.random.Generator, like: int | None = None) -> Any:
    """Gram matrices of one joint: a nuisance, the column of a body, and innovations with ``torque``
    times that column beside noise. ``like``: the nuisance that this column is there.
    """
    grams, counts = np.zeros((1, BLOCKS, NUISANCE + 2, NUISANCE + 2)), np.full((1, BLOCKS), 150.0)
    for block, swing in enumerate(SWINGS):
        nuisance = rng.normal(size=(NUISANCE, SAMPLES)) * (1.0 if like is None else swing)
        body = swing * np.sin(np.linspace(0, 6, SAMPLES) + rng.uniform(0, 6))
        body = body if like is None else nuisance[like]
        left = -torque * body + rng.normal(size=SAMPLES)
        columns = np.concatenate([nuisance, [body, left]])
        grams[0, block] = columns @ columns.T
    return SimpleNamespace(grams=grams, counts=counts, whole=grams.sum(axis=1), alike=2)


def sureness(torque: float, seed: int) -> float:
    """How sure the body's column is, estimated on one recording, to beat nothing on another."""
    rng = np.random.default_rng(seed)
    layout: Any = SimpleNamespace(rotors=True, joints=1, width=NUISANCE + 1, own=NUISANCE + 1)
    solver = Solver(sums(torque, rng), sums(torque, rng), layout, LIMITS)
    gram = solver.rest[0]
    found = np.zeros((1, layout.width))
    found[0, NUISANCE] = -gram[0, 1] / gram[0, 0]
    return solver.better(found, np.zeros((1, layout.width)))


def test_a_body_that_is_felt_in_few_blocks_only_is_sure() -> None:
    """The mean gain of a block over its spread stays below 3 here, however heavy the body. Yet 0.3
    of the column is 100 standard deviations of the noise.
    """
    assert all(sureness(0.3, seed) > LIMITS.sure for seed in range(20))
    assert all(sureness(3.0, seed) > 10 for seed in range(20))


def test_friction_that_the_fit_does_not_know_hides_no_body() -> None:
    """Friction of fast motion says little of slow motion; each recording has its own. In an arm
    whose friction fell at low speed, a link 10 % heavier had not been seen.
    """
    rng = np.random.default_rng(0)
    fit, choose = sums(0.3, rng), sums(0.3, rng)
    other = np.eye(NUISANCE + 2)
    other[1, -1] = 300.0  # of the first friction
    choose.grams = other.T @ choose.grams @ other
    choose.whole = choose.grams.sum(axis=1)
    layout: Any = SimpleNamespace(rotors=True, joints=1, width=NUISANCE + 1, own=NUISANCE + 1)
    solver = Solver(fit, choose, layout, LIMITS)
    found = np.zeros((1, layout.width))
    found[0, NUISANCE] = 0.3
    assert solver.better(found, np.zeros((1, layout.width))) > LIMITS.sure
    assert np.allclose(solver.squares(found) / choose.counts.sum(), 1.0, atol=0.1)


@pytest.mark.parametrize(("like", "sure"), [(0, True), (NUISANCE - 1, True), (1, False)])
def test_a_short_recording_takes_no_body_for_its_own_offset_or_rotor(like: int, sure: bool) -> None:
    """Over 3 s the weight of a link was a constant, which that recording had fitted: a centre 2 cm
    off was an offset, 86 % sure. Friction is each recording's own.
    """
    rng = np.random.default_rng(0)
    layout: Any = SimpleNamespace(rotors=True, joints=1, width=NUISANCE + 1, own=NUISANCE + 1)
    solver = Solver(sums(0.3, rng), sums(0.3, rng, like), layout, LIMITS)
    found = np.zeros((1, layout.width))
    found[0, NUISANCE] = 0.3
    better = solver.better(found, np.zeros((1, layout.width)))
    assert (better > LIMITS.sure) is sure


def test_a_body_that_is_not_there_is_hardly_ever_sure() -> None:
    """A normal deviate exceeds three in 0.1 % of draws; 4 of 400 leaves room for chance."""
    assert sum(sureness(0.0, seed) > LIMITS.sure for seed in range(400)) <= 4


def test_what_joints_say_of_one_body_adds_up() -> None:
    """A base tilted by 2 degrees, seen by six joints of a small arm. The first, where it is the
    largest part of the torque, is not sure alone (9 are needed).
    """
    told = [
        Heard(0.241, 0.070, 4.1, 4.6), Heard(0.074, 0.0004, 13.8, 44.6),
        Heard(0.071, 0.0012, 14.1, 53.2), Heard(0.027, 0.0010, 10.9, 10.4),
        Heard(0.071, 0.0012, 11.7, 14.8), Heard(6e-5, 0.0004, 0.7, 2.4),
    ]  # fmt: skip
    assert borne(told, 9.0) is not None
    assert borne(told[:1], 9.0) is None, "one joint that is not sure"
    assert borne([Heard(0.2, 0.3, 20.0, 9.0)], 9.0) is None, "less than what stays unexplained"
    against = [Heard(0.3, 0.01, -5.0, -3.0), Heard(0.1, 0.01, 20.0, 9.0)]
    assert borne(against, 9.0) is None, "most of it is where it is not missed"


def test_a_body_stands_where_the_joints_need_more_findings_and_predict_no_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A real arm's load had been explained by a spring and two wrong rotors."""
    findings = {"body": 1, "joints": 3}
    errors = {"body": 3.2e-4, "joints": 3.5e-4}  # rad
    machines: list[Any] = [([], [], SimpleNamespace(improved=name)) for name in findings]
    monkeypatch.setattr(joints, "findings_at", lambda _test, _given, e: findings[e[2].improved])
    monkeypatch.setattr(joints, "model_error", lambda _test, model: errors[model])
    sensor = [1e-5]
    monkeypatch.setattr(joints, "noise_floor", lambda _test: sensor[0])

    def stands() -> bool:
        return joints.plainer(None, None, *machines, -1)  # type: ignore[arg-type]

    assert stands()
    findings["joints"] = 2
    assert not stands(), "a body is a finding, too"
    findings["joints"], errors["body"] = 3, 3.6e-4
    assert not stands(), "it predicts worse"
    sensor[0] = 2.9e-4
    assert stands(), "as far as anyone can see"


def test_no_body_is_considered_where_the_joints_need_only_one_finding(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "findings_at", lambda *_: 1)
    monkeypatch.setattr(machine, "explain", lambda *_: pytest.fail("searched once more"))
    parts = SimpleNamespace(test=None)
    apart: Any = SimpleNamespace(
        bare=parts, bodies=SimpleNamespace(found=[1, 2]), explained=([], [], None)
    )
    found = machine._one_body(apart, ([], [], None), None, 1, print)  # type: ignore[arg-type]
    assert found is apart


def explained(joint: int, *free: str, cost: float, behind: float) -> Explained:
    numbers = np.ones(len(free))
    h = Hypothesis("body", joint, f"link{joint}", free, cost)
    return Explained(h, numbers, numbers, 100.0, 5.0, behind, np.ones(3), np.ones(3))


def test_fewer_numbers_of_a_link_must_predict_as_well_as_more_of_it() -> None:
    """Otherwise the joints must explain the rest: a centre 3 cm off had become less mass, a gravity
    and an offset. Numbers of other links may follow later.
    """
    mass = explained(2, "mass", cost=2.0, behind=2.2)
    centre = explained(2, "com_x", "com_y", "com_z", cost=4.0, behind=0.0)
    other = explained(3, "com_x", "com_y", "com_z", cost=4.0, behind=0.5)
    assert first_of([mass, other, centre], LIMITS) is centre
    assert first_of([mass, other], LIMITS) is mass
    nearly = explained(2, "mass", cost=2.0, behind=1.0)
    assert first_of([nearly, centre], LIMITS) is nearly


def test_undetermined_numbers_of_a_link_do_not_replace_a_determined_one() -> None:
    """0.12 kg at a link of a Unitree Z1 had become 0.9 ± 20 kg at 0.7 m, and so no body."""
    mass = explained(2, "mass", cost=2.0, behind=1.9)
    every = explained(2, "mass", "com_x", "com_z", cost=4.0, behind=0.0)
    assert first_of([mass, every], LIMITS) is every
    assert first_of([mass, replace(every, std=20.0 * every.std)], LIMITS) is mass


@pytest.mark.parametrize(("com", "nothing"), [(0.45, True), (0.65, False)])
def test_a_body_with_no_number_surely_different_from_zero_is_not_claimed(
    com: float, nothing: bool
) -> None:
    """A payload of 70 ± 64 g somewhere on its link; its moment may still be sure."""
    explained: Any = SimpleNamespace(
        values=np.array([0.070, com]), std=np.array([0.064, 0.2]),
        hypothesis=SimpleNamespace(free=("mass", "com_x")),
    )  # fmt: skip
    assert unsure(explained) is nothing
    assert weightless(explained)


@pytest.mark.parametrize(("at", "carried"), [(1.1, True), (1.6, False)])
def test_a_payload_may_have_its_centre_beyond_the_end_of_its_link(at: float, carried: bool) -> None:
    """Its reach is measured from the link's centre of mass, not from the joint."""
    link = SimpleNamespace(mass=1.0, com=np.array([0.0, 0.0, 0.5]))
    solver: Any = SimpleNamespace(
        layout=SimpleNamespace(links=SimpleNamespace(bodies=[link, link])), limits=LIMITS
    )
    payload = Hypothesis("payload", 2, "fore", ("mass", "com_x", "com_z"))
    assert Solver.plausible(solver, payload, np.array([1.9, 0.0, at])) is carried


def gaining(**gains: float) -> Any:
    """A solver in which each effect has a given gain, and all predict equally well."""
    left = lambda x: 1000.0 - gains.get(x, 0.0)  # noqa: E731
    return SimpleNamespace(
        limits=LIMITS,
        at=lambda h, values: h.effect,
        estimate=lambda h: np.zeros(1),
        points=lambda x: np.array([[left(x)]]),
        squares=lambda x: np.array([left(x)]),
        plausible=lambda h, values: True,
        std=lambda h, values: np.zeros(1),
        better=lambda x, other: 9.0 if other == "nothing" else 0.0,
    )


@pytest.mark.parametrize(("rotors", "first"), [(300.0, "body"), (598.0, "gravity")])
def test_an_explanation_that_also_needs_a_rotor_ranks_behind_one_that_does_not(
    rotors: float, first: str
) -> None:
    """A first link 10 % heavier had become a gravity and an inertia of its joint. But a balancer
    must not become a heavier link.
    """
    tried = [
        Hypothesis("gravity", 1, "", ("sine", "cosine"), COST["gravity"]),
        Hypothesis("body", 1, "upper", ("mass",), COST["body"] + 1),
    ]
    rigid = gaining(gravity=rotors, body=898.0 - rotors)
    assert explain(gaining(gravity=600.0, body=600.0), tried, rigid)[0].hypothesis.effect == first


@pytest.mark.parametrize(("behind", "first"), [(0.5, "torque_gain"), (2.2, "body")])
def test_a_hypothesis_that_predicts_worse_loses_likelihood_for_it(
    behind: float, first: str
) -> None:
    """A centre of mass 5 cm off had been called a gain of one joint. The gain has three numbers
    fewer, but half the likelihood gain, and predicts 2.2 standard deviations worse.
    """
    centre = Hypothesis("body", 1, "upper", ("com_x", "com_z"), COST["body"] + 2)
    tried = [Hypothesis("torque_gain", 1, "", ("ratio",), COST["torque_gain"]), centre]
    solver = gaining(torque_gain=1200.0, body=2700.0)
    solver.better = lambda x, other: {"nothing": 9.0, "torque_gain": behind}.get(other, 0.0)
    assert explain(solver, tried, solver)[0].hypothesis.effect == first


def test_a_hypothesis_hardly_better_than_none_does_not_tie_with_one_that_is() -> None:
    """A gain of one joint, only two standard deviations better than nothing, had outranked a link
    16 % heavier, and nothing was proposed.
    """
    tried = [
        Hypothesis("torque_gain", 1, "", ("ratio",), COST["torque_gain"]),
        Hypothesis("body", 1, "fore", ("mass",), COST["body"] + 1),
    ]
    solver = gaining(torque_gain=465.0, body=1200.0)
    unsure = {("torque_gain", "nothing"): 2.1, ("body", "torque_gain"): 1.0}
    solver.better = lambda x, other: unsure.get((x, other), 9.0 if other == "nothing" else 0.0)
    assert explain(solver, tried, solver)[0].hypothesis.effect == "body"


@pytest.mark.parametrize(("mass", "kept"), [(0.5, False), (3.0, True)])
def test_a_wrong_centre_of_mass_is_claimed_alone_where_the_mass_may_be_right(
    mass: float, kept: bool
) -> None:
    names = ("mass", "com_x", "com_z")
    both, centre = (
        explained(1, *names, cost=4.0, behind=0.0),
        explained(1, *names[1:], cost=3.0, behind=2.8),
    )
    both = replace(both, values=np.array([mass, 0.02, -0.05]), std=np.array([1.0, 0.01, 0.01]))
    link: Any = SimpleNamespace(bodies=[SimpleNamespace(mass=8.0, com=np.zeros(3))])
    found = own_mass(both, [both, centre], link, LIMITS)
    assert found is (both if kept else centre)


@pytest.mark.parametrize(("blur", "own"), [(0.08, True), (0.004, False)])
def test_a_payload_that_may_sit_at_its_links_centre_is_that_links_mass(
    blur: float, own: bool
) -> None:
    """A link 10 % heavier had been called a payload 5 ± 8 cm from the link's centre."""
    payload = explained(1, "mass", "com_x", "com_z", cost=COST["payload"], behind=0.0)
    payload = replace(
        payload,
        hypothesis=replace(payload.hypothesis, effect="payload"),
        values=np.array([0.23, 0.25, 0.006]),
        std=np.array([0.03, blur, 0.005]),
    )
    heavier = explained(1, "mass", cost=COST["body"] + 1, behind=0.9)
    centre = np.array([0.2, -0.01, 0.0])  # nobody feels where it lies along y
    link: Any = SimpleNamespace(bodies=[SimpleNamespace(mass=2.3, com=centre)])
    found = own_mass(payload, [payload, heavier], link, LIMITS)
    assert found is (heavier if own else payload)


def test_what_other_numbers_of_a_found_body_explain_is_no_further_body() -> None:
    """A payload had been told as a payload and a link that carries it, where the last joint hardly
    moved.
    """
    payload = explained(3, "mass", cost=COST["payload"], behind=0.0)
    found = [FoundBody(Term("payload", 3, {}), "link3", payload, (), ())]
    link, own = explained(2, "mass", cost=2.0, behind=0.0), explained(3, "mass", cost=2.0, behind=1)
    assert bodies._is_error_of(found, [link, own], LIMITS)
    assert not bodies._is_error_of(found, [link, replace(own, behind=9.0, gain=10.0)], LIMITS)
    assert not bodies._is_error_of(found, [link, replace(own, z=2.0)], LIMITS)
    assert not bodies._is_error_of((), [link, own], LIMITS)


def test_slower_observers_are_asked_for_a_body_that_several_joints_show(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Behind 12 bits a payload at two joints had lost to two gains, of -48 and -34 %."""
    asked: list[float] = []

    def searched(*args: Any) -> bodies.BodySearch:
        asked.append(args[5].bandwidth)
        return bodies.BodySearch(args[2], beside=True)

    monkeypatch.setattr(bodies, "_searched", searched)
    monkeypatch.setattr(bodies, "Layout", lambda *_: None)
    links = SimpleNamespace(bodies=[SimpleNamespace(parent=0)])
    data: Any = SimpleNamespace(records=[[SimpleNamespace(links=links)]])
    model: Any = None
    bodies.find_bodies(data, data, model, 1, lambda _: None)
    assert asked == 2 * [64.0, 32.0, 16.0, 8.0]  # with a friction by load, and without
    body = explained(2, "mass", cost=2.0, behind=0.0)
    assert bodies._at_several(body, LIMITS)
    assert not bodies._at_several(replace(body, share=np.array([0.0, 1.0, 0.1])), LIMITS)


@pytest.mark.parametrize("known", [True, False])
def test_where_mass_and_centre_of_a_payload_cannot_be_told_apart_its_moment_is_claimed(
    known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """63 g on a wrist whose axis shows no mass were dropped, though 31 g had been found."""
    payload = explained(4, "mass", "com_x", cost=COST["payload"], behind=0.0)
    payload = replace(payload, hypothesis=replace(payload.hypothesis, effect="payload"))
    centre = explained(4, "com_x", cost=2.0, behind=0.5)
    other = explained(3, "com_x", cost=2.0, behind=0.5)
    spread = {id(payload): 0.1 if known else 2.0, id(centre): 0.1, id(other): 0.1}
    monkeypatch.setattr(
        bodies, "refined", lambda *a: replace(a[3], std=spread[id(a[3])] * np.abs(a[3].values))
    )
    monkeypatch.setattr(bodies, "own_mass", lambda best, *_: best)
    layout: Any = SimpleNamespace(links=None)
    data: Any = None
    tried = [payload, other, centre]
    best = bodies._with_numbers(data, data, layout, tried, LIMITS, 1, frozenset())
    assert best.hypothesis == (payload if known else centre).hypothesis


@pytest.mark.parametrize(("mass", "carried"), [(1.2, True), (1.1, False)])
def test_a_link_half_as_heavy_again_carries_a_payload(mass: float, carried: bool) -> None:
    """0.5 kg at a last link of 0.58 kg had been called that link's own mass and centre."""
    names = ("mass", "com_x", "com_z")
    heavier = explained(1, *names, cost=4.0, behind=0.0)
    heavier = replace(heavier, values=np.array([mass, 0.02, -0.05]), std=np.full(3, 0.01))
    payload = explained(1, *names, cost=COST["payload"], behind=2.9)
    payload = replace(payload, hypothesis=replace(payload.hypothesis, effect="payload"))
    link: Any = SimpleNamespace(bodies=[SimpleNamespace(mass=2.3, com=np.zeros(3))])
    found = own_mass(heavier, [heavier, payload], link, LIMITS)
    assert found is (payload if carried else heavier)


@pytest.mark.parametrize(
    ("claims", "proposed", "asks"),
    [
        (("offset", "offset"), False, True),
        (("offset", "rubs"), False, False),
        (("offset", "offset"), True, False),
        (("offset", "open"), False, True),
        (("rubs", "open"), False, False),
        (("open", "open"), False, False),
    ],
)
def test_a_small_body_is_asked_for_where_joints_claim_what_it_may_be(
    claims: tuple[str, str], proposed: bool, asks: bool
) -> None:
    """A base tilted by half a degree was a torque without a law at one joint (0.93), and left
    another one open.
    """
    nothing: Any = None
    offset, rubs = (
        Claim(effect, mechanism, Term(effect, 1, {}), 0.1, nothing, 0.0, {}, (), (), ())
        for effect, mechanism in (("torque_offset", "actuator"), ("coulomb", "dry_friction"))
    )
    joints: dict[str, Any] = {
        "offset": SimpleNamespace(claims=(offset,), kind=Verdict.MISSING),
        "rubs": SimpleNamespace(claims=(rubs,), kind=Verdict.MISSING),
        "open": SimpleNamespace(claims=(), kind=Verdict.UNEXPLAINED),
        "none": SimpleNamespace(claims=(), kind=Verdict.COMPLETE),
    }
    found: Any = SimpleNamespace(claims=(), decisions=[joints[c] for c in (*claims, "none")])
    small: Any = object()
    search: Any = SimpleNamespace(instead=(), small=small, found=(object(),) * proposed)
    asked = machine._for_the_joints(search, found)
    assert (asked is small) is asks
    found.claims = (object(),)  # a body is claimed already
    assert machine._for_the_joints(search, found) is None


def test_a_body_is_held_against_none_only_where_a_joint_corrects_much_of_it() -> None:
    """A payload of 2 kg at six joints was searched for twice, for a rotor of 0.2 % at one."""
    nothing: Any = None
    term = Term("inertia", 5, {})
    claim = Claim("inertia", "inertia", term, 0.02, nothing, 0.0, {}, (), (), ())
    decision = Decision(5, "missing", (claim,), (), *[nothing] * 8)

    def corrected(felt: float) -> bool:
        body: Any = SimpleNamespace(sizes={5: felt})
        return machine._is_corrected([body], decision)

    assert corrected(0.03) and not corrected(0.3)
    assert not machine._is_corrected([], decision), "there is no body"


def test_the_rest_of_the_joints_is_not_searched_where_the_first_claim_too_much() -> None:
    claims: Any = SimpleNamespace(claims=(1, 2))
    done: Any = {1: (None, claims), 3: (None, claims)}
    joints._count(done, 5)
    with pytest.raises(joints.Outnumbered):
        joints._count(done, 4)
