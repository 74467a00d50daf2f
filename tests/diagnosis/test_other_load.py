"""A load that only held-out recordings have is named, and is no push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import reality
from reality import KNOWN

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import other_load, pushes
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.headline import verdict_sentence
from zendsp.diagnosis.decide.outcome import of_other_loads

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

    lacks = {"fit": fit, "held": held}

    def left(data: Data, model: str, joint: int) -> Any:
        value = lacks[data.records[0][0].recording][model == "own"]
        return SimpleNamespace(value=value, high=1.2 * value)

    monkeypatch.setattr(pushes, "discrepancy", left)
    monkeypatch.setattr(pushes, "fitted_to", lambda *_: SimpleNamespace(model="own"))
    parts: Any = SimpleNamespace(
        **{k: Data(((SimpleNamespace(recording=k),),)) for k in ("fit", "held")}
    )
    out: Any = SimpleNamespace(joint=1, final=SimpleNamespace(model="base"))
    assert pushes.by_own_numbers(out, parts, 1) == said
