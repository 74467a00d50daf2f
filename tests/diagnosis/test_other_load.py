"""A load that only held-out recordings have is named, and is no push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import KNOWN
from small_arms import Arm
from small_arms import recorded as arm_recorded

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.decide import other_load, pushes
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.headline import verdict_sentence
from zendsp.diagnosis.decide.other_load import of_load
from zendsp.diagnosis.decide.outcome import _lacking, of_other_loads
from zendsp.diagnosis.explain import one_apart, undisturbed
from zendsp.diagnosis.explain import other_bodies as module
from zendsp.diagnosis.explain.machine import Found
from zendsp.diagnosis.explain.other_bodies import Loaded, confirmed, other_bodies
from zendsp.diagnosis.search.joint_zeros import OtherZero
from zendsp.physics.model import Model

Decided = Callable[..., Diagnosis]
pytestmark = pytest.mark.usefixtures("sizes_unasked")


@pytest.fixture
def seconds() -> tuple[float, float]:
    """Pushes that last, and time enough beside them."""
    return 7.5, 9.0


def test_a_recording_with_another_load_is_said_to_be_one(decided: Decided) -> None:
    """The difference is not one of inertia and weight alone, so nothing is claimed."""
    d = decided(reality.Machine(), reality.Machine(coulomb=0.042))
    assert d.verdict == "unexplained" and not d.findings
    assert any("numbers of its own explain" in note for note in d.notes)
    assert "numbers of its own describe each" in d.headline
    assert "numbers of its own explain each" in d.unexplained


@pytest.mark.parametrize(("loads", "told"), [((("a",), ("b",)), (1, 2)), ((("a",), ()), ())])
def test_the_headline_speaks_of_other_loads_where_they_explain_all_that_is_unexplained(
    loads: tuple[tuple[str, ...], ...], told: tuple[int, ...]
) -> None:
    """Of two trainings with two loads it said that no known effect describes the difference."""
    decisions: Any = [
        SimpleNamespace(joint=j, kind=Verdict.UNEXPLAINED, loads=names)
        for j, names in enumerate(loads, 1)
    ]
    decisions.append(SimpleNamespace(joint=3, kind=Verdict.COMPLETE, loads=()))
    assert of_other_loads(decisions) == told
    said = verdict_sentence(Verdict.UNEXPLAINED, [], loads=told)
    assert ("another load perhaps" in said) is bool(told)


@pytest.mark.parametrize("inertia", [0.014, 0.0107, 0.008])
def test_a_load_that_only_the_held_out_recording_has_is_named(
    inertia: float, decided: Decided
) -> None:
    """The difference is so small that numbers between the two leave 2 % of the torque in each."""
    d = decided(reality.Machine(), reality.Machine(inertia=inertia))
    (found,) = d.findings
    amount = found.parameters["amount"]
    (name,) = found.numbers["recordings"]
    assert (found.effect, Path(name).name) == ("inertia", "run2.csv")
    assert abs(amount.value - (inertia - 0.010)) < 3.0 * amount.std < 0.0003
    assert d.test.improved < 0.2 * d.test.calibrated
    assert found.confidence == other_load.CONFIDENCE


def test_a_load_beside_which_much_stays_unexplained_is_less_sure(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = other_load.discrepancy
    monkeypatch.setattr(other_load, "discrepancy", lambda *a: replace(left(*a), value=0.022))
    (found,) = decided(reality.Machine(), reality.Machine(inertia=0.0107)).findings
    assert 0.5 < found.confidence < other_load.CONFIDENCE


@pytest.mark.parametrize("left", [0.03, 0.001])
def test_no_load_is_named_that_leaves_much_or_that_the_fit_may_have_too(
    left: float, decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bench on pendulums was "of another load" (77 %), since they swing otherwise in each
    recording; and one with a spring (90 %), which had bent the numbers of the fit: those of the
    held-out recordings left as little there.
    """
    sized = other_load.discrepancy
    monkeypatch.setattr(other_load, "discrepancy", lambda *a: replace(sized(*a), value=left))
    assert not decided(reality.Machine(), reality.Machine(inertia=0.0107)).findings


def test_a_load_that_gravity_shows_too_is_a_payload(
    recorded: Callable[..., list[Path]], tmp_path: Path
) -> None:
    """0.1 kg at 0.2 m, beside the model's own inertia and weight."""
    runs = recorded(reality.Machine(gravity=0.15), reality.Machine(gravity=0.3462, inertia=0.014))
    model = reality.model_file(tmp_path / "heavy.toml", reality.RATE, *KNOWN, gravity=0.15)
    d = diagnose(runs[0], model, runs[1], jobs=1)
    (found,) = d.findings
    mass, reach = (found.parameters[key] for key in ("mass", "com_x"))
    assert (found.effect, found.mechanism) == ("payload", "inertia")
    assert abs(mass.value - 0.1) < 3.0 * mass.std < 0.01
    assert abs(reach.value - 0.2) < 3.0 * reach.std < 0.02


@pytest.mark.parametrize(
    ("fit", "held", "said"),
    [
        ((0.02, 0.018), (0.28, 0.02), ("held",)),  # friction's bristles, in both
        ((0.02, 0.018), (0.28, 0.05), ()),  # more than a load differs
        ((0.02, 0.018), (0.021, 0.018), ()),
        ((0.02, 0.002), (0.05, 0.002), ("fit", "held")),  # numbers between two loads
        ((0.004, 0.004), (0.05, 0.02), ()),
    ],
)
def test_a_recording_that_its_own_numbers_explain_fully_has_another_load(
    fit: tuple[float, float],
    held: tuple[float, float],
    said: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A load of 0.15 kg on the shipped pendulum had been reported as a torque that depends on the
    state.
    """

    @dataclass(frozen=True)
    class Data:
        records: tuple[Any, ...]
        ranges: Any = None

    lacks = {"fit": fit, "held": held}

    def left(data: Data, model: str, joint: int) -> Any:
        value = lacks[data.records[0][0].recording][model == "own"]
        return SimpleNamespace(value=value, high=1.2 * value)

    monkeypatch.setattr(pushes, "discrepancy", left)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: SimpleNamespace(model="own"))
    monkeypatch.setattr(pushes, "inertia_ranges", lambda *_: {})
    parts: Any = SimpleNamespace(
        **{k: Data(((SimpleNamespace(recording=k),),)) for k in ("fit", "held")}
    )
    out: Any = SimpleNamespace(joint=1, final=SimpleNamespace(model="base"))
    assert pushes.by_own_numbers(out, parts, 1) == said


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> tuple[Model, dict[str, Signals]]:
    """A model of an arm, and its recordings: two plain ones, two of 1.5 kg, and one of each that
    something pushes for a second.
    """
    folder = tmp_path_factory.mktemp("arms")
    given, plain = arm_recorded(folder, "plain", Arm(), friction=True)
    _, loaded = arm_recorded(folder, "loaded", Arm(mass=1.5), friction=True)
    paths = {"a": plain[0], "b": plain[1], "loaded": loaded[0], "loaded too": loaded[1]}
    for name, path in (("pushed", plain[0]), ("loaded and pushed", loaded[0])):
        columns = dict(np.load(path))
        columns["u"][1000:1500, 1] -= 4.0
        paths[name] = folder / f"{name}.npz"
        np.savez(paths[name], **columns)
    return given, {k: replace(read_signals(p, given), name=k) for k, p in paths.items()}


def _found(given: Model, kind: Verdict) -> Any:
    links: Any = SimpleNamespace(links=())
    return SimpleNamespace(
        parts=SimpleNamespace(fit=SimpleNamespace(records=[[links]])),
        decisions=[SimpleNamespace(joint=1, kind=kind)],
        whole=SimpleNamespace(calibrated=given),
    )


@pytest.mark.parametrize("other, said", [("loaded", ["loaded"]), ("pushed", [])])
def test_a_recording_of_an_arm_that_one_body_explains_has_another_load(
    other: str, said: list[str], arms: tuple[Model, dict[str, Signals]]
) -> None:
    """3 kg in one recording of three were pushes of six joints, 85 % sure."""
    given, each = arms
    held = [each["b"]]
    signals = ([each["a"], each[other]], held, held)
    found = _found(given, Verdict.DISTURBANCE)
    loads = other_bodies(found, signals, given, 1, lambda _: None)
    assert [name for load in loads for name in load.names] == said
    for load in loads:
        finding = load.finding(given)
        mass = finding.parameters["mass"]
        assert abs(mass.value - 1.5) < 3.0 * mass.std < 0.15
        assert finding.is_elsewhere and finding.numbers["recordings"] == ["loaded"]
        assert finding.confidence == other_load.CONFIDENCE
        assert "loaded is of a machine with another load" in finding.sentence
        assert of_load([finding])[0].startswith("loaded: the calibrated")
        assert not _lacking([], [finding], Verdict.MISSING, False), "nothing lacks in the others"


def test_no_recording_is_asked_for_a_load_where_nothing_lacks_or_none_is_beside_it(
    arms: tuple[Model, dict[str, Signals]]
) -> None:
    given, each = arms
    one, same, pushed = ([each[k]] for k in ("loaded", "loaded too", "loaded and pushed"))
    for kind, signals in (
        (Verdict.COMPLETE, ([each["a"]], one, one)),
        (Verdict.UNEXPLAINED, (one, one, one)),
        (Verdict.DISTURBANCE, (pushed, same, same)),  # all have the load
    ):
        assert other_bodies(_found(given, kind), signals, given, 1, lambda _: None) == ()


def test_a_zero_that_one_recording_alone_seems_to_have_is_no_load(
    arms: tuple[Model, dict[str, Signals]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is the whole diagnosis made again with it."""

    def zero(*_: Any) -> Any:
        raise OtherZero({1: 0.1}, 64.0)

    given, each = arms
    monkeypatch.setattr(module, "find_bodies", zero)
    signals = ([each["a"], each["loaded"]], [each["b"]], [each["b"]])
    found = _found(given, Verdict.UNEXPLAINED)
    assert other_bodies(found, signals, given, 1, lambda _: None) == ()


def test_a_load_that_a_missing_law_hid_is_confirmed_beside_that_law(
    arms: tuple[Model, dict[str, Signals]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 0.3 kg in one recording of three, and a ripple of 2.7 % in all, neither was named."""
    given, each = arms
    body: Any = SimpleNamespace()
    hidden, other = (Loaded((n,), body, 0.1, left) for n, left in (("loaded", 0.027), ("a", 0.004)))
    assert hidden.explains_most and not hidden.is_sure and other.is_sure
    signals = ([each["a"], each["loaded"]], [each["b"]], [each["b"]])
    found: Any = SimpleNamespace(whole=SimpleNamespace(improved=given))
    for left, sure in ((0.002, ["loaded", "a"]), (0.02, [])):
        monkeypatch.setattr(module, "_left", lambda *_, left=left: left)
        both = confirmed((hidden, other), found, signals, 1)
        assert [name for x in both for name in x.names] == sure


@pytest.mark.parametrize(
    ("held", "left"),
    [
        ("b", (["a"], ["b"], ["b"])),
        ("loaded", ()),  # nothing is left to judge on
    ],
)
def test_the_rest_is_diagnosed_without_the_recordings_of_another_load(
    held: str, left: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def found(kind: Verdict) -> Any:
        no: Any = None
        out = Decision(1, kind, (), (), no, no, no, no, no, no, no, 1.0)
        return Found(no, no, no, no, [], [], [out], no, ())

    def once(parts: Any, *_: Any) -> Any:
        if parts != "all":
            asked.extend((parts.fit, parts.choose, parts.test))
        return found(Verdict.UNEXPLAINED if parts == "all" else Verdict.COMPLETE)

    load: Any = SimpleNamespace(names=("loaded",), is_sure=True, finding=lambda _: "its finding")
    monkeypatch.setattr(undisturbed, "may_be_loaded", lambda *_: False)
    monkeypatch.setattr(undisturbed, "other_bodies", lambda *_: (load,))
    monkeypatch.setattr(undisturbed, "find_once", once)
    monkeypatch.setattr(one_apart, "of_one_sensor", lambda parts: parts)
    monkeypatch.setattr(one_apart, "prepare", lambda part, *_: [s.name for s in part])
    a, loaded, other = (SimpleNamespace(name=n, whole="") for n in ("a", "loaded", held))
    signals: Any = ([a, loaded], [other], [other])
    parts: Any = "all"
    given: Any = None
    out = undisturbed.find(signals, parts, given, 1, lambda _: None)
    assert tuple(asked) == left and out.loads == ("its finding",)
    (decision,) = out.decisions
    if left:
        assert decision.kind == Verdict.COMPLETE
    else:
        assert (decision.kind, decision.loads) == (Verdict.UNEXPLAINED, ("loaded",))
