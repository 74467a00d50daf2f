"""A push from outside that does not recur is a disturbance, reported with its times."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import KNOWN

from zendsp.diagnosis import Diagnosis
from zendsp.diagnosis.decide import decide, nothing_named, pushes
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.naming import _disturbance, at_once
from zendsp.diagnosis.explain import undisturbed
from zendsp.diagnosis.measure.bursts import Bursts
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.report.figures import charts

Decided = Callable[..., Diagnosis]
pytestmark = pytest.mark.usefixtures("sizes_unasked")


def run(name: str, n: int = 900) -> Any:
    """A recording of which only name and time are asked."""
    return SimpleNamespace(recording=name, t0=1.0, sample_time=0.01, n=n)


@pytest.fixture
def seconds() -> tuple[float, float]:
    """Pushes that last, and time enough beside them."""
    return 7.5, 9.0


def test_a_torque_only_in_the_recordings_to_choose_by_leaves_the_verdict_open(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nothing_named, "pushed", lambda *_: None)
    for name in ("pushed_beside", "felt"):  # nothing of it comes again
        monkeypatch.setattr(decide, name, lambda *_: None)
    pushed = reality.Machine(push=(0.3, 2.0, 3.0))
    assert decided(reality.Machine(), pushed).verdict == "unexplained"


@pytest.mark.parametrize(("last", "pushed"), [(8.0, True), (9.0, False)])
def test_a_torque_that_acts_for_half_of_a_recording_is_no_push(last: float, pushed: bool) -> None:
    def part(name: str, n: int) -> Any:
        return SimpleNamespace(records=[[run(name, n)]])

    found = Bursts(((1.0, last),), ("b",), 0.9, 5.0, 2.0, 0.1, 1.0, 1.1, (1.0,), 0.95)
    parts: Any = SimpleNamespace(fit=part("b", 1800), held=part("a", 900))
    assert pushes.comes_and_goes(found, parts, 1) is pushed


def test_joints_that_are_pushed_at_the_same_times_are_one_finding() -> None:
    def pushed(joint: int, name: str, *spans: tuple[float, float]) -> Any:
        found = Bursts(
            spans, (name,) * len(spans), 0.9, 5.0 * joint, 2.0, 0.1, 1.0, 10.0,
            (1.0,) * len(spans), 0.95,
        )  # fmt: skip
        before = SimpleNamespace(value=0.1 * joint)
        return SimpleNamespace(joint=joint, bursts=found, before=before)

    one, other = pushed(1, "a", (1.0, 2.0), (4.0, 5.0)), pushed(2, "a", (1.4, 2.1), (4.0, 4.4))
    later, elsewhere = pushed(3, "a", (5.2, 6.0)), pushed(4, "b", (1.0, 2.0))
    still = SimpleNamespace(joint=5, bursts=None, before=SimpleNamespace(value=0.0))
    groups = at_once([one, other, later, elsewhere, still])
    assert [[d.joint for d in g] for g in groups] == [[4], [3], [2, 1]]
    given: Any = SimpleNamespace(torque_unit=lambda _: "N m")
    found = _disturbance(groups[-1], given)
    assert (found.joint, found.effect) == (2, "disturbance")
    assert "on joint 1 at the same times" in found.sentence
    assert found.as_dict()["details"] == {"also_on": [{"joint": 1, "rms": 2.0, "peak": 5.0}]}


def test_where_cutting_out_all_pushes_leaves_too_little_only_the_largest_is_cut_out(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody held the tool for two seconds. Calibrated to that, the arm had lacked something at
    forty times, and had not been diagnosed without the push.
    """
    spans = ((0.5, 0.7), (2.0, 4.0), (6.0, 6.2))
    held = Bursts(spans, ("a",) * 3, 0.9, 5.0, 2.0, 0.1, 1.0, 1.1, (0.01, 1.0, 0.02), 0.95)
    asked: list[list[tuple[str, float, float]]] = []
    passes: list[object] = []
    alike: list[object] = []

    def cut_out(part: Any, pushes: list[tuple[str, float, float]]) -> Any:
        asked.append(pushes)
        return part if len(pushes) == 1 else []

    def once(parts: Any, *_: object) -> Any:
        passes.append(parts)
        decision = SimpleNamespace(kind="disturbance", bursts=held)
        whole = SimpleNamespace(calibrated=None)
        return SimpleNamespace(decisions=[decision], whole=whole)

    monkeypatch.setattr(undisturbed, "cut_out", cut_out)
    monkeypatch.setattr(undisturbed, "find_once", once)
    monkeypatch.setattr(undisturbed, "other_bodies", lambda *_: ())
    monkeypatch.setattr(undisturbed, "may_be_loaded", lambda *_: False)
    for name in ("without_one", "_zeroed_elsewhere"):
        monkeypatch.setattr(undisturbed, name, lambda *_: None)
    monkeypatch.setattr(undisturbed, "by_one_alone", lambda found, *_: found)
    monkeypatch.setattr(undisturbed, "of_one_sensor", lambda parts: alike.append(parts) or parts)
    monkeypatch.setattr(undisturbed, "prepare", lambda part, *_: part)
    monkeypatch.setattr(undisturbed, "_beside_pushes", lambda _, again: again)
    monkeypatch.setattr(undisturbed, "_misled", lambda *_: False)
    signals: Any = (["fit"], ["choose"], ["test"])
    undisturbed.find(signals, "all", None, 1, lambda _: None)  # type: ignore[arg-type]
    assert asked[-1] == [("a", 2.0, 4.0)]
    assert passes == ["all", undisturbed.Parts(["fit"], ["choose"], ["test"])]  # type: ignore[arg-type]
    # whole recordings of one sensor: by the test recording alone, its counts were a torque of 5 %
    assert alike == [signals]


@dataclass(frozen=True)
class Pass:
    """What a pass over the recordings found: of one joint, and of all."""

    bursts: Bursts | None = None
    kind: Verdict = Verdict.MISSING
    decisions: tuple[Any, ...] = ()
    parts: Any = None
    joint: int = 1
    final: Any = None
    known: Any = None


@pytest.mark.parametrize(
    ("left", "spans", "kind", "pushed"),
    [(0.001, (), Verdict.MISSING, False), (0.03, (), Verdict.MISSING, True),
     (0.001, ((0.4, 5.3),), Verdict.MISSING, True), (0.001, (), Verdict.COMPLETE, True)],
)  # fmt: skip
def test_what_was_found_without_the_pushes_and_leaves_nothing_of_them_leaves_no_push(
    left: float,
    spans: tuple[tuple[float, float], ...],
    kind: Verdict,
    pushed: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A friction that drifted in the first seconds, beside a late drive, had been a disturbance
    (85 %), although the drift was found in the rest.
    """
    first = Bursts(((0.4, 5.3),), ("a",), 0.9, 5.0, 2.0, 0.1, 1.0, 1.1, (1.0,), 0.95)
    monkeypatch.setattr(undisturbed, "discrepancy", lambda *_: Size(left, left, left))
    monkeypatch.setattr(undisturbed, "everywhere", lambda *_: replace(first, intervals=spans))
    again = Pass(None, kind, final=SimpleNamespace(model=None), known=SimpleNamespace(all=0.0))
    parts = SimpleNamespace(fit=None, held=None)
    before, rest = Pass(decisions=(Pass(first),), parts=parts), Pass(decisions=(again,))
    (found,) = undisturbed._beside_pushes(before, rest).decisions  # type: ignore[arg-type]
    assert (found.bursts is not None) is pushed


@pytest.mark.usefixtures("searched_once")
def test_what_a_diverging_model_lacks_is_no_push(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a spring whose load was heavier than the joint, 484 kN m had been called a disturbance.
    """
    machine = reality.Machine(push=(0.06, 2.0, 4.0))
    assert [f.effect for f in decided(machine, machine).findings] == ["disturbance"]
    for lacks in (7000.0, float("nan")):
        monkeypatch.setattr(pushes, "discrepancy", lambda *_, x=lacks: Size(x, x, x))
        assert not decided(machine, machine).findings


def test_a_push_is_a_disturbance_with_its_times(decided: Decided) -> None:
    d = decided(reality.Machine(push=(0.06, 2.0, 4.0)), reality.Machine(push=(0.06, 6.5, 8.5)))
    assert [f.effect for f in d.findings] == ["disturbance"]
    # of the recording of the fit, then of the one held out
    spans = np.array(d.findings[0].numbers["intervals"])
    assert spans == pytest.approx(np.array([[2.0, 4.0], [6.5, 8.5]]), abs=0.2)
    rms, peak = (d.findings[0].parameters[name] for name in ("rms", "peak"))
    assert peak.value == pytest.approx(0.06, rel=0.3) and 0.0 < peak.std < 0.02
    assert rms.value <= peak.value and 0.0 < rms.std < 0.02


@pytest.mark.usefixtures("searched_once")
def test_a_small_push_is_a_finding_or_noted_with_its_times_where_another_load_explains_as_much(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A push of 5 % of the torque for 2 s was "unexplained" beside a note that told its time."""
    machines = [reality.Machine(push=(0.007, at, at + 2.0)) for at in (2.0, 6.5)]
    assert [f.effect for f in decided(*machines).findings] == ["disturbance"]
    monkeypatch.setattr(decide, "by_own_numbers", lambda *_: ("run1.csv",))
    d = decided(*machines)
    assert not d.findings
    (told,) = (note for note in d.notes if "no state explains" in note)
    assert told.startswith("joint 1: a torque of up to 0.00") and told.endswith("touched?")
    spans = [[float(a), float(b)] for a, b in re.findall(r"([\d.]+)–([\d.]+) s", told)]
    assert np.array(spans) == pytest.approx(np.array([[2.0, 4.0], [6.5, 8.5]]), abs=0.3)


@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
def test_pushes_in_every_recording_and_a_friction_that_is_missing_are_both_found(
    decided: Decided,
) -> None:
    """Each hides the other, since numbers fitted to both suit neither."""
    pushed = reality.Machine(push=(0.04, 3.0, 3.6, 8.0, 8.6))
    d = decided(pushed, pushed, KNOWN[0])
    push, dry = d.findings
    assert (push.effect, dry.effect) == ("disturbance", "coulomb")
    spans = np.array(push.numbers["intervals"])
    assert spans == pytest.approx(np.array(2 * [[3.0, 3.6], [8.0, 8.6]]), abs=0.2)
    assert dry.parameters["level"].value == pytest.approx(0.03, rel=0.02)


LARGE = pytest.param(0.15, marks=pytest.mark.long("the smaller push bends the calibration too"))


@pytest.mark.parametrize("push", [0.01, LARGE])
def test_a_push_only_in_the_recording_of_the_fit_is_reported(push: float, decided: Decided) -> None:
    d = decided(reality.Machine(push=(push, 4.0, 6.0)), reality.Machine())
    assert [f.effect for f in d.findings] == ["disturbance"]
    spans = np.array(d.findings[0].numbers["intervals"])
    assert spans == pytest.approx(np.array([[4.0, 6.0]]), abs=0.2)
    assert d.test is not None and d.test.improved < 1.2 * d.test.given
    (chart,) = (chart for chart in charts(d) if chart.finding == 0)
    (panel,) = chart.panels  # on the same clock
    lacking = panel.series[0]
    there = lacking.x[np.abs(lacking.y) > 0.5 * np.max(np.abs(lacking.y))]
    assert there == pytest.approx(5.0, abs=1.2)


def test_several_pushes_only_in_the_recording_of_the_fit_are_reported(decided: Decided) -> None:
    pushed = reality.Machine(push=(0.03, 1.5, 2.2, 3.6, 4.2, 6.0, 6.8))
    (found,) = decided(pushed, reality.Machine()).findings
    assert found.effect == "disturbance"
    spans = np.array(found.numbers["intervals"])
    assert spans == pytest.approx(np.array([[1.5, 2.2], [3.6, 4.2], [6.0, 6.8]]), abs=0.2)


@pytest.mark.parametrize(
    "size", [0.06, pytest.param(0.15, marks=pytest.mark.long("the smaller push is harder"))]
)
def test_a_push_through_most_of_the_test_data_allows_no_other_finding(
    size: float, decided: Decided
) -> None:
    again = reality.Machine(push=(size, 4.5, 7.1 if size > 0.1 else 8.1))
    d = decided(reality.Machine(push=(size, 3.0, 5.5)), again)
    assert [f.effect for f in d.findings] == ["disturbance"]
    assert d.unexplained == ""


@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
@pytest.mark.parametrize("held", [False, True])
def test_a_push_at_a_reversal_is_reported_with_its_recording(
    decided: Decided, tmp_path: Path, held: bool
) -> None:
    """It holds the joint for its whole time, with more torque than friction has."""
    pushed, quiet = reality.Machine(push=(0.3, 4.0, 5.0), kp=1.0), reality.Machine(kp=1.0)
    d = decided(*((quiet, pushed) if held else (pushed, quiet)))
    (found,) = d.findings
    assert found.effect == "disturbance"
    assert {Path(name).name for name in found.numbers["recordings"]} == {f"run{1 + held}.csv"}
    assert f"of {tmp_path}/run{1 + held}.csv" in found.sentence


def test_physics_missing_beside_a_push_is_found_in_the_other_times(decided: Decided) -> None:
    """The push had bent all numbers, so it is cut out and the rest is diagnosed again."""
    law = {"breakaway": 0.04, "stribeck": 0.8}
    d = decided(reality.Machine(push=(0.2, 4.0, 5.0), **law), reality.Machine(**law))
    assert [f.effect for f in d.findings] == ["disturbance", "stribeck"]
    assert d.findings[1].parameters["breakaway"].value == pytest.approx(0.04, rel=0.03)
    ((begin, end),) = d.findings[0].numbers["intervals"]
    assert (begin, end) == (pytest.approx(4.0, abs=0.15), pytest.approx(5.0, abs=0.15))


def test_a_small_push_beside_a_finding_is_noted_with_its_times(decided: Decided) -> None:
    d = decided(reality.Machine(push=(0.01, 2.0, 3.0)), reality.Machine(), KNOWN[0])
    assert [f.effect for f in d.findings] == ["coulomb"]
    assert "that no state explains: a push" in d.unexplained, d.unexplained


def test_a_push_beside_a_finding_is_reported(decided: Decided, bench: Decided) -> None:
    """The missing dry friction is found at the times without a push."""
    pushed = reality.Machine(push=(0.08, 4.0, 6.0))
    d = decided(pushed, reality.Machine(), KNOWN[0])
    assert [f.effect for f in d.findings] == ["disturbance", "coulomb"]
    ((begin, end),) = d.findings[0].numbers["intervals"]
    assert (begin, end) == (pytest.approx(4.0, abs=0.15), pytest.approx(6.0, abs=0.2))
    assert "run1.csv" in d.findings[0].sentence
    assert "push" not in bench(reality.Machine(), KNOWN[:1]).unexplained


@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
def test_a_push_in_held_out_recordings_alone_is_reported_beside_a_finding(decided: Decided) -> None:
    """The recordings of the fit lack nothing beside the friction."""
    d = decided(reality.Machine(), reality.Machine(push=(0.08, 2.0, 3.0)), KNOWN[0])
    assert [f.effect for f in d.findings] == ["disturbance", "coulomb"]
    assert np.array(d.findings[0].numbers["intervals"]) == pytest.approx(
        np.array([[2.0, 3.0]]), abs=0.1
    )
    assert d.findings[1].parameters["level"].value == pytest.approx(0.03, rel=0.01)


@pytest.mark.parametrize(("joints", "models"), [(1, ["bent", "clear"]), (6, [])])
def test_pushes_are_asked_for_beside_the_likeliest_law_and_with_the_numbers_of_the_held(
    joints: int, models: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A push to choose by had refused every law; pushes in the fit had bent the numbers of a drag
    by half, so that it lacked something everywhere. A KUKA given without its load was not pushed.
    """

    def scored(name: str) -> Any:
        return SimpleNamespace(model=name)

    lacking = {"bent": {"fit": 0.09, "choose": 0.1, "test": 0.1}, "clear": {"fit": 0.2}}

    def discrepancy(part: Any, model: str, _: int) -> Size:
        return Size(value := lacking[model].get(part.name, 0.0), value, value)

    beside: list[str] = []

    def in_fit(_: object, model: str, *__: object) -> None:
        beside.append(model)

    monkeypatch.setattr(decide, "lost", lambda *_: False)
    monkeypatch.setattr(decide, "rubs", lambda *_: True)
    monkeypatch.setattr(pushes, "lost", lambda *_: False)
    monkeypatch.setattr(pushes, "discrepancy", discrepancy)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: scored("clear"))
    monkeypatch.setattr(pushes, "in_held", lambda *_: None)
    monkeypatch.setattr(pushes, "in_fit", in_fit)
    size, base = Size(0.1, 0.1, 0.1), scored("base")
    nothing: Any = SimpleNamespace()
    out = Decision(1, "unexplained", (), (), base, base, size, size, nothing, size, base, 1.0)
    monkeypatch.setattr(decide, "_decided", lambda *_: out)
    rival = SimpleNamespace(effect="torque_offset", scored=scored("bent"))
    search: Any = SimpleNamespace(base=base, joint=1, tried=[rival], best=None)
    parts: Any = SimpleNamespace(
        **{name: SimpleNamespace(name=name, joints=joints) for name in ("fit", "choose", "test")}
    )
    parts.each = (parts.fit, parts.choose, parts.test)
    decide.decide(parts, None, search, 1, lambda _: None)  # type: ignore[arg-type]
    assert beside == models


@pytest.mark.parametrize(("joints", "told"), [(1, True), (6, False)])
def test_of_several_joints_what_held_out_recordings_alone_lack_is_no_push_beside_friction(
    joints: int, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a tilted base two of six joints with a friction that falls with the speed had been
    pushed, each at one slow passage of the held-out recording, or beside a drag that was wrong
    there.
    """
    push = Bursts(((1.0, 2.0),), ("held",), 0.9, 0.2, 0.1, 0.0, 1.0, 1.0, (1.0,), 0.95)
    size = Size(0.1, 0.1, 0.1)
    model: Any = SimpleNamespace(model="drag")
    monkeypatch.setattr(pushes, "lost", lambda *_: False)
    monkeypatch.setattr(pushes, "of_the_motion", lambda *_: False)
    monkeypatch.setattr(pushes, "discrepancy", lambda *_: size)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: model)
    monkeypatch.setattr(pushes, "in_held", lambda *_: push)
    monkeypatch.setattr(pushes, "in_fit", lambda *_: None)
    monkeypatch.setattr(pushes, "everywhere", lambda found, *_: found)
    one: Any = SimpleNamespace(joints=joints, records=[[run("held")]])
    parts: Any = SimpleNamespace(fit=one, choose=one, test=one, held=one, each=(one, one, one))
    out = Decision(1, "unexplained", (), (), model, model, size, size, size, size, model, 1.0)  # type: ignore[arg-type]
    assert pushes.pushed_beside(out, [model], parts, False, 1) == (push if told else None)


@pytest.mark.parametrize(
    ("spread", "share", "steady", "loads", "pushed"),
    [
        (6.0, 0.9, 0.95, (), True),
        (6.5, 0.9, 0.95, (), False),  # more than twice a recording, however many parts it has
        (6.0, 0.9, 0.75, (), False),  # a joint that rings on its own spring
        (6.0, 0.4, 0.95, (), False),  # most of what lacks comes at other times
        (6.0, 0.9, 0.95, ("a.csv",), False),
    ],
)
def test_frequent_or_small_or_load_torques_are_no_push(
    spread: float,
    share: float,
    steady: float,
    loads: tuple[str, ...],
    pushed: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found: Any = SimpleNamespace(
        intervals=(), recordings=(), spread=spread, share=share, beside=0.0, steady=steady
    )
    monkeypatch.setattr(pushes, "by_own_numbers", lambda *_: loads)
    monkeypatch.setattr(pushes, "apart", lambda *_: (1.0, 1.0))
    one, two, three = ((run(f"{name}.csv"),) for name in "abc")
    fit, held = (SimpleNamespace(records=records) for records in ((one, two), (one, two, three)))
    parts: Any = SimpleNamespace(fit=fit, choose=held, test=held, held=held)
    size: Any = SimpleNamespace(value=0.2)
    monkeypatch.setattr(pushes, "discrepancy", lambda *_: size)
    monkeypatch.setattr(pushes, "lost", lambda *_: False)
    monkeypatch.setattr(pushes, "in_held", lambda *_: found)
    monkeypatch.setattr(pushes, "everywhere", lambda *_: found)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: SimpleNamespace(model=None))
    nothing: Any = SimpleNamespace(share=0.0, size=0.0, z=0.0, apart=0.0)
    base: Any = SimpleNamespace(model=None)
    out = Decision(1, "complete", (), (), base, base, size, size, nothing, size, base, 1.0)
    outcome = pushes.pushed(out, parts, 1)
    assert (outcome is not None and outcome.kind == "disturbance") == pushed


@pytest.mark.parametrize("beside", [0.5, 2.0])
def test_a_calibration_spoilt_by_a_push_gives_way_to_that_of_the_other_recordings(
    beside: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model calibrated to slow motion that lacked something in a fast one had been called pushed.
    """
    push: Any = SimpleNamespace(
        intervals=(), recordings=(), spread=1.0, share=0.9, beside=beside, steady=0.95
    )
    monkeypatch.setattr(pushes, "by_own_numbers", lambda *_: ())
    monkeypatch.setattr(pushes, "apart", lambda *_: (1.0, 1.0))  # with the numbers of the fit
    data: Any = SimpleNamespace(records=((run("a.csv"),),))
    parts: Any = SimpleNamespace(fit=data, choose=data, test=data, held=data)
    size: Any = SimpleNamespace(value=0.2)
    monkeypatch.setattr(pushes, "discrepancy", lambda _, model, __: size)
    monkeypatch.setattr(pushes, "lost", lambda *_: False)
    monkeypatch.setattr(pushes, "in_held", lambda *_: None)
    monkeypatch.setattr(pushes, "in_fit", lambda *_: push)
    monkeypatch.setattr(pushes, "everywhere", lambda *_: push)
    other: Any = SimpleNamespace(model=None)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: other)
    nothing: Any = SimpleNamespace(share=0.0, size=0.0, z=0.0, apart=0.0)
    base: Any = SimpleNamespace(model=None)
    out = Decision(1, "complete", (), (), base, base, size, size, nothing, size, base, 1.0)
    outcome = pushes.pushed(out, parts, 1)
    assert outcome is not None and (outcome.final is other) == (beside < 1.0)


@pytest.mark.parametrize(
    ("law", "is_one"),
    [
        ((1.2, 0.5), True),  # friction by load of an arm: 5.0, 0.8 N m without it
        ((3.0, 1.6), False),  # bent to a push: it spoils the other times
        ((4.8, 0.7), False),
    ],
)
def test_what_a_law_explains_without_spoiling_other_times_is_no_push(
    law: tuple[float, float], is_one: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacks = {"none": (5.0, 0.8), "law": law}
    monkeypatch.setattr(pushes, "apart", lambda _, __, model, ___: lacks[model])
    pushed: Any = SimpleNamespace(bursts=object(), joint=1, final=SimpleNamespace(model="none"))
    parts: Any = SimpleNamespace(fit=None, held=None)
    laws: Any = ["law"]
    assert pushes.of_a_law(pushed, laws, parts) == is_one
    assert not pushes.of_a_law(pushed, [], parts)


@pytest.mark.parametrize(("shown", "kind"), [(0.012, "complete"), (0.04, "unexplained")])
def test_what_lacks_is_as_large_as_one_observer_surely_shows(shown: float, kind: str) -> None:
    """A complete machine with coarse counts: a fast observer showed 4 % and perhaps nothing, a slow
    one surely something, of 1 %.
    """
    before, one = Size(0.044, 0.008, 0.22, shown=shown), SimpleNamespace(model=None)
    nothing: Any = SimpleNamespace()
    pushed = Decision(
        1, "disturbance", (), (), one, one, before, before, nothing, before, one, 1.0,  # type: ignore[arg-type]
    )  # fmt: skip
    assert pushes.unpushed(pushed).kind == kind
