"""What is claimed, and what is not: the decision on recordings that neither the fit nor any choice
has touched.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import laws, pieces
from zendsp.diagnosis.decide.claims import Claim, Decision, Known, Piece
from zendsp.diagnosis.decide.confidence import least_stated, stated
from zendsp.diagnosis.decide.naming import bent, left_over
from zendsp.diagnosis.decide.remember import remembered
from zendsp.diagnosis.decide.result import FitTable
from zendsp.diagnosis.measure import structure as measure_structure
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.report.figures import charts, law_chart, torque_chart
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Quantity, Term

RATE = 500.0
KNOWN = [reality.effect("viscous", coefficient=0.004), reality.effect("coulomb", level=0.03)]


def decided(
    folder: Path, fit: reality.Machine, held: reality.Machine | None = None, *effects: object
) -> Diagnosis:
    machines = ((fit, 9.0, 1), (held or fit, 12.0, 2))
    files = [
        reality.save(
            folder / f"run{seed}.csv",
            reality.simulate(m, reality.multisine(s, RATE, seed), RATE, seed),
        )
        for m, s, seed in machines
    ]
    model = reality.model_file(
        folder / "model.toml", RATE, *(effects or KNOWN), resolution=fit.resolution
    )
    return diagnose(files[0], model, files[1])


def test_what_only_the_recordings_of_the_fit_show_is_not_claimed(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(ripple=0.02), reality.Machine())
    assert d.findings == ()
    assert d.test is not None and d.test.improved <= d.test.calibrated


def test_a_look_alike_of_a_law_is_a_mechanism_without_one_or_unexplained(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(sticky=0.02))
    assert d.verdict in ("missing", "unexplained")
    assert all(f.effect == "unknown" and f.mechanism == "dry_friction" for f in d.findings), (
        d.findings
    )


def test_a_joint_that_only_turns_round_tells_no_function_of_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure_structure, "counted", lambda rec, *_: np.zeros(rec.n, bool))
    assert decided(tmp_path, reality.Machine()).verdict == "complete"


@pytest.mark.parametrize(("power", "law"), [(2.0, "quadratic_drag"), (3.0, "unknown")])
def test_a_law_is_named_where_a_neighbour_of_it_does_not_predict_better(
    power: float, law: str, tmp_path: Path
) -> None:
    """A resistance of the square of the speed, and of its cube."""
    d = decided(tmp_path, reality.Machine(drag=0.002, power=power))
    assert [(f.effect, f.mechanism) for f in d.findings] == [(law, "fluid_friction")]


@pytest.mark.parametrize("foreign", [{"swirl": 0.008}, {"blend": 0.005}])
def test_a_small_function_of_state_is_seen_and_gets_no_name_that_it_only_resembles(
    foreign: dict[str, float], tmp_path: Path
) -> None:
    d = decided(tmp_path, reality.Machine(**foreign))
    assert d.verdict in ("missing", "unexplained")
    assert all(f.effect == "unknown" for f in d.findings), d.findings


def test_a_function_of_state_is_seen_where_no_law_resembles_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decision, "sure", lambda *_: False)  # no law predicts any of it
    assert decided(tmp_path, reality.Machine(swirl=0.008)).verdict != "complete"


def test_a_mechanism_without_a_law_has_the_curve_of_its_torque_and_a_figure(tmp_path: Path) -> None:
    """swirl * sin(2 q̇): no law of the library."""
    d = decided(tmp_path, reality.Machine(swirl=0.02))
    (found,) = d.findings
    assert (found.effect, found.mechanism) == ("unknown", "fluid_friction")
    assert "depends on the speed of joint 1" in found.sentence
    curve = found.as_dict()["curve"]  # type: ignore[typeddict-item]
    assert (curve["variable"], curve["unit"]) == ("velocity", "rad/s")
    speed, torque = np.array(curve["at"]), np.array(curve["torque"])
    # calibration took up what resembles viscous and Coulomb friction
    true, given = 0.02 * np.sin(2 * speed), np.stack([speed, np.sign(speed)], 1)
    taken = given @ np.linalg.lstsq(given, true - torque, rcond=None)[0]
    assert np.corrcoef(torque, true - taken)[0, 1] > 0.9
    assert [c.name for c in charts(d) if c.section == "law"] == ["law_1_unknown_joint1"]


def test_several_mechanisms_without_any_law_are_one_torque(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def doubled(*arguments: Any) -> Decision:
        found = laws.believed(*arguments)
        other = [replace(c, mechanism="position_torque") for c in found.claims]
        return replace(found, claims=(*found.claims, *other))

    monkeypatch.setattr(decision, "believed", doubled)
    d = decided(tmp_path, reality.Machine(swirl=0.02))
    assert d.verdict != "complete" and len(d.findings) <= 1


def test_calibration_that_makes_untouched_recordings_worse_is_told() -> None:
    assert bent(FitTable(1e-4, 2e-4, 2e-4), 1e-5) and not bent(FitTable(1e-4, 1.2e-4, 1e-4), 1e-5)
    assert not bent(FitTable(1e-6, 1e-5, 1e-5), 1e-5), "both within the sensor's noise"


def test_what_acts_in_the_recordings_to_choose_by_alone_is_not_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decision, "_pushed", lambda *_: None)  # nothing of it comes again
    pushed = reality.Machine(push=(0.3, 2.0, 3.0))
    assert decided(tmp_path, reality.Machine(), pushed).verdict == "unexplained"


def test_the_tail_of_a_stribeck_curve_is_chosen(tmp_path: Path) -> None:
    """Tustin's exponential, where Armstrong-Hélouvry has a Gaussian."""
    d = decided(tmp_path, reality.Machine(breakaway=0.05, stribeck=0.4, tail=1.0))
    (found,) = d.findings
    assert found.effect == "stribeck" and found.parameters["exponent"].value == 1.0
    assert found.parameters["breakaway"].value == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("speed", [0.08, 0.3])
def test_all_friction_that_a_model_lacks_is_a_stribeck_curve_and_viscous(
    tmp_path: Path, speed: float
) -> None:
    """Coulomb friction and a drag are found first, and give way."""
    machine = reality.Machine(breakaway=0.06, stribeck=speed, tail=1.0)
    d = decided(tmp_path, machine, None, "")
    found = {f.effect: {n: q.value for n, q in f.parameters.items()} for f in d.findings}
    assert set(found) == {"stribeck", "viscous"}
    assert found["stribeck"]["breakaway"] == pytest.approx(0.06, rel=0.1)
    assert found["stribeck"]["velocity"] == pytest.approx(speed, rel=0.2)
    assert found["viscous"]["coefficient"] == pytest.approx(machine.viscous, rel=0.1)


def test_numbers_fitted_to_slow_motion_that_are_off_in_a_fast_one_are_no_missing_physics(
    tmp_path: Path,
) -> None:
    machine = reality.Machine(unrest=0.001)
    slow = reality.multisine(20.0, RATE, 1, size=0.1, low=0.05, high=0.2)
    runs = [
        reality.save(tmp_path / f"{k}.csv", reality.simulate(machine, reference, RATE, k))
        for k, reference in ((1, slow), (2, reality.multisine(12.0, RATE, 2)))
    ]
    model = reality.model_file(tmp_path / "model.toml", RATE, *KNOWN)
    d = diagnose(runs[0], model, runs[1])
    assert d.verdict == "complete"
    assert any("hardly determine the numbers" in note for note in d.notes), d.notes
    lacking = diagnose(runs[0], reality.model_file(tmp_path / "less.toml", RATE, KNOWN[0]), runs[1])
    assert lacking.verdict != "complete"


def test_what_acts_surely_and_drowns_in_what_stays_unexplained_is_not_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = reality.Machine(ripple=0.003)
    assert [f.effect for f in decided(tmp_path, machine).findings] == ["ripple"]
    monkeypatch.setattr(decision, "held_apart", lambda *a: ([], a[-1]))
    monkeypatch.setattr(decision, "_asked", lambda out, *_: out)
    assert decided(tmp_path, machine).verdict == "unexplained"
    assert decided(tmp_path, reality.Machine()).verdict == "complete"


def test_a_push_is_a_disturbance_with_its_times(tmp_path: Path) -> None:
    d = decided(
        tmp_path, reality.Machine(push=(0.06, 2.0, 4.0)), reality.Machine(push=(0.06, 8.0, 10.0))
    )
    assert [f.effect for f in d.findings] == ["disturbance"]
    # of the recording of the fit, then of the one held out
    spans = np.array(d.findings[0].numbers["intervals"])
    assert spans == pytest.approx(np.array([[2.0, 4.0], [8.0, 10.0]]), abs=0.2)
    rms, peak = (d.findings[0].parameters[name] for name in ("rms", "peak"))
    assert peak.value == pytest.approx(0.06, rel=0.3) and 0.0 < peak.std < 0.02
    assert rms.value <= peak.value and 0.0 < rms.std < 0.02


@pytest.mark.parametrize("push", [0.01, 0.15])
def test_a_push_in_the_recording_of_the_fit_alone_is_told_though_it_bends_the_calibration(
    push: float, tmp_path: Path
) -> None:
    d = decided(tmp_path, reality.Machine(push=(push, 4.0, 6.0)), reality.Machine())
    assert [f.effect for f in d.findings] == ["disturbance"]
    spans = np.array(d.findings[0].numbers["intervals"])
    assert spans == pytest.approx(np.array([[4.0, 6.0]]), abs=0.2)
    assert d.test is not None and d.test.improved < 1.2 * d.test.given
    (panel,) = torque_chart(d, 1).panels  # on the same clock
    lacking = panel.series[0]
    there = lacking.x[np.abs(lacking.y) > 0.5 * np.max(np.abs(lacking.y))]
    assert there == pytest.approx(5.0, abs=1.2)


def test_several_pushes_in_the_recording_of_the_fit_alone_are_told(tmp_path: Path) -> None:
    pushed = reality.Machine(push=(0.03, 1.5, 2.2, 4.0, 4.6, 6.5, 7.3))
    (found,) = decided(tmp_path, pushed, reality.Machine()).findings
    assert found.effect == "disturbance"
    spans = np.array(found.numbers["intervals"])
    assert spans == pytest.approx(np.array([[1.5, 2.2], [4.0, 4.6], [6.5, 7.3]]), abs=0.2)


@pytest.mark.parametrize("size", [0.06, 0.15])
def test_a_push_through_most_of_what_is_judged_on_leaves_nothing_beside_it(
    size: float, tmp_path: Path
) -> None:
    d = decided(
        tmp_path,
        reality.Machine(push=(size, 3.0, 6.0)),
        reality.Machine(push=(size, 6.0, 9.5 if size > 0.1 else 10.8)),
    )
    assert [f.effect for f in d.findings] == ["disturbance"]
    assert d.unexplained == ""


@pytest.mark.parametrize("held", [False, True])
def test_a_push_while_the_joint_turns_round_is_told_with_its_recording(
    tmp_path: Path, held: bool
) -> None:
    """It holds the joint for all of its time, with more than friction does."""
    pushed, quiet = reality.Machine(push=(0.3, 4.0, 5.0), kp=1.0), reality.Machine(kp=1.0)
    d = decided(tmp_path, *((quiet, pushed) if held else (pushed, quiet)))
    (found,) = d.findings
    assert found.effect == "disturbance"
    assert {Path(name).name for name in found.numbers["recordings"]} == {f"run{1 + held}.csv"}
    assert f"of {tmp_path}/run{1 + held}.csv" in found.sentence


def test_what_lacks_beside_a_push_is_found_where_nothing_pushes(tmp_path: Path) -> None:
    """The push is cut out, and the rest diagnosed again: it had bent all numbers."""
    law = {"breakaway": 0.04, "stribeck": 0.8}
    d = decided(tmp_path, reality.Machine(push=(0.2, 4.0, 5.0), **law), reality.Machine(**law))
    assert [f.effect for f in d.findings] == ["disturbance", "stribeck"]
    assert d.findings[1].parameters["breakaway"].value == pytest.approx(0.04, rel=0.03)
    ((begin, end),) = d.findings[0].numbers["intervals"]
    assert (begin, end) == (pytest.approx(4.0, abs=0.15), pytest.approx(5.0, abs=0.15))


def test_a_push_beside_what_is_found_is_told(tmp_path: Path) -> None:
    """Dry friction is missing too: it is the finding, and the push stands in what is left."""
    pushed = reality.Machine(push=(0.08, 4.0, 6.0))
    d = decided(tmp_path, pushed, reality.Machine(), KNOWN[0])
    assert [f.effect for f in d.findings] == ["coulomb"]
    assert re.search(r"acts at (3\.9|4\.0)\d–(5\.9|6\.[01])\d s of \S+run1.csv that", d.unexplained)
    alone = decided(tmp_path, reality.Machine(), None, KNOWN[0])
    assert "push" not in alone.unexplained


def test_one_mechanism_is_one_finding(tmp_path: Path) -> None:
    d = decided(tmp_path, reality.Machine(breakaway=0.05), None, KNOWN[0])
    assert [f.mechanism for f in d.findings] == ["dry_friction"]


def test_complete_says_what_would_have_been_seen_and_an_effect_of_twice_that_is_named(
    tmp_path: Path,
) -> None:
    d = decided(tmp_path, reality.Machine())
    assert d.verdict == "complete"
    ripple = next(x for x in d.detectable if x.effect == "ripple")
    assert 0 < ripple.size < 0.01
    again = decided(tmp_path, reality.Machine(ripple=2 * ripple.size))
    assert [f.effect for f in again.findings] == ["ripple"]


def test_friction_that_differs_with_the_direction_is_friction_and_a_constant_by_algebra(
    tmp_path: Path,
) -> None:
    machine = reality.Machine(push=(0.012, 0.0, 99.0))
    d = decided(tmp_path, machine, None, KNOWN[0])
    found = {f.effect: f.indistinguishable for f in d.findings}
    assert set(found) == {"coulomb", "torque_offset"}
    assert all("coulomb_asymmetry" in same for same in found.values())


def test_a_law_is_told_beside_what_the_machine_is_known_to_leave(tmp_path: Path) -> None:
    """The model file of one diagnosis says it to the next."""
    before = decided(tmp_path, reality.Machine(unrest=0.006))
    assert before.verdict == "complete" and before.improved.discrepancy.torque[0] > 0.003
    sprung = reality.Machine(unrest=0.006, spring=0.06)
    plain = decided(tmp_path, sprung)
    assert [f.effect for f in plain.findings] == ["unknown"]
    again = diagnose(
        tmp_path / "run1.csv",
        parse_model(tomllib.loads(model_text(before.improved))),
        tmp_path / "run2.csv",
    )
    assert [f.effect for f in again.findings] == ["stiffness"]
    assert again.findings[0].parameters["coefficient"].value == pytest.approx(0.06, rel=0.05)


@pytest.mark.parametrize(("known", "verdict"), [("", "missing"), (", std = 0.002", "complete")])
def test_calibration_may_move_a_number_as_far_as_the_model_file_says_that_it_is_known(
    known: str, verdict: str, tmp_path: Path
) -> None:
    """Given a quarter too large."""
    decided(tmp_path, reality.Machine())
    model = reality.model_file(tmp_path / "rough.toml", RATE, *KNOWN, inertia=0.0125)
    text = model.read_text().replace("value = 0.0125", f"value = 0.0125{known}")
    model.write_text(text)
    d = diagnose(tmp_path / "run1.csv", model, tmp_path / "run2.csv")
    assert (d.verdict, [f.effect for f in d.findings]) == (
        verdict,
        ["inertia"] if verdict == "missing" else [],
    )


@pytest.mark.parametrize(("size", "claims"), [(0.021, True), (0.019, False)])
def test_what_is_not_twice_what_a_machine_is_known_to_leave_may_be_a_part_of_it(
    monkeypatch: pytest.MonkeyPatch, size: float, claims: bool
) -> None:
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.0, 0.0, 0.0))
    monkeypatch.setattr(pieces, "structure", lambda *_: Structure(0.0, 0.0, 0.0))
    monkeypatch.setattr(pieces, "kept_laws", lambda *_: [])
    monkeypatch.setattr(pieces, "_rubbing", lambda *_: [])
    monkeypatch.setattr(pieces, "known_discrepancy", lambda *_: Known(0.01, 0.01))
    parts = SimpleNamespace(test=SimpleNamespace(joints=1), each=())
    one = piece(size, 5.0, 20.0)
    search, final = SimpleNamespace(joint=1), SimpleNamespace(model=None)
    claimed, _ = pieces.held_apart(parts, None, search, final, [one])  # type: ignore[arg-type]
    assert claimed == ([one] if claims else [])


def test_what_only_refined_the_fit_is_held_in_the_model_file() -> None:
    """Of two terms of one effect the second; not what stands for a term of the given model."""
    terms = [
        make_term(get_effect(name), 1, {key: 1.0})
        for name, key in (("coulomb", "level"), ("ripple", "amplitude"), ("ripple", "amplitude"))
    ]
    given = parse_model({"mechanism": {"kind": "rotary", "parameters": {"inertia": 1.0}}})
    final: Any = SimpleNamespace(model=given.with_terms(tuple(terms)))
    no, evidence = Structure(0.0, 0.0, 0.0), Evidence(1.0, 1.0, np.zeros(1))
    claims = [
        Claim(t.effect, "", t, 0.1, evidence, 1.0, {}, (), (), ()) for t in (terms[1], terms[2])
    ]
    left = Size(0.02, 0.01, 0.02)
    outcome = Decision(
        1, "missing", (claims[0],), (claims[1],), final, final, left, left, no, left, final, 5.0
    )
    model = remembered(given.with_terms(tuple(replace(t) for t in terms)), given, [outcome])
    assert [any(q.free for q in t.parameters.values()) for t in model.terms] == [True, True, False]
    assert model.discrepancy.torque == (0.1,)


def piece(size: float, z: float, log_e: float, effect: str = "ripple") -> Piece:
    term = Term(effect, 1, {})
    evidence = Evidence(gain=2 * log_e, z=z, blocks=np.zeros(1))
    without = SimpleNamespace(model=None, deviance=100.0)
    return Piece(mechanism_of(effect), (term,), without, size, evidence, log_e)  # type: ignore[arg-type]


@pytest.mark.parametrize(("apart", "curve"), [(0.2, True), (5.0, False)])
def test_two_ripples_that_the_travel_does_not_tell_apart_are_one_that_fades(
    apart: float, curve: bool
) -> None:
    """Over 3 rad: a fifth of a wave apart, and more than two."""
    found = [
        replace(p, terms=(Term("ripple", 1, {"order": Quantity(order)}),))
        for p, order in ((piece(0.1, 5.0, 20.0), 12.0), (piece(0.1, 5.0, 20.0), 12.0 + apart))
    ]
    assert laws._is_curve(found, 3.0) is curve


@pytest.mark.parametrize(
    ("turning", "softer", "claims"), [(0.8, 20.0, False), (0.8, 5.0, True), (0.2, 20.0, True)]
)
def test_what_acts_where_a_joint_turns_round_is_more_than_its_dry_friction_may_be_wrong_by(
    monkeypatch: pytest.MonkeyPatch, turning: float, softer: float, claims: bool
) -> None:
    """A lag of 0.4 % beside dry friction of 20 %, whose law is good to 3 % of that, where bristles
    gain a part of the hundred that the lag gains.
    """
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.0025, 0.0, 0.01))
    monkeypatch.setattr(pieces, "structure", lambda *_: Structure(0.0, 0.0, 0.0))
    monkeypatch.setattr(pieces, "kept_laws", lambda *_: [])
    monkeypatch.setattr(pieces, "known_discrepancy", lambda *_: Known())
    monkeypatch.setattr(pieces, "at_reversals", lambda *_: turning)
    monkeypatch.setattr(pieces, "difference", lambda *_: 0.2)
    friction = Term("coulomb", 1, {})
    model = SimpleNamespace(terms=(friction,), at=lambda _: (friction,), with_terms=lambda _: None)
    parts = SimpleNamespace(test=SimpleNamespace(joints=1), each=())
    lag = piece(0.004, 5.0, 50.0, "lag")
    bristles = SimpleNamespace(effect="presliding", value=100.0 - softer)
    search = SimpleNamespace(joint=1, base=SimpleNamespace(deviance=100.0), tried=[bristles])
    final = SimpleNamespace(model=model, deviance=0.0)
    claimed, rest = pieces.held_apart(parts, None, search, final, [lag])  # type: ignore[arg-type]
    assert (claimed, rest) == (([lag], []) if claims else ([], [lag]))


@pytest.mark.parametrize(
    ("effect", "size", "left", "named"),
    [
        ("coulomb", 0.007, 0.008, True),  # what every machine has
        ("dead_zone", 0.02, 0.01, False),  # a function of the state, as others may be
        ("dead_zone", 0.02, 0.0, True),  # and nothing is left that speaks against it
        ("elasticity", 0.02, 0.01, True),  # no function of the state
        ("gain_drift", 0.02, 0.005, True),  # over time: no function of the state resembles it
    ],
)
def test_a_law_is_named_where_what_it_leaves_allows_no_other(
    effect: str, size: float, left: float, named: bool
) -> None:
    outcome = of_one_claim(Term(effect, 1, {}), size, 0.025, left)
    assert stated(outcome.claims[0], outcome) is named


def of_one_claim(term: Term, size: float, before: float, left: float) -> Decision:
    evidence = Evidence(100.0, 15.0, np.zeros(1))
    effect = term.effect
    claim = Claim(effect, mechanism_of(effect), term, size, evidence, 50.0, {}, (), (), ())
    after = Size(left, left, left)
    return Decision(
        1,
        "missing",
        (claim,),
        (),
        None,
        None,
        Size(before, before, before),
        after,
        Structure(0.0, 0.0, 0.0),
        after,
        None,
        1.0,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("effect", ["stiffness", "ripple", "torque_gain"])
def test_what_is_said_to_be_seen_is_as_large_as_what_is_named(effect: str) -> None:
    term = make_term(get_effect(effect), 1, {})
    least = least_stated(effect, of_one_claim(term, 0.0, 0.02, 0.02))
    assert least >= 0.02
    for size, named in ((1.02 * least, True), (0.98 * least, least == 0.02)):
        outcome = of_one_claim(term, size, size, 0.02)
        assert stated(outcome.claims[0], outcome) is named


@pytest.mark.parametrize(("size", "stands"), [(0.02, True), (0.005, False)])
def test_a_law_that_is_not_believed_leaves_its_mechanism_where_it_explains_more_than_it_leaves(
    size: float, stands: bool
) -> None:
    evidence = Evidence(50.0, 4.0, np.zeros(1))
    claim = Claim("lag", "actuator", Term("lag", 1, {}), size, evidence, 25.0, {}, (), (), ())
    left = Size(0.01, 0.009, 0.011)
    before = Size(0.1, 0.09, 0.11)
    nothing = Structure(0.0, 0.0, 0.0)
    outcome = laws.believed(
        Decision(1, "missing", (claim,), (), None, None, before, left, nothing, left, None, 1.0),  # type: ignore[arg-type]
        None,  # type: ignore[arg-type]
        1,
    )
    assert [c.effect for c in outcome.claims] == (["unknown"] if stands else [])
    assert len(outcome.refinements) == (not stands)


@pytest.mark.parametrize(("moving", "stands"), [(0.0, False), (0.008, True)])
def test_how_a_known_friction_turns_round_is_no_missing_mechanism(
    monkeypatch: pytest.MonkeyPatch, moving: float, stands: bool
) -> None:
    monkeypatch.setattr(laws, "structure", lambda *_, turning: Structure(moving, 0.6, 5.0))
    friction = Term("coulomb", 1, {})
    base = SimpleNamespace(model=SimpleNamespace(at=lambda _: (friction,)))
    term, evidence = Term("presliding", 1, {}), Evidence(50.0, 4.0, np.zeros(1))
    claim = Claim("presliding", "dry_friction", term, 0.01, evidence, 25.0, {}, (), (), ())
    left, before, nothing = Size(0.008, 0.007, 0.009), Size(0.012, 0.011, 0.013), Structure(0, 0, 0)
    outcome = laws.believed(
        Decision(1, "missing", (claim,), (), base, None, before, left, nothing, left, None, 1.0),  # type: ignore[arg-type]
        SimpleNamespace(each=()),  # type: ignore[arg-type]
        1,
    )
    assert [c.effect for c in outcome.claims] == (["unknown"] if stands else [])


def test_only_what_untouched_recordings_bear_out_by_chance_too_rarely_is_claimed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.01, 0.0, 0.02))
    monkeypatch.setattr(pieces, "structure", lambda *_: Structure(0.01, 0.5, 1.0))
    monkeypatch.setattr(pieces, "kept_laws", lambda *_: [])
    monkeypatch.setattr(pieces, "known_discrepancy", lambda *_: Known())
    monkeypatch.setattr(pieces, "_rubbing", lambda *_: [])
    parts = SimpleNamespace(test=SimpleNamespace(joints=1), each=())
    final = SimpleNamespace(model=None)
    sure = piece(0.1, 5.0, 20.0)
    unlikely = piece(0.1, 5.0, 3.0)
    uneven = piece(0.1, 1.0, 20.0)
    small = piece(0.005, 5.0, 20.0)
    claimed, rest = pieces.held_apart(
        parts,  # type: ignore[arg-type]
        None,  # type: ignore[arg-type]
        SimpleNamespace(joint=1),  # type: ignore[arg-type]
        final,  # type: ignore[arg-type]
        [sure, unlikely, uneven, small],
    )
    assert claimed == [sure] and rest == [unlikely, uneven, small]


@pytest.mark.parametrize(
    ("effect", "size", "claims"),
    [("elasticity", 0.002, False), ("elasticity", 0.003, True), ("ripple", 0.002, True)],
)
def test_what_another_integration_step_makes_is_no_spring(
    effect: str, size: float, claims: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.0001, 0.0, 0.01))
    monkeypatch.setattr(pieces, "structure", lambda *_: Structure(0.0, 0.0, 0.0))
    monkeypatch.setattr(pieces, "kept_laws", lambda *_: [])
    monkeypatch.setattr(pieces, "known_discrepancy", lambda *_: Known())
    monkeypatch.setattr(pieces, "_rubbing", lambda *_: [])
    parts = SimpleNamespace(test=SimpleNamespace(joints=1), each=())
    one = piece(size, 5.0, 20.0, effect)
    search, final = SimpleNamespace(joint=1), SimpleNamespace(model=None)
    claimed, _ = pieces.held_apart(parts, None, search, final, [one])  # type: ignore[arg-type]
    assert claimed == ([one] if claims else [])


def test_what_a_mechanism_is_worth_is_asked_of_the_recordings_to_test_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[object] = []
    term = Term("ripple", 1, {})
    final = SimpleNamespace(model=None)

    def ask(data: object, *_: object) -> Piece:
        asked.append(data)
        return piece(0.1, 0.0, 0.0)

    monkeypatch.setattr(decision, "worth_choosing", lambda *_: final)
    monkeypatch.setattr(decision, "discrepancy", lambda *_: None)
    monkeypatch.setattr(decision, "new_terms", lambda *_: [term])
    monkeypatch.setattr(decision, "grouped", lambda *_: {("position_torque", 0): (term,)})
    monkeypatch.setattr(decision, "piece_of", ask)
    monkeypatch.setattr(decision, "held_apart", lambda *_: ([], []))
    monkeypatch.setattr(decision, "_nothing_named", lambda *_: "nothing")
    parts = SimpleNamespace(fit="fit", choose="choose", test="test")
    search = SimpleNamespace(joint=1, base=SimpleNamespace(model=None))
    outcome = decision.decide(parts, None, search, 1, lambda _: None)  # type: ignore[arg-type]
    assert outcome == "nothing" and asked == ["test"]


@pytest.mark.parametrize(
    ("size", "z", "much"),
    [(0.1, 9.0, True), (0.1, 2.0, False), (0.05, 9.0, False), (0.052, 9.0, False)],
)
def test_a_law_leaves_too_much_only_where_that_is_sure(size: float, z: float, much: bool) -> None:
    """Of 5 % that are allowed; the evidence is that for what is beyond them."""
    assert laws._surely_more(Structure(size, 0.5, z), 0.05) is much


@pytest.mark.parametrize(("after", "stands"), [(0.2, True), (0.6, False), (2.5e8, False)])
def test_what_leaves_more_unexplained_than_there_was_or_is_at_all_is_no_finding(
    monkeypatch: pytest.MonkeyPatch, after: float, stands: bool
) -> None:
    """A spring that holds a joint where it was seen follows every recording."""
    before = Size(0.5, 0.4, 0.6) if after < 1.0 else Size(3.6e9, 2e9, 5e9)
    left = Size(after, after, after)
    term, evidence = Term("stiffness", 1, {}), Evidence(50.0, 9.0, np.zeros(1))
    claim = Claim("stiffness", "position_torque", term, 9.0, evidence, 25.0, {}, (), (), ())
    nothing = Structure(0.0, 0.0, 0.0)
    model: Any = SimpleNamespace(at=lambda _: (), torque_unit=lambda _: "N m")
    one: Any = SimpleNamespace(model=model)
    found = Decision(1, "missing", (claim,), (), one, one, before, left, nothing, left, one, 7.0)
    monkeypatch.setattr(decision, "worth_choosing", lambda *_: one)
    monkeypatch.setattr(decision, "discrepancy", lambda *_: before)
    monkeypatch.setattr(decision, "new_terms", lambda *_: [term])
    monkeypatch.setattr(decision, "grouped", lambda *_: {("position_torque", 0): (term,)})
    monkeypatch.setattr(decision, "piece_of", lambda *_: piece(0.1, 9.0, 50.0, "stiffness"))
    monkeypatch.setattr(decision, "held_apart", lambda *_: ([0], []))
    monkeypatch.setattr(decision, "named", lambda *_: found)
    monkeypatch.setattr(decision, "believed", lambda d, *_: d)
    monkeypatch.setattr(decision, "window_error", lambda *_: np.zeros(3))
    monkeypatch.setattr(decision, "_beside", lambda *_: None)
    other: Any = SimpleNamespace(claims=())
    monkeypatch.setattr(decision, "_nothing_named", lambda *_: other)
    parts = SimpleNamespace(fit=None, choose=None, test=None)
    search = SimpleNamespace(joint=1, base=one)
    outcome = decision.decide(parts, None, search, 1, lambda _: None)  # type: ignore[arg-type]
    assert outcome.claims is (found if stands else other).claims
    if after > 1.0:
        words = left_over([found], model)
        assert "does not follow" in words and "%" not in words


def test_the_figure_of_a_friction_over_position_shows_its_law(tmp_path: Path) -> None:
    """Both directions of travel, one turned over: their mean would hide what was found."""
    d = decided(tmp_path, reality.Machine(uneven=0.01))
    (found,) = d.findings
    assert found.effect == "position_friction" and d.workings is not None
    panel = law_chart(d, d.workings, found, 0).panels[0]
    means = next(series for series in panel.series if series.kind == "means")
    assert "against the motion" in panel.ylabel
    amplitude = found.parameters["amplitude"].value
    assert np.max(means.y) == pytest.approx(amplitude, rel=0.2)
    assert np.corrcoef(means.y, np.sin(7 * means.x))[0, 1] > 0.95  # it resists
