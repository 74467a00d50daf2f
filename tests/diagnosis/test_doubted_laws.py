"""What speaks against a law that fits: a missing base law, a twin law, or too little motion."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from made_claims import claim_of, of_one_claim
from small_models import VISCOUS, data_of, model_of

from zendsp.diagnosis import engine
from zendsp.diagnosis.decide import absorbed, believed, patchwork, pushes, rivals
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.confidence import confidence, stated
from zendsp.diagnosis.decide.contract import Verdict, nameless, spans
from zendsp.diagnosis.decide.headline import verdict_sentence
from zendsp.diagnosis.decide.nameless import _hardly_varies, by_its_variables, told_apart
from zendsp.diagnosis.decide.rivals import _late_alike, _likelier, _of_alike, _shared
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import MEMORY, Structure
from zendsp.diagnosis.measure.where import Missing, energy, located
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model, Quantity, Term


def term(effect: str, **numbers: float) -> Term:
    return Term(effect, 1, {name: Quantity(value) for name, value in numbers.items()})


def fitted(terms: tuple[Term, ...], **std: float) -> Any:
    """A fit of terms, of which some numbers are so uncertain."""
    model = SimpleNamespace(terms=terms, at=lambda _: terms, joint_kind=lambda _: "revolute")
    free = [(i, key) for i, t in enumerate(terms) for key in std if key in t.parameters]
    handles = [SimpleNamespace(place="term", index=i, key=key) for i, key in free]
    fit = SimpleNamespace(model=model, handles=handles, std=[std[key] for _, key in free])
    record = SimpleNamespace(scale=SimpleNamespace(position=0.1))
    return SimpleNamespace(model=model, fit=fit, data=SimpleNamespace(records=[[record]]))


@pytest.mark.parametrize(("level", "count"), [(0.0, 1), (1e-4, 1), (0.004, 1), (0.03, 0)])
def test_a_stribeck_curve_without_coulomb_friction_is_only_some_curve_over_the_speed(
    level: float, count: int
) -> None:
    """With quadratic drag such a curve only imitates a torque with the cube of the speed. A sine of
    the speed was one that falls to an eighth (0.95; seed 902, case 113).
    """
    curve = term("stribeck", breakaway=0.03, velocity=4.4)
    at = (term("coulomb", level=level), curve, term("quadratic_drag", coefficient=0.0025))
    final: Any = SimpleNamespace(model=SimpleNamespace(at=lambda _: at))
    assert patchwork.stand_on_nothing(final, 1, 1.0) == (curve,) * count
    soft: Any = SimpleNamespace(model=SimpleNamespace(at=lambda _: (term("creep", speed=1e-5),)))
    assert not patchwork.stand_on_nothing(soft, 1, 1.0)  # it stands upon itself


def claim(effect: str, **numbers: float) -> Claim:
    sure, what = Evidence(100.0, 15.0, np.zeros(1)), term(effect, **numbers)
    return Claim(effect, mechanism_of(effect), what, 0.02, sure, 50.0, {}, (), (), ())


@pytest.mark.parametrize(
    ("was", "now", "std", "drawn"),
    [(0.01, 0.032, 2e-4, True), (0.01, 0.013, 2e-4, False), (0.03, 0.01, 2e-4, False),
     (0.01, 0.032, 0.01, False), (0.0, 0.032, 2e-4, False)],
)  # fmt: skip
def test_drag_that_needs_the_known_viscous_friction_to_grow_is_not_named(
    was: float, now: float, std: float, drawn: bool
) -> None:
    """v and v² together imitate |v|^1.5. A viscous friction that had absorbed a true drag shrinks
    beside it.
    """
    drag = term("quadratic_drag", coefficient=0.0025)
    final = fitted((term("viscous", coefficient=now), drag), coefficient=std)
    given: Any = SimpleNamespace(at=lambda _: (term("viscous", coefficient=was),))
    assert patchwork.makes_another_grow(given, final, drag) is drawn


@pytest.mark.parametrize(
    ("neutral", "std", "one"), [(0.102, 1e-4, True), (0.11, 1e-4, False), (0.11, 6e-3, True)]
)
def test_two_springs_with_one_neutral_point_are_one_hardening_spring(
    neutral: float, std: float, one: bool
) -> None:
    plain = claim("stiffness", coefficient=7.3, neutral=0.1)
    hard = claim("cubic_stiffness", coefficient=8.2, neutral=neutral)
    final = fitted((plain.term, hard.term), neutral=std)
    assert patchwork.both_needed(final, plain, hard) is one
    assert not patchwork.both_needed(final, plain, plain)
    assert not patchwork.both_needed(final, plain, wave("ripple", 20.0, 0.01))
    late, slow = claim("delay", time=2e-3), claim("lag", time_constant=3e-3)
    assert patchwork.both_needed(final, late, slow)
    unseen = replace(slow, evidence=Evidence(2.0, 0.9, np.zeros(1)), log_e=1.2)
    assert not patchwork.both_needed(final, late, unseen), "a lag took 1 ms of a delay of 4 ms"


def wave(effect: str, order: float, amplitude: float) -> Claim:
    return claim(effect, order=order, amplitude=amplitude, phase=0.3)


@pytest.mark.parametrize(
    ("order", "amplitude", "alike"),
    [(20.0, 2.72e-3, True), (20, 2.0e-3, False), (40, 2.7e-3, False)],
)
def test_two_mechanisms_with_the_same_wave_are_not_both_claimed(
    order: float, amplitude: float, alike: bool
) -> None:
    """Together they imitate a ripple of the torque constant."""
    first, other = (
        wave("transmission_error", 19.97, 2.74e-3),
        wave("sensor_harmonic", order, amplitude),
    )
    spring = Claim(
        "lag", "actuator", term("lag", time_constant=0.01), 0.1, first.evidence, 1, {}, (), (), ()
    )
    final = fitted((first.term, spring.term, other.term), order=0.1)
    twins = patchwork.twins((first, spring, other), final)
    assert [t.effect for t in twins] == ([first.effect, other.effect] if alike else [])
    assert not patchwork.twins((first, wave("transmission_error", 19.97, 2.74e-3)), final)


@pytest.mark.parametrize(
    ("order", "unsure", "travel", "twins"),
    [(1.19, 0.03, 4.0, 2), (2.0, 0.03, 4.0, 0), (1.05, 0.03, 4.0, 0), (2.4, 0.03, 6.0, 0)],
)
def test_waves_that_the_travel_cannot_tell_apart_are_twins_where_one_is_no_whole_number_a_turn(
    order: float, unsure: float, travel: float, twins: int
) -> None:
    """A torque that grew with place and speed squared was an eccentric encoder (65 %) beside a
    transmission's error, 1.19 and 1.13 times a turn (seeds 2013 and 1912).
    """
    disc = claim("encoder_eccentricity", amplitude=0.04, phase=3.0)
    other = wave("transmission_error", order, 0.015)
    final = fitted((disc.term, other.term), order=unsure)
    final.data.records[0][0].scale.position = travel
    assert len(patchwork.twins((disc, other), final)) == twins


@pytest.mark.parametrize(
    ("order", "unsure", "sure"), [(4.998, 0.003, 0.63), (4.998, 0.03, 0.46), (4.9, 0.003, 0.46)]
)
def test_a_wave_that_is_surely_a_whole_number_a_turn_is_likelier_real(
    order: float, unsure: float, sure: float
) -> None:
    """A wrong law has any order. A transmission's error of 3 % of the torque, right to its last
    digit, had been a refinement of 46 %.
    """
    term = Term(
        "transmission_error", 1,
        {k: Quantity(v) for k, v in {"order": order, "amplitude": 2e-3, "phase": 0.1}.items()},
    )  # fmt: skip
    base = fitted((term,), order=unsure)
    found = claim_of(term, 0.0327)
    decision = of_one_claim(found, 0.0327, 0.00627, base)
    assert confidence(found, decision) == pytest.approx(sure, abs=0.01)


def test_a_law_is_no_surer_where_less_is_known_of_what_it_leaves() -> None:
    """A Maxwell element was a hysteresis with 0.97, as the held-out part was too short to say that
    surely 0.9 % of the torque was left.
    """
    numbers = {"force": 0.031, "stiffness": 0.093, "exponent": 0.9}
    term = Term("hysteresis", 1, {key: Quantity(value) for key, value in numbers.items()})
    found = claim_of(term, 0.0638)
    known = of_one_claim(found, 0.0489, 0.0092)
    short = replace(known, bare=Size(0.0092, 0.0, 0.0225))
    assert confidence(found, short) <= confidence(found, known)
    assert not stated(found, short)


@pytest.mark.parametrize(
    ("state", "memory", "moved"),
    [
        (Structure(0.0, 0.0, 0.0), Structure(0.0, 0.0, 0.0), False),  # a push
        (Structure(0.1, 0.35, 3.3), Structure(0.0, 0.0, 0.0), True),  # position times speed²
        (Structure(0.0, 0.0, 0.0), Structure(0.04, 0.75, 2.35), True),  # what sloshes
        (Structure(0.0, 0.0, 0.0), Structure(0.05, 0.17, 1.66, 13.9), False),  # by chance
    ],
)
def test_what_the_motion_predicts_is_no_disturbance(
    state: Structure, memory: Structure, moved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def predicted(_data: Any, _model: Any, _joint: int, of: list[str], _turning: bool) -> Structure:
        return memory if of == [MEMORY] else state

    monkeypatch.setattr(pushes, "structure", predicted)
    as_calibrated = SimpleNamespace(model=None)
    pushed: Any = SimpleNamespace(
        final=as_calibrated, base=as_calibrated, joint=1, state=state, bursts=None
    )
    parts: Any = SimpleNamespace(each=())
    assert pushes.of_the_motion(pushed, parts, False) is moved
    pushed.base = pushed.state = None  # of another model what the state predicts is asked anew
    assert pushes.of_the_motion(pushed, parts, False) is moved


@pytest.mark.parametrize(
    ("inertia", "gravity", "both"),
    [(2.96, 4.8, True), (2.96, -4.8, False), (1.9, 9.0, False), (2.1, 2.1, False)],
)
def test_changes_of_inertia_and_weight_together_are_called_a_body(
    inertia: float, gravity: float, both: bool
) -> None:
    assert absorbed._both_far(inertia, gravity) is both


def test_a_complete_model_that_errs_more_than_the_sensor_says_what_it_leaves() -> None:
    shares = [(1, 0.015), (2, 0.0005)]
    assert nameless(shares, 66e-6, 0.27e-6) == ((1, 0.015),)
    assert not nameless(shares, 0.3e-6, 0.27e-6) and not nameless([(1, None)], None, 1.0)
    said = verdict_sentence("complete", [], left=[(1, 0.015)])
    assert said.startswith("Complete: no known effect") and "1.5 % of the torque of joint 1" in said


def test_disturbance_times_are_reported_with_their_recordings() -> None:
    times = [(1.0, 1.5), (2.0, 2.25), (7.0, 7.5)]
    assert spans(times, ["a", "b", "a"]) == "1.00–1.50 s, 7.00–7.50 s of a and 2.00–2.25 s of b"
    assert spans(times, ["", "", ""], 2) == "1.00–1.50 s, 2.00–2.25 s and 1 more"


def test_a_joint_gets_either_bristles_or_hysteresis() -> None:
    """Both at once are two Coulomb frictions whose levels cannot be separated."""
    one, other = get_effect("presliding"), get_effect("hysteresis")
    assert one.family == other.family and one.sole and other.sole


@pytest.mark.filterwarnings("error")
def test_a_recording_that_is_mostly_uninformative_counts_where_it_is_informative() -> None:
    std = np.array([np.inf, np.inf, np.inf, 1e-6, 1.0])
    lacks = Missing(np.arange(5.0), np.full(5, 2.0), std, {})
    square, counts = energy(lacks)
    assert counts.tolist() == [0, 0, 0, 1, 1] and square.tolist() == [0, 0, 0, 4.0 - 1e-12, 3.0]


def test_overlapping_times_of_two_joints_are_reported_once() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    lacks = np.where((time > 3.0) & (time < 3.5), 1.0, 0.0)

    def of(shift: int) -> Missing:
        torque = np.roll(lacks, shift)
        state = {name: np.sin(time) for name in ("position", "velocity", "acceleration", "command")}
        return Missing(time, torque, np.full_like(time, 0.01), state, recording="run")

    _, times, names = located({1: [of(0)], 2: [of(10)]})
    ((begin, end),) = times
    assert names == ("run",) and begin < 3.1 and end > 3.5


@pytest.mark.parametrize(("ratio", "small"), [(-0.0033, True), (0.0033, True), (-0.06, False)])
def test_no_torque_gain_within_half_a_percent_is_named(ratio: float, small: bool) -> None:
    """The remainder of a payload had left one at the wrist of a shipped arm."""
    gain = term("torque_gain", ratio=ratio)
    record: Any = SimpleNamespace(n=1)
    rounds: Any = SimpleNamespace(joint=1, data=SimpleNamespace(records=((record,),)))
    rival: Any = SimpleNamespace(scored=SimpleNamespace(model=SimpleNamespace(terms=(gain,))))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("zendsp.diagnosis.search.rounds.facts", lambda *_: None)
        assert Rounds.too_small(rounds, rival, gain) is small


@pytest.mark.parametrize(("unseen", "found"), [(0.0, True), (1.0, False)])
def test_an_inertia_that_unrecorded_commands_between_rows_can_explain_is_no_finding(
    unseen: float, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For a complete joint with a loop at 1 kHz, recorded at 125 Hz with a coarse encoder, an
    inertia 70 % larger had been claimed: it responds less to the commands between rows.
    """
    given, improved = model_of(VISCOUS), model_of(VISCOUS, inertia=0.017)
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, 500.0, 1), 500.0)
    data = data_of(columns, improved)
    (record,) = data.records[0]
    needed = float(np.std(0.017 * record.motion.states[2]))
    data = replace(data, records=((replace(record, between=unseen * needed),),))
    monkeypatch.setattr(absorbed, "_size", lambda *_: 0.1)
    monkeypatch.setattr(absorbed, "_held", lambda *_: given)
    search: Any = SimpleNamespace(joint=1)
    whole: Any = SimpleNamespace(improved=improved)
    claims = absorbed.shifted(given, search, whole, (), data)
    assert [f.effect for _, _, f in claims] == (["inertia"] if found else [])


@pytest.mark.parametrize(("unseen", "found"), [(0.0, True), (0.8, False)])
def test_nor_is_a_rotor_that_they_can_explain(
    unseen: float, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two rotors of a complete arm were "105 % and 51 % larger", where a loop of 500 Hz was
    recorded at 100 Hz behind 12 bits.
    """

    def rotor(amount: float) -> Model:
        return model_of(VISCOUS, {"kind": "inertia", "joint": 1, "amount": amount})

    given, improved = rotor(0.004), rotor(0.010)
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, 500.0, 1), 500.0)
    data = data_of(columns, improved)
    (record,) = data.records[0]
    needed = float(np.std(0.020 * record.motion.states[2]))
    data = replace(data, records=((replace(record, between=unseen * needed),),))
    monkeypatch.setattr(absorbed, "_size", lambda *_: 0.1)
    alone: Any = SimpleNamespace(joint=1, alone=SimpleNamespace(model=improved))
    whole: Any = SimpleNamespace(improved=improved)
    claims = absorbed._rotor(given, alone, whole, data)
    assert [f.effect for _, _, f in claims] == (["inertia"] if found else [])


@pytest.mark.parametrize(
    ("time", "std", "size", "found"),
    [
        (0.0012, 1e-6, 0.01, True),
        (0.0005, 1e-6, 0.01, False),  # a given lag is hardly better known
        (0.0012, 4e-4, 0.01, False),  # within three deviations
        (0.0012, 1e-6, 0.002, False),  # as much as simulators differ
        (0.0012, 1e-6, None, False),  # not surely better
    ],
)
def test_a_lag_that_has_taken_up_a_delay_is_a_finding(
    time: float, std: float, size: float | None, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A delay of 0.8 ms was "complete", since the given lag of 0.4 ms had become 1.2 ms."""

    def with_lag(value: float) -> Any:
        return model_of(VISCOUS, {"kind": "lag", "joint": 1, "time_constant": value})

    given, after = with_lag(0.0004), with_lag(time)
    lag = after.terms[-1]
    known = replace(lag.parameters["time_constant"], std=std)
    lag = replace(lag, parameters={"time_constant": known})
    after = after.with_terms((*after.terms[:-1], lag))
    monkeypatch.setattr(absorbed, "_size", lambda *_: size)
    decided: Any = SimpleNamespace(joint=1, alone=SimpleNamespace(model=after))
    whole: Any = SimpleNamespace(improved=after)
    test: Any = SimpleNamespace(records=())
    claims = absorbed.shifted(given, decided, whole, (), test)
    assert [(f.effect, f.indistinguishable) for _, _, f in claims] == [("lag", ("delay",))] * found
    assert not absorbed.shifted(given, decided, whole, ("delay",), test), "one finding of it"


@pytest.mark.parametrize(
    ("refines", "before", "kind"),
    [(True, 0.01, "unexplained"), (True, 0.0002, "complete"), (False, 0.01, "missing")],
)
def test_a_joint_whose_only_claim_may_be_nothing_says_that_something_is_left(
    refines: bool, before: float, kind: str
) -> None:
    """A constant torque of 0.04 % was a friction of 15.92 and 16.08 N m, which is no asymmetry; the
    report said "unexplained", and not what.
    """
    scored: Any = SimpleNamespace(deviance=0.0)
    left = Size(before, 0.9 * before, 1.1 * before)
    nothing = Structure(0.0, 0.0, 0.0)
    asymmetry = claim("coulomb_asymmetry", level_pos=15.92, level_neg=16.08)
    decided = Decision(
        1, Verdict.MISSING, (asymmetry,), (), scored, scored, left, left, nothing, left, scored, 1.0
    )
    refinement: Any = SimpleNamespace(effect="coulomb_asymmetry", joint=1)
    assert engine._unnamed(decided, (), (refinement,) * refines).kind == kind
    assert engine._unnamed(decided, (refinement,), (refinement,)) is decided


def test_a_law_of_another_mechanism_takes_the_place_of_one_that_it_is_far_likelier_than() -> None:
    """A joint without its rotor and its friction was a gain of -68 %, and its friction a third."""
    final: Any = SimpleNamespace(deviance=-51000.0)

    def rival(effect: str, deviance: float) -> Any:
        return SimpleNamespace(effect=effect, scored=SimpleNamespace(deviance=deviance))

    rivals = [rival("inertia", -72000.0), rival("load_friction", -60000.0)]
    scores = np.array([[0.0, 0.0], [-9000.0, -9000.0], [-4000.0, -4000.0]])
    assert _likelier(final, rivals, scores) is rivals[0].scored
    scores[1:] *= -1  # the recordings to choose by deny it
    assert _likelier(final, rivals, scores) is None
    assert _likelier(final, [rival("inertia", -51001.0)], -scores[:2]) is None  # hardly likelier


@pytest.mark.parametrize(
    ("counts", "rival", "behind", "alike"),
    [(0.0, "position_filter", 68.5, True), (1e-4, "position_filter", 68.5, False),
     (0.0, "saturation", 68.5, False), (0.0, "position_filter", 200.0, False)],
)  # fmt: skip
def test_beside_the_stated_counts_a_delay_and_a_filter_of_the_position_are_not_told_apart(
    counts: float, rival: str, behind: float, alike: bool
) -> None:
    """A filter behind the counts was a delay (0.97): what differed was noise (902, case 84)."""
    sensor = SimpleNamespace(resolution=(3.8e-4,))
    record = SimpleNamespace(joint=1, measurement=SimpleNamespace(resolution=counts))
    parts: Any = SimpleNamespace(choose=SimpleNamespace(records=[[record]]))
    given: Any = SimpleNamespace(sensor=sensor)
    late = term("delay", time=0.0034)
    assert _late_alike(parts, given, late, rival, behind, 4080.0) is alike


@pytest.mark.parametrize(
    ("rival", "apart", "alike"),
    [("lag", 0.0012, True), ("lag", 0.0065, False), ("saturation", 0.0012, False),
     ("column_shift", 0.0012, False)],
)  # fmt: skip
def test_what_comes_late_is_told_apart_only_by_more_than_other_steps_of_a_simulator(
    rival: str, apart: float, alike: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive's lag of 5 ms was a filter of the position (94 %, "cannot be told from": nothing):
    their torques differ by 0.12 %, where another integration differs by as much.
    """
    monkeypatch.setattr(rivals, "difference", lambda *_: apart)
    parts: Any = SimpleNamespace(choose=None)
    final: Any = SimpleNamespace(model=None)
    piece: Any = SimpleNamespace(mechanism="measurement")
    law: Any = SimpleNamespace(
        terms=(term("position_filter", time_constant=0.005),), evidence=SimpleNamespace(gain=7390.0)
    )
    other: Any = SimpleNamespace(effect=rival, joint=1, scored=final)
    assert rivals._by_other_steps(parts, final, piece, law, other, 74.0) is alike
    assert not rivals._by_other_steps(parts, final, piece, law, other, 4000.0)  # far less likely


@pytest.mark.parametrize(("sine", "behind"), [(0.0, True), (0.06, True), (0.0928, False)])
def test_a_load_that_follows_a_sine_in_time_is_no_doubted_spring(
    monkeypatch: pytest.MonkeyPatch, sine: float, behind: bool
) -> None:
    """A machine nearby shook a cart at 3 Hz, with 9.3 % of its torque: any load that swings at 3 Hz
    follows that.
    """
    monkeypatch.setattr(believed, "structure", lambda *_: Structure(0.0, 0.0, 0.0))
    monkeypatch.setattr(believed, "periodic", lambda *_: sine)
    parts: Any = SimpleNamespace(each=(), held=None)
    decision: Any = SimpleNamespace(
        joint=1,
        base=SimpleNamespace(model=None),
        before=SimpleNamespace(value=0.0937),
        after=SimpleNamespace(value=0.0486),
    )
    claim: Any = SimpleNamespace(effect="elasticity")
    assert believed._behind_a_transmission(claim, decision, parts) is behind


@pytest.mark.parametrize(("left", "stands"), [(0.08, False), (0.02, True)])
def test_a_mechanism_without_a_law_and_without_variables_leaves_little(
    left: float, stands: bool
) -> None:
    """A wave of the sensor without a law, of 16 % of the torque, was claimed with 93 % beside 8 %
    that stayed unexplained: it was an uneven transmission.
    """
    claim = replace(claim_of(term("sensor_harmonic"), 0.16), effect="unknown")
    decision = of_one_claim(claim, 0.18, left)
    nothing: Any = None
    assert told_apart(claim, decision, nothing, nothing, ()) is stands


@pytest.mark.parametrize(("neutral", "told"), [(0.0, True), (math.pi / 2, False)])
def test_a_mechanism_without_a_law_varies_with_its_variables(neutral: float, told: bool) -> None:
    """A wrist behind a gap had a "torque that depends on the position", 93 %, whose own figure drew
    a constant of 1.4 mN m.
    """
    weight = term("gravity", torque=0.1, angle=neutral)
    model, reference = model_of(VISCOUS), reality.multisine(4.0, reality.RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, reality.RATE), model)
    claim = replace(claim_of(weight, 0.003), effect="unknown")
    final: Any = SimpleNamespace(model=model)
    found = replace(of_one_claim(claim, 0.003, 0.0005), final=final)
    parts: Any = SimpleNamespace(each=(), test=data)
    assert told_apart(claim, found, parts, model, ()) is told


@pytest.mark.parametrize(("scale", "hardly"), [(1.0, True), (0.1, False)])
def test_a_constant_beside_a_torque_that_varies_by_much_speaks_against_nothing(
    scale: float, hardly: bool
) -> None:
    """A preloaded balancer, 63 % of a joint's torque and 21 % without its mean, was unexplained,
    though with a stiffness nothing stayed.
    """
    weight = term("gravity", torque=0.1, angle=0.5 * math.pi + 0.15)
    model, reference = model_of(VISCOUS), reality.multisine(4.0, reality.RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, reality.RATE), model)
    claim = replace(claim_of(weight, 0.5), effect="unknown")
    final: Any = SimpleNamespace(model=model)
    found = replace(of_one_claim(claim, 0.5, 0.0005), final=final, scale=scale)
    parts: Any = SimpleNamespace(each=(), test=data)
    assert _hardly_varies(claim, found, parts) is hardly


@pytest.mark.parametrize(
    ("beside", "left", "told"),
    [("cubic_stiffness", 0.005, True), ("coulomb", 0.005, False), ("cubic_stiffness", 0.02, False)],
)
def test_what_laws_of_one_mechanism_alone_draw_is_of_that_mechanism(
    beside: str, left: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gravity and a spring drew a ripple of half a wave in the travel beside a payload to 0.1 of
    2.8 %, and nothing was claimed: calibration had taken so much of it that functions of the
    position predicted nothing.
    """
    monkeypatch.setattr(
        "zendsp.diagnosis.decide.nameless.structure", lambda *_: Structure(0.0, 0.0, 0.0)
    )
    monkeypatch.setattr("zendsp.diagnosis.decide.nameless._hardly_varies", lambda *_: False)
    curve = replace(claim_of(term("gravity"), 0.034), effect="unknown")
    found = of_one_claim(curve, 0.028, left)
    more = claim_of(term(beside), 0.02)
    found = replace(found, base=SimpleNamespace(model=None), refinements=(more,))
    nothing: Any = SimpleNamespace(each=())
    assert told_apart(curve, found, nothing, nothing, ()) is told


@pytest.mark.parametrize(
    ("left", "of_state", "told"), [(0.005, 0.0, True), (0.015, 0.0, False), (0.005, 0.9, False)]
)
def test_a_friction_with_a_memory_is_known_by_what_its_laws_leave(
    left: float, of_state: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped planar arm has bristles, breakaway and a friction that varies along its travel:
    four laws explained 99 % of what was missing, no function of the state anything, and no physics
    was claimed. Of a pendulum with bristles it was called a fluid friction.
    """
    monkeypatch.setattr(
        "zendsp.diagnosis.decide.nameless.structure", lambda *_: Structure(0.0, 0.0, 0.0)
    )
    claim = replace(claim_of(term("presliding"), 0.059), effect="unknown")
    found = of_one_claim(claim, 0.048, left)
    found = replace(found, refinements=(claim_of(term("viscous"), 0.001),))
    found = replace(found, base=SimpleNamespace(model=None), state=Structure(0.04, of_state, 5.0))
    nothing: Any = SimpleNamespace(each=())
    assert told_apart(claim, found, nothing, nothing, ()) is told
    if told:
        assert by_its_variables(claim, found, nothing, nothing).mechanism == "dry_friction"


def test_the_named_law_is_among_the_laws_however_unlikely() -> None:
    """A lag that was named, and not told from a delay, had "laws": {"delay": 1.0}."""
    laws = _shared(["lag", "delay", "coulomb"], np.array([1e-4, 0.9, 0.0999]), "actuator")
    assert set(laws) == {"lag", "delay"} and laws["delay"] > 0.99
    assert sum(laws.values()) == pytest.approx(1.0)


def test_a_named_law_is_no_less_probable_than_one_that_it_cannot_be_told_from() -> None:
    """Nor does it take from a law whose torque is another, or that predicts worse."""
    of_alike = _of_alike(np.array([0.1, 0.6, 0.25, 0.05]), [False, True, False, True])
    assert of_alike.tolist() == pytest.approx([0.35, 0.35, 0.25, 0.05])
