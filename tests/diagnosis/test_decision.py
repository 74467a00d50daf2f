"""What is claimed, and what is not: the decision on recordings that neither the fit nor any choice
has touched.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import reality

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import laws, pieces
from zendsp.diagnosis.decide.claims import Piece
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.evidence import Evidence
from zendsp.diagnosis.measure.structure import Structure
from zendsp.physics.model import Term

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


@pytest.mark.parametrize("foreign", [{"swirl": 0.008}, {"blend": 0.005}])
def test_a_small_function_of_state_is_seen_and_gets_no_name_that_it_only_resembles(
    foreign: dict[str, float], tmp_path: Path
) -> None:
    d = decided(tmp_path, reality.Machine(**foreign))
    assert d.verdict in ("missing", "unexplained")
    assert all(f.effect == "unknown" for f in d.findings), d.findings


def test_a_push_is_a_disturbance_with_its_times(tmp_path: Path) -> None:
    d = decided(
        tmp_path, reality.Machine(push=(0.06, 2.0, 4.0)), reality.Machine(push=(0.06, 8.0, 10.0))
    )
    assert [f.effect for f in d.findings] == ["disturbance"]
    spans = d.findings[0].numbers["intervals"]
    assert spans[0][0] == pytest.approx(8.0, abs=0.2) and spans[-1][1] == pytest.approx(
        10.0, abs=0.2
    )
    assert d.findings[0].parameters["peak"].value == pytest.approx(0.06, rel=0.3)


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


def piece(size: float, z: float, log_e: float) -> Piece:
    term = Term("ripple", 1, {})
    evidence = Evidence(gain=2 * log_e, z=z, blocks=np.zeros(1))
    return Piece("position_torque", (term,), SimpleNamespace(), size, evidence, log_e)  # type: ignore[arg-type]


def test_only_what_untouched_recordings_bear_out_by_chance_too_rarely_is_claimed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pieces, "discrepancy", lambda *_: Size(0.01, 0.0, 0.02))
    monkeypatch.setattr(pieces, "structure", lambda *_: Structure(0.01, 0.5, 1.0))
    monkeypatch.setattr(pieces, "_kept_laws", lambda *_: [])
    parts = SimpleNamespace(test=SimpleNamespace(joints=1), each=())
    final = SimpleNamespace(model=None)
    sure, unlikely, uneven, small = (
        piece(0.1, 5.0, 20.0),
        piece(0.1, 5.0, 3.0),
        piece(0.1, 1.0, 20.0),
        piece(0.005, 5.0, 20.0),
    )
    claimed, rest = pieces.held_apart(
        parts,
        None,
        final,
        1,
        [sure, unlikely, uneven, small],  # type: ignore[arg-type]
    )
    assert claimed == [sure] and rest == [unlikely, uneven, small]


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
