"""Laws that replace one another, and what is kept of the terms that they replaced."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from made_claims import claim_of, of_one_claim
from small_models import COULOMB, VISCOUS, model_of

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.decide import believed, laws, nameless, patchwork
from zendsp.diagnosis.decide.claims import Decision, Piece, unclaimed
from zendsp.diagnosis.decide.contract import Reason
from zendsp.diagnosis.decide.findings import Estimate, Finding
from zendsp.diagnosis.decide.remember import as_reported, remembered
from zendsp.diagnosis.explain import joints, one_joint
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.search import simpler_laws, simplify
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import file_model


@pytest.mark.parametrize(
    ("angle", "level", "travel", "curve"),
    [
        (-2.18, 1, 2.6, True),  # a spring past the middle was a gravity and a constant
        (-2.18, 0, 2.6, False),
        (-2.18, 1, 6.5, False),  # it was seen to return
        (1.5, 1, 2.6, False),  # balanced where an axis has its zero
    ],
)
def test_gravity_beside_a_constant_or_spring_over_less_than_a_turn_is_not_named(
    angle: float, level: int, travel: float, curve: bool
) -> None:
    wave = Term("gravity", 1, {"angle": Quantity(angle, std=0.09)})
    assert patchwork.part_of_a_wave(wave, level, travel) is curve


@pytest.mark.parametrize(
    ("period", "unsure", "curve"),
    [
        (2.0962, 0.0025, False),  # a third of a turn
        (2.0962, math.inf, True),  # of a joint that slides
        (2.0962, 0.02, True),  # too rough to be told from others
        (1.95, 0.0025, True),
        (1.5, 0.0025, False),  # the travel shows it whole
    ],
)
def test_a_friction_whose_period_divides_a_turn_is_named_on_a_shorter_travel(
    period: float, unsure: float, curve: bool
) -> None:
    wave = Term("position_friction", 1, {"period": Quantity(period)})
    assert patchwork.part_of_a_wave(wave, 0, 1.8, unsure) is curve


@pytest.mark.parametrize(
    ("effect", "unsure", "curve"),
    [
        ("sensor_harmonic", 0.15, False),
        ("sensor_harmonic", 0.54, True),  # on 1.2 waves; it was a damping over the position
        ("sensor_harmonic", math.inf, False),  # of a joint that slides
        ("ripple", 0.54, False),  # its order is whole by no law
    ],
)
def test_an_error_of_the_sensor_whose_order_may_be_any_number_is_not_named(
    effect: str, unsure: float, curve: bool
) -> None:
    wave = Term(effect, 1, {"order": Quantity(13.62)})
    assert patchwork.part_of_a_wave(wave, 0, 0.55, unsure) is curve


def test_couplings_from_one_joint_are_one_finding_and_two_frictions_are_two() -> None:
    def piece(effect: str) -> Any:
        return SimpleNamespace(terms=(Term(effect, 5, {}),), effects=(effect,))

    assert laws._one_with(piece("coupling"), piece("coupling"))
    assert laws._one_with(piece("stribeck"), piece("coulomb"))
    assert not laws._one_with(piece("coulomb"), piece("position_friction"))


@pytest.mark.parametrize(
    ("loss", "kept"), [(25.0, {"stiffness"}), (200.0, {"cubic_stiffness", "torque_offset"})]
)
def test_one_spring_replaces_two_laws_where_it_gains_nearly_as_much(
    monkeypatch: pytest.MonkeyPatch, loss: float, kept: set[str]
) -> None:
    """The two laws gain 1000 in deviance."""
    motion = SimpleNamespace(states=(np.linspace(-1.0, 1.0, 11),))
    data = SimpleNamespace(records=[[SimpleNamespace(n=11, motion=motion)]])
    costs = {"stiffness": loss, "cubic_stiffness": 0.0}

    def scored(model: Model) -> Any:
        lost = [costs[t.effect] for t in model.terms if t.effect in costs]
        return SimpleNamespace(model=model, data=data, deviance=min(lost, default=1000.0))

    mechanism = {"kind": "rotary", "parameters": {"inertia": 0.01}}
    bare = parse_model({"sample_time": 0.001, "mechanism": mechanism})
    two = (
        make_term(get_effect("cubic_stiffness"), 1, {"coefficient": 0.006, "neutral": 0.0}),
        make_term(get_effect("torque_offset"), 1, {"level": -0.003}),
    )
    monkeypatch.setattr(simpler_laws, "refitted", lambda data, model, *_: scored(model))
    found: Any = SimpleNamespace(joint=1, base=scored(bare))
    best = simpler_laws._as_spring(found, scored(bare.with_terms(two)), 1)
    assert {t.effect for t in best.model.terms} == kept


@pytest.mark.parametrize(
    ("amount", "kept"), [(5e-6, {"torque_gain", "inertia"}), (5e-4, {"inertia", "gravity"})]
)
def test_a_gain_beside_which_simulators_may_differ_by_the_inertia_is_no_payload(
    monkeypatch: pytest.MonkeyPatch, amount: float, kept: set[str]
) -> None:
    """More inertia and a weaker drive are a payload, but any gain is a heavier body exactly."""
    record = SimpleNamespace(n=11)
    data = SimpleNamespace(records=[[record]])
    monkeypatch.setattr(simpler_laws, "facts", lambda _: SimpleNamespace(inertia=0.0186))

    def scored(model: Model) -> Any:  # all but the gain alone explain as much
        alone = {t.effect for t in model.terms} == {"torque_gain"}
        return SimpleNamespace(model=model, data=data, deviance=67.0 if alone else 0.0)

    mechanism = {"kind": "rotary", "parameters": {"inertia": 0.0186, "gravity": 1.1}}
    bare = parse_model({"sample_time": 0.001, "mechanism": mechanism})
    two = (
        make_term(get_effect("torque_gain"), 1, {"ratio": -0.07}),
        make_term(get_effect("inertia"), 1, {"amount": amount}),
    )
    monkeypatch.setattr(simpler_laws, "refitted", lambda data, model, *_: scored(model))
    found: Any = SimpleNamespace(joint=1, base=scored(bare))
    best = simpler_laws._as_payload(found, scored(bare.with_terms(two)), 1000, 1)
    assert {t.effect for t in best.model.terms} == kept


@pytest.mark.parametrize(
    ("scaled", "kept"),
    [(True, {"inertia", "gravity", "coulomb"}), (False, {"torque_gain", "gravity", "coulomb"})],
)
def test_a_weaker_drive_with_less_of_every_friction_is_a_payload(
    monkeypatch: pytest.MonkeyPatch, scaled: bool, kept: set[str]
) -> None:
    """A payload of 0.15 kg on a pendulum had been a gain, a gravity and two other frictions."""
    data = SimpleNamespace(records=[[SimpleNamespace(n=11)]])
    monkeypatch.setattr(simpler_laws, "facts", lambda _: SimpleNamespace(inertia=0.02))

    def scored(model: Model) -> Any:
        worse = any(t.effect == "inertia" for t in model.terms) and not scaled
        return SimpleNamespace(model=model, data=data, deviance=1000.0 if worse else 0.0)

    own = {"kind": "coulomb", "joint": 1, "level": {"value": 0.06, "free": False}}
    mechanism = {"kind": "rotary", "parameters": {"inertia": 0.02, "gravity": 0.5}}
    given = parse_model({"sample_time": 0.001, "mechanism": mechanism, "effect": [own]})
    found: Any = SimpleNamespace(joint=1, base=scored(given))
    terms = (
        make_term(get_effect("coulomb"), 1, {"level": 0.04}),
        make_term(get_effect("torque_gain"), 1, {"ratio": -1 / 3}),
        make_term(get_effect("gravity"), 1, {"torque": 0.1, "angle": 0.0}),
    )
    monkeypatch.setattr(simpler_laws, "refitted", lambda data, model, *_: scored(model))
    best = simpler_laws._as_inertia(found, scored(given.with_terms(terms)), 1000, 1)
    assert {t.effect for t in best.model.terms} == kept
    if scaled:
        values = {t.effect: next(iter(t.parameters.values())).value for t in best.model.terms}
        assert values == pytest.approx({"coulomb": 0.06, "inertia": 0.01, "gravity": 0.15})
        assert best.model.terms[0] is given.terms[0], "the friction is as it was given"


@pytest.mark.parametrize(("of_a_block", "released"), [(8.8, False), (40.0, True)])
def test_an_exponent_is_not_fitted_to_one_moment_in_which_the_model_loses_track(
    monkeypatch: pytest.MonkeyPatch, of_a_block: float, released: bool
) -> None:
    """Both gain 300 in deviance. At a start from rest 13 deviations of an exponent gained as much
    in one block, and 9 where no block counts for more than ten usual ones.
    """
    numbers = {"breakaway": 0.05, "velocity": 0.08, "exponent": 2.0}
    bare = parse_model(
        {"mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}}, "sample_time": 0.001}
    )
    law = make_term(get_effect("stribeck"), 1, numbers)

    def scored(model: Model, deviance: float) -> Any:
        fit = SimpleNamespace(handles=(), at_bound=())
        return SimpleNamespace(model=model, data=None, deviance=deviance, fit=fit)

    monkeypatch.setattr(simplify, "refitted", lambda data, model, *_: scored(model, -300.0))
    monkeypatch.setattr(simplify, "compare", lambda *_: SimpleNamespace(gain=of_a_block))
    found: Any = SimpleNamespace(joint=1, base=scored(bare, 0.0))
    (term,) = simplify._released(found, scored(bare.with_terms((law,)), 0.0), 40000, 1).model.terms
    assert term.parameters["exponent"].free is released


def test_refinements_are_held_fixed_in_the_model_file() -> None:
    """The second of two terms of one effect is held, but not one that replaces a given term."""
    terms = [
        make_term(get_effect(name), 1, {key: 1.0})
        for name, key in (("coulomb", "level"), ("ripple", "amplitude"), ("ripple", "amplitude"))
    ]
    given = parse_model({"mechanism": {"kind": "rotary", "parameters": {"inertia": 1.0}}})
    final: Any = SimpleNamespace(model=given.with_terms(tuple(terms)))
    claimed, refined = (claim_of(t, 0.1) for t in terms[1:])
    outcome = replace(of_one_claim(claimed, 0.02, 0.02, final), refinements=(refined,), scale=5.0)
    model = remembered(given.with_terms(tuple(replace(t) for t in terms)), given, [outcome], [])
    assert [any(q.free for q in t.parameters.values()) for t in model.terms] == [True, True, False]
    assert model.discrepancy.torque == (0.1,)


def test_a_model_file_has_the_uncertainties_of_the_report() -> None:
    """A breakaway of 0.24 ± 0.00048 stood there ± 0.00018: of what it has above Coulomb alone."""
    coulomb = Term("coulomb", 1, {"level": Quantity(0.15, std=0.0003)})
    falls = {"breakaway": Quantity(0.09, std=0.00018), "velocity": Quantity(0.25, std=0.0005)}
    falls |= {"exponent": Quantity(2.0, free=False)}
    model = Model("m", 1e-3, "rotary", {}, (coulomb, Term("stribeck", 1, falls)))
    numbers = {
        "breakaway": Estimate(0.24, 0.00048, "N m"), "velocity": Estimate(0.3, 0.1, "rad/s")
    }  # fmt: skip
    said = Finding("stribeck", 1, numbers, 0.9, 1.0, (), (), "")
    written = as_reported(file_model(model), [said]).terms[1].parameters
    assert (written["breakaway"].value, written["breakaway"].std) == (0.24, 0.00048)
    assert written["velocity"].std == 0.0005, "where the numbers differ, each keeps its own"


def test_claims_are_judged_with_the_terms_that_a_refinement_had_replaced(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it the model lacked viscous friction, and a gap with right numbers had a confidence
    of 13 %.
    """
    terms = [Term(e, 1, {}) for e in ("viscous", "coulomb", "viscous_asymmetry", "backlash")]
    given = Model("m", 1e-3, "rotary", {}, tuple(terms[:2]))
    final: Any = SimpleNamespace(model=given.with_terms(tuple(terms[1:])), data=None)
    monkeypatch.setattr(believed, "joint_handles", lambda *_: [])
    monkeypatch.setattr(believed, "fit_scored", lambda _, model, *__, **___: model)
    uneven, gap = (claim_of(t, 0.1) for t in terms[2:])
    alone: Any = believed.by_themselves(given, final, 1, [gap], [uneven], 1)
    assert sorted(t.effect for t in alone.terms) == ["backlash", "coulomb", "viscous"]


def test_when_claims_are_dropped_the_terms_they_replaced_return() -> None:
    base: Any = SimpleNamespace(deviance=10.0)
    law: Any = SimpleNamespace(effect="backlash")
    size: Any = SimpleNamespace(value=0.1)
    final: Any = SimpleNamespace(deviance=-90.0)
    state = Structure(0.0, 0.0, 0.0)
    claimed = Decision(
        1, "missing", (law,), (law,), base, final, size, size, state, size, final, 1.0
    )
    dropped = unclaimed(claimed)
    assert (dropped.claims, dropped.refinements, dropped.final) == ((), (), base)
    (tried,) = dropped.lost
    assert (tried.effect, tried.joint, tried.score) == ("backlash", 1, 50.0)
    assert tried.reason is Reason.NEAR and "untouched recordings worse" in tried.why


@pytest.mark.parametrize(
    ("effect", "errors", "stands"),
    [
        ("backlash", {"given": 9.0, "calibrated": 3.0, "improved": 2.0}, True),
        ("backlash", {"given": 9.0, "calibrated": 3.0, "improved": 4.0}, False),
        # something in the recordings of the fit, a stall perhaps, bends the numbers
        ("backlash", {"given": 1.0, "calibrated": 3.0, "improved": 2.0}, False),
        ("unknown", {"given": 1.0, "calibrated": 3.0, "improved": 3.0}, False),
        ("unknown", {"given": 1.0, "calibrated": 1.2, "improved": 1.2}, True),
        ("unknown", {"given": 9.0, "calibrated": 3.0, "improved": 3.0}, True),
    ],
)
def test_no_claim_stands_with_which_untouched_recordings_are_predicted_worse(
    effect: str, errors: dict[str, float], stands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = {name: SimpleNamespace(name=name) for name in errors}
    whole = SimpleNamespace(calibrated=models["calibrated"], improved=models["improved"])
    monkeypatch.setattr(joints, "assemble", lambda *_: whole)
    monkeypatch.setattr(joints, "window_error", lambda _, model, __: np.full(3, errors[model.name]))
    scored: Any = SimpleNamespace(deviance=0.0)
    size: Any = SimpleNamespace(value=0.1)
    law: Any = SimpleNamespace(effect=effect)
    state = Structure(0.0, 0.0, 0.0)
    claimed = Decision(
        1, "missing", (law,), (), scored, scored, size, size, state, size, scored, 1.0
    )
    parts: Any = SimpleNamespace(test=None)
    given: Any = models["given"]
    (decision,), _ = joints._no_worse(parts, given, [claimed], 1)
    assert bool(decision.claims) == stands


@pytest.mark.parametrize("stated", [False, True])
def test_a_friction_that_creeps_stands_once_where_a_joint_is_decided_again(
    stated: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    coulomb, creep = (
        Term(name, 1, {key: Quantity(0.1)})
        for name, key in (("coulomb", "level"), ("creep", "speed"))
    )

    def model(terms: tuple[Term, ...]) -> Any:
        return SimpleNamespace(terms=terms, with_terms=model)

    first: Any = SimpleNamespace(joint=1, base=SimpleNamespace(model=model((coulomb, creep))))
    seen: list[Any] = []
    monkeypatch.setattr(one_joint, "calibrate_joint", lambda _, given, *__: seen.append(given))
    monkeypatch.setattr(one_joint, "upon", lambda *_: None)
    monkeypatch.setattr(one_joint, "decide", lambda *_: None)
    beneath = model((coulomb, creep) if stated else (coulomb,))
    parts: Any = SimpleNamespace(fit=None)
    one_joint.decided_again(parts, beneath, first, 1, lambda _: None)
    assert seen[0].terms == (coulomb, creep)


@pytest.mark.parametrize(
    ("level", "coefficient", "name"),
    [(0.0, 0.013, "fluid_friction"), (0.0, 0.005, "dry_friction"), (0.01, 0.013, "dry_friction")],
)
def test_friction_that_drives_dry_to_zero_and_viscous_up_is_fluid(
    level: float, coefficient: float, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line through |v|^1.6 is below zero at rest, so the missing torque has the given step."""
    sizes = {"dry_friction": 0.09, "fluid_friction": 0.07}
    monkeypatch.setattr(nameless, "structure", lambda *a: Structure(sizes[a[3][0]], 0.6, 5.0))
    given: Any = SimpleNamespace(at=lambda _: model_of(VISCOUS, COULOMB).terms)
    now = model_of({**VISCOUS, "coefficient": coefficient}, {**COULOMB, "level": level})
    base = SimpleNamespace(model=SimpleNamespace(at=lambda _: now.terms))
    claim = replace(claim_of(Term("coulomb", 1, {}), 0.05), effect="unknown")
    found = replace(of_one_claim(claim, 0.06, 0.06, base), scale=0.1)
    parts: Any = SimpleNamespace(each=())
    named = nameless.by_its_variables(claim, found, parts, given)
    assert named.mechanism == name and named.most == (0.6 if name == "dry_friction" else 0.75)


@pytest.mark.parametrize(
    ("left", "share", "name"),
    [(0.001, 0.999, "dry_friction"), (0.01, 0.97, "dry_friction"), (0.01, 0.992, "dry_friction"),
     (0.01, 0.997, "fluid_friction")],
)  # fmt: skip
def test_a_friction_keeps_the_mechanism_of_a_law_that_no_function_of_the_other_far_surpasses(
    left: float, share: float, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dry friction over the place, of a period longer than the travel, was a fluid one; and a
    resistance of the cube of speed a dry one, though a drag left 2 to 5 % of its energy and all
    functions of the variables of dry friction 9 to 17 %. Coulomb friction of EMPS left 2.1 %, and a
    free function of the speed 1.8 %: it was a fluid friction.
    """
    sizes = {"dry_friction": 0.09, "fluid_friction": 0.09}
    monkeypatch.setattr(nameless, "structure", lambda *a: Structure(sizes[a[3][0]], share, 5.0))
    given: Any = SimpleNamespace(at=lambda _: model_of(VISCOUS, COULOMB).terms)
    base = SimpleNamespace(model=given)
    claim = replace(claim_of(Term("position_friction", 1, {}), 0.1), effect="unknown")
    found = of_one_claim(claim, 0.1, left, base)
    parts: Any = SimpleNamespace(each=())
    assert nameless.by_its_variables(claim, found, parts, given).mechanism == name


@pytest.mark.parametrize(
    ("sizes", "first"),
    [((0.01, 0.02, 0.03), "coulomb"), ((0.01, 0.3, 0.03), "hysteresis")],
)
def test_of_interchangeable_laws_the_one_found_first_is_named(
    sizes: tuple[float, ...], first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coulomb friction and bristles shared the missing torque, and its drift had been named
    instead.
    """
    terms = tuple(Term(e, 1, {}) for e in ("coulomb", "hysteresis", "friction_drift"))
    size = {t.effect: x for t, x in zip(terms, sizes, strict=True)}
    nothing: Any = None

    def alone(*of: Any) -> Piece:
        (term,) = of[4]
        return Piece("dry_friction", (term,), nothing, size[term.effect], nothing, 1.0)

    monkeypatch.setattr(laws, "piece_of", alone)
    whole = Piece("dry_friction", terms, nothing, 0.4, nothing, 1.0)
    ranked = laws._ranked(nothing, nothing, nothing, whole, nothing, 1)
    assert ranked[0].effects == (first,) and len(ranked) == 3


@pytest.mark.usefixtures("sizes_unasked")
def test_a_spring_that_the_model_takes_for_a_weight_is_one_finding(tmp_path: Path) -> None:
    """The weight that calibration takes away was a second one: "position 0 is where it stands
    upright, or the sign is wrong".
    """
    machine, rate = reality.Machine(spring=0.2), 250.0
    runs = [
        reality.save(
            tmp_path / f"{seed}.csv",
            reality.simulate(machine, reality.multisine(6.0, rate, seed), rate),
        )
        for seed in (1, 2)
    ]
    model = reality.model_file(tmp_path / "m.toml", rate, *reality.KNOWN, gravity=0.19)
    (found,) = diagnose(runs[0], model, runs[1], jobs=1).findings
    assert found.effect == "stiffness" and found.replaces == ("gravity",)
    assert found.parameters["coefficient"].value == pytest.approx(0.2, rel=0.01)
    assert "the given model's term gravity" in found.sentence
