"""What the report says that these recordings would have shown, and what not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
import small_models
from small_models import model_of

from zendsp.diagnosis import Diagnosis, diagnose, engine
from zendsp.diagnosis.decide import detectable as sizes
from zendsp.diagnosis.decide import implants
from zendsp.diagnosis.decide.claims import Near
from zendsp.diagnosis.decide.detectable import detectable
from zendsp.diagnosis.decide.findings import Estimate, Finding
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.report.html import _could_not
from zendsp.diagnosis.report.missed import missed
from zendsp.diagnosis.report.summary import hidden as hidden_words
from zendsp.diagnosis.report.summary import summary
from zendsp.diagnosis.search.screen import FIRST_ORDER
from zendsp.diagnosis.transmission.detectable import ASKED
from zendsp.physics.calibration.handles import get_values
from zendsp.physics.calibration.terms import grid_of, make_term
from zendsp.physics.effects import get_effect, library
from zendsp.physics.model import Quantity, Term

Decided = Callable[..., Diagnosis]


@pytest.fixture
def sizes_unasked() -> None:
    """They are asked for here."""


@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(
    ("number", "none", "effect"),
    [
        ("ripple", 0.0, "ripple"),
        ("breakaway", reality.Machine.coulomb, "stribeck"),
        ("fade", 0.0, "gain_drift"),
    ],
)
def test_twice_the_size_that_complete_states_as_detectable_is_named(
    number: str, none: float, effect: str, decided: Decided
) -> None:
    d = decided(reality.Machine())
    assert d.verdict == "complete"
    told = next(x for x in d.detectable if x.effect == effect)
    assert 0 < told.size < 0.1
    again = decided(reality.Machine(**{number: none + 2 * told.size}))
    assert [f.effect for f in again.findings] == [effect]


@pytest.mark.usefixtures("searched_once", "sizes_unasked")
def test_a_drift_with_the_least_time_constant_that_a_size_is_stated_for_is_named(
    decided: Decided, seconds: tuple[float, float]
) -> None:
    """Eight drifts of 2 s in 20 s of recording, two and a half times as large as stated, were
    "complete": such a time constant was at its limit, where a law counts as none.
    """
    least = min(get_effect("gain_drift").grid["time_constant"]) * seconds[0]
    (found,) = decided(reality.Machine(fade=0.05, fading=least)).findings
    assert found.effect == "gain_drift"
    assert found.parameters["time_constant"].value == pytest.approx(least, rel=0.1)


def test_a_size_of_a_cubic_spring_is_that_of_the_worst_neutral_point_of_the_travel() -> None:
    """About the middle between two of three neutral points 1.3 times the stated size was too small
    to be told, and "complete".
    """
    model = model_of(small_models.VISCOUS, small_models.COULOMB)
    motion = reality.multisine(6.0, reality.RATE, 3) + np.linspace(0.0, 0.4, int(6 * reality.RATE))
    data = small_models.data_of(reality.simulate(reality.Machine(), motion, reality.RATE), model)
    decision: Any = SimpleNamespace(joint=1, final=calibrate_joint(data, model, 1, 1))
    found, screen = sizes._screened(data, decision, 1)
    traces = sizes._Traces(screen, found, screen, found, ())
    told = sizes._smallest(traces, "cubic_stiffness", 0.0, 0.001)
    assert told is not None
    effect, record = get_effect("cubic_stiffness"), screen.records[0]
    at = [point["neutral"] for point in grid_of(effect, record, model)]
    columns = [
        traces.of(make_term(effect, 1, {"coefficient": 1.0, "neutral": float(place)}))
        for place in np.linspace(min(at), max(at), 33)
    ]
    needed = [sizes.AMPLE * 0.001 / sizes._torque(screen, column) for column in columns]
    assert told.value("coefficient") >= 0.9 * max(needed)


def _travels(far: float) -> Any:
    return SimpleNamespace(joint=1, _facts=SimpleNamespace(scale=SimpleNamespace(position=far)))


@pytest.mark.usefixtures("searched_once")
def test_a_size_is_stated_only_where_a_search_may_end_and_upon_what_it_needs(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A size was stated of a ripple with fewer periods in the travel than a search takes, of a
    friction with less than one, which is a curve without a law, and of a Stribeck curve upon a
    friction with which no search tried one.
    """
    limits = {"order": (20.0, math.inf), "time_constant": (0.6, 30.0)}
    monkeypatch.setattr(
        sizes, "parameter_bounds", lambda _, name, record: limits.get(name, (-math.inf, math.inf))
    )
    monkeypatch.setattr(sizes, "is_supported", lambda effect, had: effect.name != "stribeck")
    d = decided(reality.Machine())
    at = {x.effect: x.at for x in (*d.detectable, *d.undetectable)}
    assert at["ripple"]["order"] >= 20.0
    assert at["gain_drift"]["time_constant"] > 0.6 * 1.02
    uneven, record = get_effect("position_friction"), _travels(2.0)
    assert [sizes._is_named(uneven, {"period": p}, record) for p in (1.9, 2.1)] == [True, False]
    assert "stribeck" in {x.effect for x in d.undetectable}
    assert {"ripple", "gain_drift", "dead_zone"} <= {x.effect for x in d.detectable}


@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize("late", [0.02, 0.2])
def test_no_delay_is_said_to_be_missed_below_a_time_that_no_fit_reaches(
    late: float, decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a KUKA a delay of 0.2 s "may have been missed"."""
    monkeypatch.setattr(implants.Implant, "seen", lambda *_: (late, 0.1))
    told = {x.effect for x in decided(reality.Machine()).detectable}
    assert ("delay" in told) is (late < FIRST_ORDER)


@pytest.mark.usefixtures("searched_once")
def test_no_smaller_lateness_is_promised_than_the_clock_lets_one_name(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A delay of 0.22 rows was unexplained where 0.15 rows were said to be seen."""
    monkeypatch.setattr(implants.Implant, "seen", lambda *_: (1e-6, 1e-4))
    told = {x.effect: x for x in decided(reality.Machine()).detectable}
    for late in ("lag", "delay"):
        assert told[late].size == pytest.approx(0.3 / reality.RATE)
        assert told[late].share == pytest.approx(1e-4 * told[late].size / 1e-6)
    assert told["ripple"].size == pytest.approx(1e-6)


@pytest.mark.usefixtures("searched_once")
def test_the_fit_of_a_larger_implant_begins_from_that_of_the_smaller_one(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits: list[Any] = []
    fit_scored = implants.fit_scored

    def noted(data: Any, model: Any, handles: Any, *rest: Any, **more: Any) -> Any:
        out = fit_scored(data, model, handles, *rest, **more)
        fits.append((model.terms[-1], get_values(model, handles), get_values(out.model, handles)))
        return out

    monkeypatch.setattr(implants, "fit_scored", noted)
    decided(reality.Machine())
    given: dict[str, Any] = {}
    for term, begun, _ in fits:
        given.setdefault(term.effect, begun)
    larger = 0
    for (small, _, ended), (large, begun, _) in pairwise(fits):
        key = implants.size_of(get_effect(small.effect))
        if small.effect == large.effect and large.value(key) > small.value(key):
            grown = large.value(key) / small.value(key)
            first = given[small.effect]
            assert begun == pytest.approx(first + grown * (ended - first))
            larger += 1
    assert larger


@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(
    ("shown", "word"), [("delay", "Cannot tell: "), ("stiffness", "Complete: ")]
)
def test_recordings_that_would_show_no_friction_nor_torque_over_position_cannot_tell(
    shown: str, word: str, decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        engine, "detectable", lambda *a: tuple(x for x in detectable(*a) if x.effect == shown)
    )
    d = decided(reality.Machine())
    assert d.headline.startswith(word), d.headline
    assert (d.next_recording is not None) == (shown == "delay")


class _OneImplant(implants.Implant):
    """An implant that is seen from a size of ``enough`` on, by the gain of blocks, which need not
    grow as its size does.
    """

    def __init__(self, enough: float) -> None:
        self.enough, self.test, self.joint = enough, None, 1  # type: ignore[assignment]
        self.final = self  # type: ignore[assignment]
        self.model, self.terms, self.given = self, (), ()

    def with_terms(self, terms: tuple[Term, ...]) -> Term:
        return terms[-1]

    def _without(self, *_: Any) -> Any:
        return None

    def _short_by(self, term: Term, *_: Any) -> tuple[float, float]:
        lacking = self.enough / term.value("coefficient")
        return (lacking if lacking <= 1.0 else max(lacking, implants.LARGER)), 0.1


@pytest.mark.parametrize(("enough", "seen"), [(1.1, 1.19), (1.19, 1.19), (1.3, np.inf)])
def test_the_largest_effect_that_is_not_small_is_tried_before_none_is_said_to_be_seen(
    enough: float, seen: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drift of a drive's gain on EMPS lacked 3 %, and a step of half as much passed the limit."""
    limit = implants.NOT_SMALL / 1.25
    size = "coefficient"
    monkeypatch.setattr(implants, "difference", lambda _, term, *__: limit * term.value(size))
    begun = Term("stiffness", 1, {"coefficient": Quantity(1.0), "neutral": Quantity(0.0)})
    size, _ = _OneImplant(enough).seen(begun, 0.02)
    assert size == pytest.approx(seen, rel=0.01)


@pytest.mark.usefixtures("searched_once")
def test_what_would_not_be_seen_even_if_large_is_said(decided: Decided) -> None:
    """Of EMPS no size of a drag was stated, and its silence read as if none could be missed."""
    d = decided(reality.Machine())
    report = d.report()
    shown, hidden = ({x["effect"] for x in report[key]} for key in ("detectable", "undetectable"))
    has = {t.effect for t in d.improved.terms} | {"inertia"}  # a number of the mechanism
    asked = {e.name for e in library().values() if e.sized}
    asked |= {"disturbance", *ASKED}
    assert shown | hidden == asked - has
    assert "torque_gain" in hidden, "inertia and friction, calibrated, imitate it"
    assert "delay" in shown, "a shift of the command column, refined, had imitated it"
    assert "may be missed here even if large: " in summary(d)
    curve = replace(d.undetectable[0], effect="stribeck", at={"velocity": 0.05})
    assert hidden_words([curve], d) == "stribeck (joint 1 at velocity 0.05 rad/s)"
    listed = _could_not(d).partition("no size is asked: ")[2].partition(".</p>")[0].split(", ")
    assert {"stiffening", "hysteresis"} <= set(listed)
    assert not {"ripple", "coulomb_tanh", "payload", "elasticity", "backlash"} & set(listed)


def test_an_effect_that_was_found_is_not_said_to_be_beyond_sight() -> None:
    """A ripple of order 6 was found, and the same page said that one would not be seen."""
    ripple = Detectable(1, "position_torque", "ripple", math.inf, "N m", 0.0, {"order": 3.0})
    slow = replace(ripple, effect="stribeck", mechanism="dry_friction", at={"velocity": 0.05})
    delay = replace(slow, effect="delay", mechanism="actuator", at={})
    numbers = {"order": Estimate(6.01, 0.01, "1"), "amplitude": Estimate(0.1, 0.01, "N m")}
    one = Finding("ripple", 1, numbers, 0.99, 0.9, (), (), "", mechanism="position_torque")
    d: Any = SimpleNamespace(findings=[one], given=model_of())
    seen = [replace(ripple, at={"order": 6.0}), ripple, slow, replace(slow, joint=2), delay]
    left = missed(seen, [one], [])
    assert left == tuple(seen[1:])
    assert hidden_words(left, d) == (
        "another ripple (joint 1 at order 3), stribeck (joint 1 at velocity 0.05 rad/s, joint 2 at"
        " velocity 0.05 rad/s), delay (joint 1)"
    )


def test_what_the_report_names_otherwise_is_not_said_to_be_missed() -> None:
    """A law that cannot be told from the found one; a curve that is drawn without a law; the law
    that an unexplained torque is most like.
    """
    at = Detectable(1, "dry_friction", "stribeck", math.inf, "N m", 0.0, {"velocity": 0.05})
    creep, other = replace(at, effect="presliding", at={}), replace(at, joint=2)
    coulomb = Finding("coulomb", 1, {}, 0.99, 0.9, ("stribeck",), (), "", mechanism="dry_friction")
    assert missed([at, creep, other], [coulomb], []) == (creep, other)
    unknown, drift = replace(coulomb, effect="unknown"), replace(at, effect="friction_drift")
    assert missed([at, creep, drift, other], [unknown], []) == (drift, other)
    near: Any = SimpleNamespace(joint=1, near=Near("stribeck", 0.1, 0.01, "", ("presliding",)))
    assert missed([at, creep, other], [], [near]) == (other,)


@pytest.mark.parametrize(
    ("begin", "held"),
    # the second across the cut between what chooses and what tests, whose first quarter of a second
    # was left out of any push
    [(1.5, True), (4.2, True), (2.0, False)],
)
def test_a_push_of_the_stated_size_is_found_in_either_part_of_the_data(
    begin: float, held: bool, decided: Decided
) -> None:
    """The report said nothing of pushes, which it knows how to find. And where one lay in what is
    held out, `where` had the times at which the recordings of the fit lack most, which is nothing.
    """
    still = reality.Machine()
    told = next(x for x in decided(still).detectable if x.effect == "disturbance")
    assert 0.0 < told.size < 0.2
    pushed = reality.Machine(push=(1.3 * told.size, begin, begin + 1.0))
    d = decided(*((still, pushed) if held else (pushed, still)))
    (found,) = d.findings
    assert found.effect == "disturbance"
    assert d.times and all(begin - 0.3 < a and b < begin + 1.3 for a, b in d.times)


def test_a_gap_of_the_stated_size_is_found_and_none_within_the_sensors_error_is_promised(
    decided: Decided
) -> None:
    """Of a joint alone no size of a gap or a spring was asked."""
    still = reality.Machine()
    told = {x.effect: x for x in decided(still).detectable if x.mechanism == "transmission"}
    assert set(told) == set(ASKED)
    gap, spring = told["backlash"], told["elasticity"]
    assert (gap.unit, spring.unit) == ("rad", "rad/(N m)")
    assert gap.size > 1.5 * reality.RESOLUTION
    half = 0.5 * still.inertia
    assert gap.at["load_inertia"] == pytest.approx(half, rel=0.1)
    # rings below what the search begins from at most
    assert math.sqrt(1.0 / (spring.size * 0.5 * half)) < 2.0 * math.pi * 64.0
    loose = replace(still, gap=1.3 * gap.size, load=half)
    (found,) = decided(loose, loose).findings
    assert found.mechanism == "transmission"


def test_of_a_joint_that_nothing_drives_no_size_of_a_drive_is_told(tmp_path: Path) -> None:
    """A delay and a gain of the pole's motor "may be missed here even if large"."""
    u = reality.multisine(8.0, reality.RATE, 1)
    driven = reality.simulate(reality.Machine(coulomb=0.0), u, reality.RATE)
    inertia, damping, spring = 0.01, 0.002, 0.3
    slow = 0.5 * damping / inertia
    turn = math.sqrt(spring / inertia - slow**2)
    swings = 0.5 * np.exp(-slow * driven["t"]) * np.cos(turn * driven["t"])
    swings = np.round(swings / reality.RESOLUTION) * reality.RESOLUTION
    columns = {"t": driven["t"], "q1": driven["q"], "u1": driven["u"]}
    run = reality.save(tmp_path / "run.csv", {**columns, "q2": swings, "u2": 0.0 * swings})
    model = {
        "sample_time": 1.0 / reality.RATE,
        "mechanism": {
            "kind": "rotary", "parameters": {"inertia": {"value": [0.01, inertia], "free": False}},
        },
        "effect": [
            {"kind": "viscous", "joint": 1, "coefficient": 0.004},
            {"kind": "viscous", "joint": 2, "coefficient": damping},
            {"kind": "stiffness", "joint": 2, "coefficient": spring, "neutral": 0.0},
        ],
        "sensor": {"position_resolution": reality.RESOLUTION},
        "columns": {"time": "t", "position": ["q1", "q2"], "command": ["u1", "u2"]},
    }  # fmt: skip
    d = diagnose(run, model, jobs=1)
    asked: dict[int, set[str]] = {1: set(), 2: set()}
    for x in (*d.detectable, *d.undetectable):
        asked[x.joint].add(x.effect)
    of_drives = {"delay", "lag", "torque_gain", "torque_offset", "dead_zone"}
    assert {"delay", "dead_zone"} <= asked[1] and not of_drives & asked[2]
    assert {"quadratic_drag", "encoder_eccentricity"} <= asked[2]
