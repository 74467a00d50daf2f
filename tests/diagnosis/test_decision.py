"""What is claimed, and what is not: the decision on recordings that neither the fit nor any choice
has touched.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from made_claims import claim_of, of_one_claim
from reality import FAST, KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import nothing_named
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.report.files import no_reference
from zendsp.diagnosis.report.laws import law_chart
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import Term

Decided = Callable[..., Diagnosis]
pytestmark = pytest.mark.usefixtures("sizes_unasked")


def test_what_only_the_recordings_of_the_fit_show_is_not_claimed(decided: Decided) -> None:
    d = decided(reality.Machine(ripple=0.02), reality.Machine())
    assert d.findings == ()
    assert d.test is not None and d.test.improved <= d.test.calibrated


def test_what_the_recordings_of_the_fit_surely_show_leaves_the_verdict_open(
    tmp_path: Path,
) -> None:
    """A loose mass showed only in the recording of the fit, and report.json had said complete."""
    runs = [
        reality.save(
            tmp_path / f"{seed}.csv",
            reality.simulate(machine, reality.multisine(12.0, RATE, seed), RATE),
        )
        for seed, machine in ((1, reality.Machine(ripple=0.03)), (2, reality.Machine()))
    ]
    d = diagnose(runs[0], reality.model_file(tmp_path / "m.toml", RATE, *KNOWN), runs[1], jobs=1)
    assert d.findings == ()
    assert d.verdict == d.report()["verdict"] == "unexplained", "a script reads no headline"
    assert d.doubted == (("ripple", 1),) and d.headline.startswith("Cannot tell: ")
    assert "only the recordings of the fit show ripple" in d.unexplained


@pytest.mark.parametrize("held", [1, 0])
def test_an_effect_that_acts_only_in_the_shorter_recording_has_its_right_size(
    held: int, tmp_path: Path
) -> None:
    """Only the shorter one reaches the torque at which the actuator saturates."""
    machine, files = reality.Machine(weak=0.5), []
    for seconds, seed, size in ((12.0, 1, 0.3), (8.0, 2, 1.0), (9.0, 3, 1.0)):
        motion = reality.multisine(seconds, RATE, seed, size=size)
        columns = reality.simulate(machine, motion, RATE, seed)
        files.append(reality.save(tmp_path / f"run{seed}.csv", columns))
    model = reality.model_file(tmp_path / "model.toml", RATE, *KNOWN)
    (found,) = diagnose(files[:2], model, files[2:] if held else None, jobs=1).findings
    assert found.effect == "saturation"
    level = found.parameters["level"]
    assert level.value == pytest.approx(0.5, rel=0.01) and level.std < 0.01


def test_the_tail_of_a_stribeck_curve_is_chosen(decided: Decided) -> None:
    """Tustin's exponential, where Armstrong-Hélouvry has a Gaussian."""
    d = decided(reality.Machine(breakaway=0.05, stribeck=0.4, tail=1.0))
    (found,) = d.findings
    assert found.effect == "stribeck" and found.parameters["exponent"].value == 1.0
    assert " N m (coulomb)." in found.sentence.partition("It falls to ")[2]
    assert found.parameters["breakaway"].value == pytest.approx(0.05, rel=0.1)


def test_friction_that_falls_with_speed_is_found_upon_one_with_a_level_for_each_direction(
    decided: Decided,
) -> None:
    """It was a drag: no search tried a Stribeck curve upon such a friction."""
    each = reality.effect("coulomb_asymmetry", level_pos=0.03, level_neg=0.03)
    d = decided(reality.Machine(breakaway=0.05, stribeck=0.2), None, KNOWN[0], each)
    (found,) = d.findings
    assert found.effect == "stribeck"
    # the levels contain no breakaway: it is what the friction is more at rest
    assert found.parameters["breakaway"].value == pytest.approx(0.02, rel=0.1)
    assert found.parameters["velocity"].value == pytest.approx(0.2, rel=0.1)


SLOW = pytest.mark.long("the other falls as steeply as creep bends; lost: a gentle fall")


@pytest.mark.parametrize("speed", [0.08, pytest.param(0.3, marks=SLOW)])
def test_all_friction_that_a_model_lacks_is_a_stribeck_curve_and_viscous(
    decided: Decided, speed: float
) -> None:
    """Coulomb friction and drag are found first and give way to it. Creep at 1 mrad/s is a curve of
    its own: without it the Stribeck velocity would be 97 mrad/s instead of 80.
    """
    machine = reality.Machine(breakaway=0.06, stribeck=speed, tail=1.0, creep=1e-4)
    d = decided(machine, None, "")
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
    d = diagnose(runs[0], model, runs[1], jobs=1)
    assert d.verdict == "complete"
    assert any("hardly determine the numbers" in note for note in d.notes), d.notes
    less = reality.model_file(tmp_path / "less.toml", RATE, KNOWN[0])
    lacking = diagnose(runs[0], less, runs[1], jobs=1)
    assert lacking.verdict != "complete"


@pytest.mark.usefixtures("searched_once")
def test_a_position_far_off_in_recordings_too_short_to_say_by_what_torque_is_not_complete(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    _lacks(monkeypatch, Size(0.0, 0.0, 0.4))
    assert decided(reality.Machine()).verdict == "complete"
    _sensor(monkeypatch, 4.0)
    d = decided(reality.Machine())
    assert d.verdict == "unexplained"
    assert "up to 40 % of the torque may be missing" in d.unexplained


def _sensor(monkeypatch: pytest.MonkeyPatch, times: float) -> None:
    """The position is off by so many times what the sensor errs."""
    monkeypatch.setattr(nothing_named, "rms", lambda *_: times)
    monkeypatch.setattr(nothing_named, "least_error", lambda *_: 1.0)


def _lacks(monkeypatch: pytest.MonkeyPatch, size: Size) -> None:
    """So much of the torque is missing, in all recordings and with all numbers."""
    for module in (decision, nothing_named):
        monkeypatch.setattr(module, "discrepancy", lambda *_: size)


@pytest.mark.parametrize(
    ("low", "times", "left"), [(0.031, 17.0, True), (0.002, 27.0, False), (0.031, 1.5, False)]
)
def test_what_the_recordings_of_the_fit_surely_lack_is_not_complete(
    low: float, times: float, left: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A brake from 5 to 9 s took 3.7 % of the torque there, and 0.4 % of a faster chirp's."""
    _lacks(monkeypatch, Size(1.2 * low, low, 1.4 * low))
    monkeypatch.setattr(nothing_named, "window_error", lambda *_: None)
    _sensor(monkeypatch, times)
    base = SimpleNamespace(model=None)
    out = of_one_claim(claim_of(Term("ripple", 1, {}), 0.1), 0.004, 0.004, base)
    out = replace(out, kind=Verdict.COMPLETE, claims=())
    parts: Any = SimpleNamespace(fit=None)
    found = decision._beside_the_fit(out, parts)
    assert (found.kind == Verdict.UNEXPLAINED) is left
    assert found.after.low == (low if left else out.after.low)


@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize(
    ("lacks", "low", "times", "verdict"),
    [
        (0.005, 0.0, 17.0, "unexplained"),
        (0.0065, 0.0055, 5.0, "complete"),
        (0.012, 0.011, 4.0, "unexplained"),
        (0.02, 0.016, 1.0, "unexplained"),  # surely more than 1 %
        (0.02, 0.009, 2.5, "complete"),
        (0.002, 0.002, 1000.0, "complete"),
    ],
)
def test_a_small_torque_that_throws_the_position_far_off_is_missing(
    decided: Decided, monkeypatch: pytest.MonkeyPatch, lacks: float, low: float, times: float,
    verdict: str,
) -> None:
    """Commands dropped by a controller left 0.5 % of the torque, and had been called complete."""
    _lacks(monkeypatch, Size(lacks, low, 2 * lacks))
    _sensor(monkeypatch, times)
    assert decided(reality.Machine()).verdict == verdict


def test_commands_between_rows_by_a_faster_loop_are_not_missing_physics(tmp_path: Path) -> None:
    """The command is held more finely than it is recorded."""

    def verdict(machine: reality.Machine, model: Path) -> Diagnosis:
        runs = []
        for seed in (1, 2):
            run = reality.simulate(machine, reality.multisine(12.0, FAST, seed), FAST, seed)
            every = {name: column[::5] for name, column in run.items()}
            runs.append(reality.save(tmp_path / f"{seed}.csv", every))
        return diagnose(runs[0], model, runs[1], jobs=1)

    counts = 2 * np.pi / 8192
    held = reality.model_file(tmp_path / "held.toml", FAST / 5, *KNOWN, resolution=counts)
    faster = tmp_path / "faster.toml"
    faster.write_text(held.read_text().replace("hold = 0.01", f"hold = {1 / FAST}"))
    machine = reality.Machine(resolution=counts)
    taken_as_held = verdict(machine, held)
    assert taken_as_held.verdict == "unexplained"
    assert "[actuator] hold" in taken_as_held.unexplained
    (late,) = (note for note in taken_as_held.notes if "[actuator] hold" in note)
    assert "command column is 4.2 ms (0.42 rows) late" in late  # five commands a row
    d = verdict(machine, faster)
    assert d.verdict == "complete"
    assert sum("in between, lines stand" in note for note in d.notes) == 2
    assert verdict(replace(machine, wave=0.06), faster).verdict != "complete"


@pytest.mark.parametrize(("late", "claimed"), [(4, False), (13, True)])
def test_a_late_log_of_a_faster_loop_is_noted_and_is_no_finding(
    late: int, claimed: bool, tmp_path: Path
) -> None:
    """Four logs, late by 3 to 14 ms behind a filter, had become ten shifts of 8 to 20 ms at single
    joints.
    """
    runs = []
    for seed in (1, 2):
        motion = reality.multisine(12.0, FAST, seed)
        run = reality.simulate(reality.Machine(late=late), motion, FAST)
        every = {name: column[::5] for name, column in run.items()}
        runs.append(reality.save(tmp_path / f"{seed}.csv", every))
    model = reality.model_file(tmp_path / "m.toml", FAST / 5, *KNOWN)
    model.write_text(model.read_text().replace("hold = 0.01", f"hold = {1 / FAST}"))
    d = diagnose(runs[0], model, runs[1], jobs=1)
    assert [f.effect for f in d.findings] == ["column_shift"] * claimed
    times = [t.value("time") for t in d.improved.terms if t.effect == "column_shift"]
    assert times == pytest.approx([late / FAST], rel=0.05)
    told = [note for note in d.notes if "command column is 8 ms (0.8 rows) late" in note]
    assert bool(told) is not claimed


@pytest.mark.usefixtures("searched_once")
def test_what_acts_surely_and_drowns_in_what_stays_unexplained_is_not_complete(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = reality.Machine(ripple=0.003)
    assert [f.effect for f in decided(machine).findings] == ["ripple"]
    monkeypatch.setattr(decision, "held_apart", lambda *a: ([], a[-1]))
    monkeypatch.setattr(nothing_named, "_asked", lambda out, *_: out)
    assert decided(machine).verdict == "unexplained"
    assert decided(reality.Machine()).verdict == "complete"


def test_one_mechanism_is_one_finding(decided: Decided) -> None:
    d = decided(reality.Machine(breakaway=0.05), None, KNOWN[0])
    assert [f.mechanism for f in d.findings] == ["dry_friction"]


@pytest.mark.parametrize("held", [0.0, 0.02])
def test_friction_that_differs_with_the_direction_is_friction_and_a_constant_by_algebra(
    held: float, decided: Decided
) -> None:
    """Also beside a constant that the model holds fixed, such as a weight stated as known."""
    machine = reality.Machine(push=(0.012 + held, 0.0, 99.0))
    known = reality.effect("torque_offset", level=-held).replace(" }", ", free = false }")
    d = decided(machine, None, KNOWN[0], *[known] * bool(held))
    found = {f.effect: f.indistinguishable for f in d.findings}
    assert set(found) == {"coulomb", "torque_offset"}
    assert all("coulomb_asymmetry" in same for same in found.values())
    # a chirp was proposed to tell one torque from itself, and the next diagnosis was as open
    assert d.next_recording is not None and d.next_recording.reference is None
    assert "No recording tells coulomb and torque_offset at joint 1" in d.next_recording.sentence
    assert no_reference(d) == "no motion tells apart what is left open"  # it names no experiment


def test_coulomb_friction_of_a_joint_that_moves_one_way_cannot_be_told_from_a_constant(
    tmp_path: Path
) -> None:
    t = np.arange(6000) / RATE
    motion = 1.5 * t + 0.5 * np.sin(2.0 * t) + 0.04 * np.sin(9.0 * t)
    machine = reality.Machine(push=(0.012, 0.0, 99.0))
    run = reality.save(tmp_path / "run.csv", reality.simulate(machine, motion, RATE))
    d = diagnose(run, reality.model_file(tmp_path / "m.toml", RATE, KNOWN[0]), jobs=1)
    (found,) = (f for f in d.findings if f.effect in ("coulomb", "torque_offset"))
    assert {found.effect, *found.indistinguishable} >= {
        "coulomb", "torque_offset", "coulomb_asymmetry"
    }  # fmt: skip
    assert any("never reverses" in note for note in d.notes) and d.next_recording is not None


def test_a_law_is_named_beside_the_discrepancy_that_the_model_file_states(
    decided: Decided, tmp_path: Path
) -> None:
    """The model file hands it from one diagnosis to the next."""
    before = decided(reality.Machine(unrest=0.0035))
    assert before.verdict == "complete" and before.improved.discrepancy.torque[0] > 0.0015
    sprung = reality.Machine(unrest=0.0035, spring=0.035)
    plain = decided(sprung)
    assert [f.effect for f in plain.findings] == ["unknown"]
    again = diagnose(
        tmp_path / "run1.csv",
        parse_model(tomllib.loads(model_text(before.improved))),
        tmp_path / "run2.csv",
        jobs=1,
    )
    assert [f.effect for f in again.findings] == ["stiffness"]
    assert again.findings[0].parameters["coefficient"].value == pytest.approx(0.035, rel=0.06)


@pytest.mark.parametrize(("known", "verdict"), [("", "missing"), (", std = 0.002", "complete")])
def test_calibration_may_move_a_number_as_far_as_the_model_file_says_that_it_is_known(
    known: str, verdict: str, recorded: Callable[..., list[Path]], tmp_path: Path
) -> None:
    """The given number is a quarter too large."""
    runs = recorded(reality.Machine())
    model = reality.model_file(tmp_path / "rough.toml", RATE, *KNOWN, inertia=0.0125)
    text = model.read_text().replace("value = 0.0125", f"value = 0.0125{known}")
    model.write_text(text)
    d = diagnose(runs[0], model, runs[1], jobs=1)
    assert (d.verdict, [f.effect for f in d.findings]) == (
        verdict,
        ["inertia"] if verdict == "missing" else [],
    )


@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
def test_the_figure_of_a_ripple_shows_one_period_with_the_amplitude_of_the_sentence(
    decided: Decided
) -> None:
    """Twelve periods over the travel, passed fast: in forty bins they had looked like another wave.
    """
    d = decided(reality.Machine(ripple=0.02, order=40))
    (found,) = d.findings
    assert found.effect == "ripple" and d.workings is not None
    panel = law_chart(d, d.workings, found, 0).panels[0]
    period = 2 * np.pi / found.parameters["order"].value
    assert f"within a period of {period:.4g} rad" in panel.xlabel
    for kind in ("means", "line"):
        drawn = next(series for series in panel.series if series.kind == kind)
        assert np.min(drawn.x) >= 0.0 and np.max(drawn.x) <= period
        assert np.ptp(drawn.y) / 2 == pytest.approx(0.02, rel=0.2)


def test_the_figure_of_a_friction_over_position_shows_its_law(decided: Decided) -> None:
    """Both directions of travel, one turned over: their mean would hide what was found."""
    d = decided(reality.Machine(uneven=0.01))
    (found,) = d.findings
    assert found.effect == "position_friction" and d.workings is not None
    panel = law_chart(d, d.workings, found, 0).panels[0]
    means = next(series for series in panel.series if series.kind == "means")
    assert "against the motion" in panel.ylabel
    amplitude = found.parameters["amplitude"].value
    assert np.max(means.y) == pytest.approx(amplitude, rel=0.2)
    assert np.corrcoef(means.y, np.sin(7 * means.x))[0, 1] > 0.95  # it resists
