"""The diagnosis names what a machine of independent code has and the given model has not, and stays
silent where nothing is missing.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import FAST, KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import naming
from zendsp.diagnosis.report.figures import charts
from zendsp.physics.files.draft import draft_model
from zendsp.recording import read_table

VISCOUS, COULOMB = KNOWN
LONGER = (9.0, 7.0)  # s: what six seconds show less surely


def _held(effect: str) -> str:
    """The same effect, its numbers held fixed."""
    return effect.replace(" }", ", free = false }")


@dataclass
class Case:
    """True machine, effects of the given model, and what must be found: effect -> parameter -> true
    value.
    """

    machine: reality.Machine
    given: list[str]
    found: dict[str, dict[str, float]]
    reference: dict[str, float] = field(default_factory=dict)
    seconds: tuple[float, float] = (6.0, 6.0)
    rate: float = RATE


SINGLE: dict[str, Case] = {
    "viscous missing": Case(reality.Machine(), [COULOMB], {"viscous": {"coefficient": 0.004}}),
    "coulomb absorbed into viscous": Case(
        reality.Machine(), [VISCOUS], {"coulomb": {"level": 0.03}}
    ),
    "coulomb that is held, and wrong": Case(
        reality.Machine(coulomb=0.04),
        [_held(VISCOUS), _held(COULOMB)],
        {"coulomb": {"level": 0.04}},
    ),
    "viscous that is held, and wrong": Case(
        reality.Machine(viscous=0.008),
        [_held(VISCOUS), _held(COULOMB)],
        {"viscous": {"coefficient": 0.008}},
    ),
    "drag": Case(
        reality.Machine(drag=0.004), [VISCOUS, COULOMB], {"quadratic_drag": {"coefficient": 0.004}}
    ),
    "stribeck": Case(
        reality.Machine(breakaway=0.06),
        [VISCOUS, COULOMB],
        {"stribeck": {"breakaway": 0.06, "velocity": 0.1}},
        {"size": 0.5},
    ),
    "stribeck with a tail of its own": Case(
        reality.Machine(breakaway=0.06, tail=1.4, creep=1e-4),
        [VISCOUS, COULOMB],
        {"stribeck": {"breakaway": 0.06, "velocity": 0.1, "exponent": 1.4}},
        {"size": 0.5},
        rate=FAST,
    ),
    "dry friction and its bristles": Case(
        reality.Machine(coulomb=0.06, bristle=2.0, brush=0.006),
        [VISCOUS],
        {"coulomb": {"level": 0.06}, "presliding": {"stiffness": 2.0}},
        {"size": 0.1, "low": 0.5},
        LONGER,
    ),
    "ripple": Case(
        reality.Machine(ripple=0.02),
        [VISCOUS, COULOMB],
        {"ripple": {"order": 7.0, "amplitude": 0.02, "phase": 0.4}},
    ),
    "gravity": Case(
        reality.Machine(gravity=0.15), [VISCOUS, COULOMB], {"gravity": {"torque": 0.15}}
    ),
    "spring": Case(
        reality.Machine(spring=0.08), [VISCOUS, COULOMB], {"stiffness": {"coefficient": 0.08}}
    ),
    "delay": Case(
        reality.Machine(delay=0.004), [VISCOUS, COULOMB], {"delay": {"time": 0.004}}, {"high": 12.0}
    ),
    "saturation far below the commands": Case(
        reality.Machine(weak=0.15),
        [VISCOUS, COULOMB],
        {"saturation": {"level": 0.15}},
        {"size": 2.0, "high": 3.0},
        LONGER,
    ),
    "pair": Case(
        reality.Machine(ripple=0.02, drag=0.004),
        [VISCOUS, COULOMB],
        {"ripple": {"amplitude": 0.02}, "quadratic_drag": {"coefficient": 0.004}},
    ),
}


Run = Callable[[Case], Diagnosis]


@pytest.fixture
def run(bench: Callable[..., Diagnosis]) -> Run:
    return lambda case: bench(case.machine, case.given, case.seconds, case.rate, **case.reference)


@pytest.mark.parametrize("name", SINGLE)
def test_missing_effect_is_named_with_its_parameters(name: str, run: Run) -> None:
    case = SINGLE[name]
    d = run(case)
    assert d.verdict == "missing"
    assert {f.effect for f in d.findings} == set(case.found)
    for f in d.findings:
        assert f.joint == 1 and f.confidence > 0.5
        assert not set(f.indistinguishable) & set(case.found)
        for key, true in case.found[f.effect].items():
            # 4 %: the target of issue 5 is 3 % in the median, and reality's friction has a slope of
            # its own below 1 mrad/s
            assert f.parameters[key].value == pytest.approx(true, rel=0.04), key
    # nine tenths of the gap between calibrated and noise floor closed on the recording that was
    # held out
    h = d.heldout
    assert h.calibrated - h.improved > 0.9 * (h.calibrated - d.noise_floor)


def test_a_gap_is_named_with_its_width_and_the_inertia_behind_it(run: Run) -> None:
    d = run(Case(reality.Machine(gap=0.03, load=0.004), [VISCOUS, COULOMB], {}))
    assert [f.effect for f in d.findings] == ["backlash"]
    assert d.findings[0].parameters["gap"].value == pytest.approx(0.03, rel=0.03)
    assert d.findings[0].parameters["load_inertia"].value == pytest.approx(0.004, rel=0.03)
    # a contact that comes a little too early goes another way: not all of the error can be closed
    assert d.heldout.improved < 0.25 * d.heldout.calibrated


@pytest.mark.parametrize(("size", "high", "counts"), [(1.0, 4.0, 16384), (0.15, 1.0, 4096)])
def test_complete_model_raises_no_alarm(
    size: float, high: float, counts: int, run: Run
) -> None:
    resolution = 2 * np.pi / counts
    case = Case(
        reality.Machine(resolution=resolution), [VISCOUS, COULOMB], {}, {"size": size, "high": high}
    )
    d = run(case)
    assert d.verdict == "complete" and d.findings == () and d.regions == ()


@pytest.mark.parametrize("lead", [0.0, 0.01])
def test_a_known_friction_that_creeps_is_no_missing_physics_and_hides_none(
    lead: float, run: Run
) -> None:
    machine = reality.Machine(creep=0.03, lead=lead)
    soft = Case(machine, [VISCOUS, COULOMB], {}, seconds=LONGER, rate=FAST)
    complete = run(soft)
    (note,) = [note for note in complete.notes if "creeps" in note]
    assert complete.verdict == "complete" and ("10 ms before the joint does" in note) == (lead > 0)
    ripple = replace(soft, machine=replace(machine, ripple=0.006))
    (found,) = run(ripple).findings
    assert found.effect == "ripple"
    assert found.parameters["amplitude"].value == pytest.approx(0.006, rel=0.05)


@pytest.mark.usefixtures("sizes_unasked")
def test_a_fast_ripple_is_found_though_the_held_out_recording_has_another_zero(
    tmp_path: Path,
) -> None:
    fine = 2 * np.pi / 2**17
    machine = reality.Machine(ripple=0.003, order=57, kp=8.0, kd=0.3, resolution=fine)
    files = []
    for name, seed, zero in (("train", 1, 0.0), ("heldout", 2, 4000 * fine)):
        run = reality.simulate(machine, reality.multisine(8.0, FAST, seed, size=2.0), FAST)
        files.append(
            reality.save(
                tmp_path / f"{name}.csv", {**run, "q": run["q"] + zero, "r": run["r"] + zero}
            )
        )
    said: list[str] = []
    d = diagnose(
        files[0],
        reality.model_file(tmp_path / "model.toml", FAST, VISCOUS, resolution=fine),
        files[1],
        jobs=1,
        progress=said.append,
    )
    assert {f.effect for f in d.findings} == {"coulomb", "ripple"}
    assert sum("each mechanism" in step for step in said) == 1, "decided upon it, and not before"
    ripple = next(f for f in d.findings if f.effect == "ripple")
    assert ripple.parameters["order"].value == pytest.approx(57, abs=0.3)
    assert ripple.parameters["amplitude"].value == pytest.approx(0.003, rel=0.1)
    (chart,) = (c for c in charts(d) if c.finding == d.findings.index(ripple))
    without, with_ = (panel.series[1].y for panel in chart.panels)  # means over a period
    assert np.ptp(without) > 0.002, "rows of 2 ms allow an observer that passes a third of 0.006"
    assert np.ptp(with_) < 0.3 * np.ptp(without)


def test_what_no_effect_describes_is_unexplained(run: Run) -> None:
    d = run(Case(reality.Machine(wave=0.05), [VISCOUS, COULOMB], {}))
    assert d.verdict == "unexplained" and d.findings == ()
    assert d.regions and "N m" in d.unexplained
    assert d.next_recording is not None and d.next_recording.reference is not None
    motion, period = d.next_recording.reference
    assert motion.shape == (round(10.0 / period), 1), "can be played, as `n` and --run do"
    sentence = d.next_recording.sentence
    assert "as a multisine over the recorded range does (10 s, " in sentence
    assert "farther or faster than it did" in sentence, "the motion goes no farther itself"


def test_a_torque_that_nothing_predicts_is_reported(run: Run) -> None:
    d = run(Case(reality.Machine(unrest=0.016), [VISCOUS, COULOMB], {}))
    assert d.verdict == "unexplained" and d.findings == ()
    assert "nor any smooth function of the joint's state" in d.unexplained


def test_wrong_term_of_the_given_model_is_replaced(run: Run) -> None:
    wrong = reality.effect("viscous", coefficient=0.01)
    d = run(Case(reality.Machine(viscous=0.0, drag=0.006), [wrong, COULOMB], {}))
    assert [f.effect for f in d.findings] == ["quadratic_drag"]
    assert d.findings[0].replaces == ("viscous",)
    told = "It stands in the place of the given model's term viscous (fluid friction)."
    assert told in d.findings[0].sentence
    # what the search took on its way is none of the given model's terms
    claim: Any = SimpleNamespace(replaces=("viscous", "creep"), mechanism="fluid_friction")
    whole: Any = None
    assert naming._replaced(d.given, whole, claim, 1) == ("viscous",)
    assert {t.effect for t in d.improved.terms} == {"quadratic_drag", "coulomb"}


def test_a_number_that_calibration_moves_far_is_reported(run: Run) -> None:
    gain = 1.2  # as an actuator that gives so much more
    machine = reality.Machine(inertia=0.01 / gain, viscous=0.004 / gain, coulomb=0.03 / gain)
    d = run(Case(machine, [VISCOUS, COULOMB], {}, seconds=LONGER, rate=FAST))
    (note,) = (n for n in d.notes if "calibration moves" in n)
    assert "coulomb level 0.03 to 0.025 (-17 %)" in note and "as a torque gain of 1.2" in note
    (found,) = d.findings  # one number explains what three would
    assert (found.effect, found.indistinguishable) == ("torque_gain", ("inertia",))
    ratio = found.parameters["ratio"]
    assert ratio.value == pytest.approx(0.2, abs=0.01)
    # of three given numbers each is off by 4.5 %
    assert ratio.std == pytest.approx(1.2 * 0.045 / 3**0.5, rel=0.05)
    d = run(Case(reality.Machine(), [VISCOUS, COULOMB], {}))
    assert not any("calibration moves" in n for n in d.notes)


@pytest.mark.usefixtures("sizes_unasked")
def test_several_recordings_are_fitted_jointly(tmp_path: Path) -> None:
    machine = reality.Machine()
    files = [
        reality.save(
            tmp_path / f"run{s}.csv",
            reality.simulate(machine, reality.multisine(6.0, RATE, s), RATE),
        )
        for s in (1, 2, 3)
    ]
    model = reality.model_file(tmp_path / "model.toml", RATE, VISCOUS)
    one, three = (diagnose(runs, model, jobs=1) for runs in (files[0], files))
    assert [f.effect for f in three.findings] == ["coulomb"] == [f.effect for f in one.findings]
    # three times the samples: the statistical standard deviation falls by about the root of three;
    # that of the numerics stays
    spread = [
        dict(
            zip(
                (h.key for h in d.workings.whole.fits[1].handles),
                d.workings.whole.fits[1].std,
                strict=True,
            )
        )["level"]
        for d in (one, three)
    ]
    assert spread[1] < 0.8 * spread[0]
    assert three.findings[0].parameters["level"].std < one.findings[0].parameters["level"].std


def test_user_effect_is_named(tmp_path: Path) -> None:
    """A file of one's own effect, and a recording that has it: it is named, with its number."""
    file = tmp_path / "lubricant.py"
    file.write_text(
        "from zendsp.physics.effects import Effect, Parameter\n"
        "strength = Parameter('strength', 'torque/speed', lower=0)\n"
        "FILM = Effect(\n"
        "    name='film', site='torque', parameters=(strength,), linear=('strength',),\n"
        "    c='return p[0] * s->qd / (1.0 + s->qd * s->qd);', equation='w qd / (1 + qd^2)',\n"
        "    sentence='Joint {joint} has a film of {strength}.',\n"
        "    experiment='Speeds around 1 rad/s.',\n"
        ")\n"
    )
    machine = reality.Machine(wiggle=0.05)
    for name, seed in (("a", 1), ("b", 2)):
        reality.save(
            tmp_path / f"{name}.csv",
            reality.simulate(machine, reality.multisine(6.0, RATE, seed, high=2.0), RATE),
        )
    reality.model_file(tmp_path / "model.toml", RATE, VISCOUS, COULOMB)
    # a process of its own: loaded effects stay in the library; its C is that of docs/effects.md, so
    # that the kernel with it is compiled once for this and the page
    entry = "from zendsp.cli import main; main()"
    command = [
        sys.executable,
        "-c",
        entry,
        "diagnose",
        "a.csv",
        "--model",
        "model.toml",
        "--heldout",
        "b.csv",
        "--effects",
        "lubricant.py",
        "--json",
    ]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    assert [f["effect"] for f in report["findings"]] == ["film"]
    assert report["findings"][0]["parameters"]["strength"]["value"] == pytest.approx(0.05, rel=0.05)
    assert "film" in report["findings"][0]["sentence"]


def test_file_that_defines_no_effect_is_refused(
    tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    (tmp_path / "none.py").write_text("x = 1\n")
    words = ("a.csv", "--model", "m.toml", "--effects", tmp_path / "none.py")
    status, _, err = typed("diagnose", *words)
    assert status == 2 and "none.py" in err


@pytest.mark.usefixtures("sizes_unasked")
def test_a_drafted_model_of_joints_of_unlike_inertia_leads_to_their_friction(
    tmp_path: Path,
) -> None:
    # dry friction is most of the light joint's torque: its inertia must not be sought where the
    # heavy joint's is
    light = reality.Machine(viscous=0.05, coulomb=0.1)
    heavy = reality.Machine(inertia=0.08, viscous=0.06, coulomb=0.06, kp=24.0, kd=0.96)
    runs = [
        reality.simulate(machine, reality.multisine(9.0, RATE, seed), RATE)
        for seed, machine in enumerate((light, heavy))
    ]
    both = {
        f"{key}{j} [{unit}]": run[key]
        for j, run in enumerate(runs, 1)
        for key, unit in (("q", "rad"), ("u", "N m"))
    }
    run = reality.save(tmp_path / "run.csv", {"t [s]": runs[0]["t"]} | both)
    draft = draft_model(read_table(run)).text
    (tmp_path / "model.toml").write_text(draft)
    found = diagnose([run], tmp_path / "model.toml", jobs=1)
    assert {(f.effect, f.joint) for f in found.findings} == {
        (effect, joint) for effect in ("coulomb", "viscous") for joint in (1, 2)
    }
    size = {(f.effect, f.joint): next(iter(f.parameters.values())).value for f in found.findings}
    for joint, machine in enumerate((light, heavy), 1):
        # 3 %: the draft knows neither the delay nor what a sample holds
        assert size["coulomb", joint] == pytest.approx(machine.coulomb, rel=0.03)
        assert size["viscous", joint] == pytest.approx(machine.viscous, rel=0.03)
