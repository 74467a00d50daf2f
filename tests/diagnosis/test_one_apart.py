"""Recordings that do not agree: one with its own load, its own friction, or another zero."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import reality
from reality import KNOWN, RATE, effect

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.own_numbers import by_recording, of_numbers, other_zeros, own_of_one
from zendsp.diagnosis.decide.pushes import fitted_to
from zendsp.diagnosis.explain import one_apart, undisturbed
from zendsp.diagnosis.explain.machine import Found
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import load_model
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model

pytestmark = pytest.mark.usefixtures("sizes_unasked")
ORDER = 7
RIPPLED = reality.Machine(ripple=0.02, order=ORDER)
RIPPLE = effect("ripple", order=ORDER, amplitude=0.02, phase=0.0)


def made(
    folder: Path, name: str, machine: reality.Machine, seed: int, zero: float = 0.0
) -> Path:
    """A recording of six seconds, its positions beyond those of the others by ``zero``, rad."""
    columns = reality.simulate(machine, reality.multisine(6.0, RATE, seed), RATE, seed)
    for key in ("q", "r"):
        if key in columns:
            columns[key] = columns[key] + zero
    return reality.save(folder / f"{name}.csv", columns)


def data_of(paths: list[Path], model: Model) -> Data:
    return prepare([read_signals(p, model) for p in paths], model, 32.0)


def rippled(tmp_path: Path) -> Model:
    path = reality.model_file(tmp_path / "rippled.toml", RATE, *KNOWN, RIPPLE)
    return kernel_model(load_model(path))


@pytest.mark.parametrize("zero", [0.25, -0.3])
def test_a_law_over_the_position_shows_where_another_recording_was_zeroed(
    zero: float, tmp_path: Path
) -> None:
    """A ripple of 7 % of the torque, in one recording shifted by 0.37 rad, was a disturbance of 85
    %.
    """
    model = rippled(tmp_path)
    found = calibrate_joint(data_of([made(tmp_path, "a", RIPPLED, 1)], model), model, 1)
    other = data_of([made(tmp_path, "b", RIPPLED, 2, zero)], model)
    zeros = other_zeros({"b": other}, found, 1, 1)
    assert zeros is not None
    assert abs(zeros["b"].value - zero) < 3.0 * zeros["b"].std < 0.02


def test_neither_a_push_nor_a_recording_that_lacks_nothing_has_another_zero(
    tmp_path: Path,
) -> None:
    model = rippled(tmp_path)
    found = calibrate_joint(data_of([made(tmp_path, "a", RIPPLED, 1)], model), model, 1)
    pushed = replace(RIPPLED, push=(0.2, 2.0, 3.0))
    plain = data_of([made(tmp_path, "b", RIPPLED, 2)], model)
    assert other_zeros({"b": plain}, found, 1, 1) == {}
    other = data_of([made(tmp_path, "c", pushed, 2)], model)
    assert other_zeros({"b": plain, "c": other}, found, 1, 1) is None


def test_the_numbers_of_the_one_recording_that_has_its_own_are_said(tmp_path: Path) -> None:
    """A machine whose friction was a third lower in the third of four recordings was "another load
    perhaps" of three of them.
    """
    model = kernel_model(load_model(reality.model_file(tmp_path / "model.toml", RATE, *KNOWN)))
    warm = reality.Machine(coulomb=0.02)
    plain = reality.Machine()
    paths = [made(tmp_path, n, warm if n == "c" else plain, k) for k, n in enumerate("abcd", 1)]
    fit, held = data_of(paths[:3], model), data_of(paths[3:], model)
    parts = Parts(fit, held, held)
    base = calibrate_joint(fit, model, 1)
    (own,) = own_of_one(parts, base, model, 1, 1)
    assert (Path(own.recording).name, own.name) == ("c.csv", "coulomb level")
    assert abs(own.now.value - 0.02) < 3.0 * own.now.std < 0.002
    assert abs(own.others.value - 0.03) < 3.0 * own.others.std < 0.002
    (said,) = of_numbers([own])
    assert "c.csv alone has other numbers: coulomb level 0.0" in said
    two = Parts(data_of([paths[0]], model), held, held)
    assert own_of_one(two, base, model, 1, 1) == (), "of two none is the one"


def test_a_recording_alone_is_fitted_within_its_own_inertia(tmp_path: Path) -> None:
    """25 % more in one of four recordings came out at 23 %, since all of them bounded it."""
    model = kernel_model(load_model(reality.model_file(tmp_path / "model.toml", RATE, *KNOWN)))
    heavy, plain = reality.Machine(inertia=0.0125), reality.Machine()
    paths = [made(tmp_path, n, heavy if n == "b" else plain, k) for k, n in enumerate("abcd", 1)]
    fit, held = data_of(paths[:3], model), data_of(paths[3:], model)
    base = calibrate_joint(fit, model, 1)
    data = by_recording(Parts(fit, held, held), model, 1)[str(paths[1])]
    own = fitted_to(data, base, 1, 1).model.mechanism["inertia"][0].value
    assert own == pytest.approx(0.0125, rel=0.003)


def diagnosed(
    folder: Path, *machines: tuple[reality.Machine, float], given: tuple[str, ...] = KNOWN
) -> Diagnosis:
    """The diagnosis of recordings of machines, each with its zero; the last is held out."""
    paths = [made(folder, f"run{k}", m, k, zero) for k, (m, zero) in enumerate(machines, 1)]
    model = reality.model_file(folder / "model.toml", RATE, *given)
    return diagnose(paths[:-1], model, paths[-1:], jobs=1)


@pytest.mark.parametrize(("push", "zero"), [(0.0, 0.25), (0.2, 0.0), (0.2, 0.25)])
def test_a_ripple_in_a_recording_zeroed_elsewhere_is_no_push(
    push: float, zero: float, tmp_path: Path
) -> None:
    """What is found in the undisturbed rest is asked of the pushed recording, with its own zero."""
    model = rippled(tmp_path)
    other = replace(RIPPLED, push=(push, 2.0, 3.0))
    paths = [made(tmp_path, "a", RIPPLED, 1), made(tmp_path, "b", other, 2, zero)]
    rest, every = data_of(paths[:1], model), data_of(paths, model)
    no: Any = None
    first = Decision(1, Verdict.DISTURBANCE, (), (), no, no, no, no, no, no, no, 1.0)
    bursts: Any = SimpleNamespace(recordings=(str(paths[1]),))
    law = replace(first, kind=Verdict.MISSING, final=calibrate_joint(rest, model, 1))

    def found(data: Data, decision: Decision) -> Found:
        return Found(Parts(data, rest, rest), no, no, no, [], [], [decision], no, ())

    pushed = found(every, replace(first, bursts=bursts))
    zeroed = undisturbed._zeroed_elsewhere(pushed, found(rest, law), 1)
    assert (zeroed is None) is (push > 0.0)
    if zeroed is not None:
        (said,) = zeroed.decisions[0].differs
        assert f"{paths[1]} has its own zero of the position: its column is 0.2" in said
        assert f"beyond that of {paths[0]}," in said and "Add -0.2" in said


def test_a_law_is_found_where_each_recording_was_zeroed_elsewhere(tmp_path: Path) -> None:
    """Of three such recordings none was explained, and one alone was."""
    d = diagnosed(tmp_path, (RIPPLED, 0.0), (RIPPLED, 0.3), (RIPPLED, -0.2))
    assert [f.effect for f in d.findings] == ["ripple"]
    assert sum("its own zero of the position" in n for n in d.notes) == 2


@pytest.mark.parametrize(
    ("mechanism", "asked"), [("fluid_friction", False), ("position_torque", True)]
)
def test_no_recording_is_asked_alone_for_a_torque_that_no_place_changes(
    mechanism: str, asked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the time of EMPS went there, whose fluid friction is more than any law of it."""
    model = rippled(tmp_path)
    signals = [read_signals(made(tmp_path, name, RIPPLED, 1), model) for name in "abc"]
    parts = Parts(*(prepare([s], model, 64.0) for s in signals))
    claim: Any = SimpleNamespace(effect="unknown", mechanism=mechanism)
    decision: Any = SimpleNamespace(kind=Verdict.MISSING, bursts=None, loads=(), claims=(claim,))
    found: Any = SimpleNamespace(decisions=[decision], parts=parts)
    alone: list[str] = []
    monkeypatch.setattr(one_apart, "find_once", lambda *_: alone.append(mechanism))
    monkeypatch.setattr(one_apart, "with_other_zeros", lambda *_: None)
    every = [[s] for s in signals]
    assert one_apart.by_one_alone(found, every, model, 1, lambda _: None) is found
    assert bool(alone) is asked


def test_the_load_of_one_recording_and_a_law_missing_in_all_are_both_named(
    tmp_path: Path,
) -> None:
    """Numbers between the two loads had left a position torque without a law."""
    heavy = replace(RIPPLED, inertia=0.0125)
    d = diagnosed(tmp_path, (RIPPLED, 0.0), (heavy, 0.0), (RIPPLED, 0.0), (RIPPLED, 0.0))
    load, law = d.findings
    assert (load.effect, law.effect) == ("inertia", "ripple")
    amount = load.parameters["amount"]
    assert abs(amount.value - 0.0025) < 3.0 * amount.std < 0.0003
    assert load.is_elsewhere and [Path(n).name for n in load.numbers["recordings"]] == ["run2.csv"]
