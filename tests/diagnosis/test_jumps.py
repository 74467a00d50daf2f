"""What sensors and loggers do to a position: single rows off, counters that begin anew, zeros that
differ, few digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reality
from acceptance import accepted
from mistakes import Columns
from reality import FAST, KNOWN

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.checks import check_signals
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.decide.findings import Estimate
from zendsp.diagnosis.decide.naming import _turned
from zendsp.diagnosis.decide.zeros import check_zeros
from zendsp.errors import RecordingError
from zendsp.physics.calibration.fit import Data
from zendsp.physics.files.model_file import load_model
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.term_numbers import kernel_model

WEIGHT = 0.1  # N m


def read(columns: Columns, model: Path, tmp_path: Path) -> tuple[np.ndarray, list[str]]:
    file = reality.save(tmp_path / "a.csv", columns)
    signals = read_signals(file, kernel_model(load_model(model)))
    return signals.position[:, 0], list(signals.notes)


@pytest.mark.parametrize("count", [1, 12])
def test_single_rows_that_stand_out_are_mended_and_said(
    count: int, good: Columns, model: Path, tmp_path: Path
) -> None:
    """With 12 of them the columns were "of different runs"; one was refused."""
    true, _ = read(good, model, tmp_path)
    rows = np.random.default_rng(3).choice(np.arange(50, len(true) - 50, 9), count, replace=False)
    noisy = {**good, "q": good["q"].copy()}
    noisy["q"][rows] += 0.5 * (-1.0) ** np.arange(count)
    mended, notes = read(noisy, model, tmp_path)
    assert np.max(np.abs(mended - true)) < 4 * reality.RESOLUTION
    (said,) = (note for note in notes if "single row" in note)
    assert f"is off for {count} single row" in said and f"(first in row {min(rows) + 1})" in said


def test_a_position_full_of_such_rows_is_not_mended(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    noisy = {**good, "q": good["q"].copy()}
    noisy["q"][50:-50:40] += 0.5
    assert not any("single row" in note for note in read(noisy, model, tmp_path)[1])


@pytest.mark.parametrize("size", [512 * reality.RESOLUTION, 0.3])
def test_a_counter_that_begins_anew_is_put_together_and_said(
    size: float, good: Columns, model: Path, tmp_path: Path
) -> None:
    """The columns had been "of different runs"."""
    true, _ = read(good, model, tmp_path)
    wrapped = {**good, "q": np.mod(good["q"], size)}
    found, notes = read(wrapped, model, tmp_path)
    assert np.ptp(good["q"]) > 2 * size
    # of a range that is no whole number of counts the lattice begins elsewhere in each turn
    assert np.ptp(found - true) < np.ptp(true) / size * 1.01 * reality.RESOLUTION
    assert sum("begins anew after a range of" in note for note in notes) == 1


def test_digits_that_a_log_left_out_are_the_step_of_the_position(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """A step of 0.01 rad passed for six and a half counts, halves of counts: "the model does not
    follow the recording".
    """
    step = 6.5 * reality.RESOLUTION
    rounded = {**good, "q": step * np.round(good["q"] / step)}
    _, notes = read(rounded, model, tmp_path)
    assert any(f"its smallest step is {step:.4g}" in note for note in notes), notes


@pytest.fixture
def pendulum(tmp_path: Path) -> tuple[Callable[..., Path], Path]:
    """Write recordings of a pendulum, by seed and the zero of its position; and its model."""
    machine = reality.Machine(gravity=WEIGHT)

    def write(seed: int, zero: float, weight: float = WEIGHT) -> Path:
        run = reality.simulate(
            reality.Machine(gravity=weight), reality.multisine(10.0, FAST, seed), FAST
        )
        zeroed = {**run, "q": run["q"] + zero, "r": run["r"] + zero}
        return reality.save(tmp_path / f"run{seed}.csv", zeroed)

    assert machine.gravity
    return write, reality.model_file(tmp_path / "m.toml", FAST, *KNOWN, gravity=WEIGHT)


@pytest.mark.parametrize(
    ("zero", "unbalance"), [(0.4, False), (-0.9, False), (math.pi, False), (0.4, True)]
)
def test_recordings_whose_zeros_differ_are_refused_with_what_to_add(
    zero: float,
    unbalance: bool,
    pendulum: tuple[Callable[..., Path], Path],
    refuse: Callable[..., str],
) -> None:
    """They had been unexplained, a third of the torque "most like hysteresis". ``unbalance``: the
    model has a gravity with an angle of its own, too.
    """
    write, model = pendulum
    if unbalance:
        known = reality.effect("gravity", torque=0.01, angle=0.5)
        model.write_text(model.read_text().replace("[actuator]", known + "[actuator]"))
    text = refuse(write(1, 0.0), write(2, zero), "--model", model)
    added = float(text.partition("Add ")[2].partition(" to the column")[0])
    assert "run2.csv: by gravity" in text
    assert math.remainder(added + zero, 2 * math.pi) == pytest.approx(0.0, abs=0.05), text


def test_a_weight_of_the_other_sign_says_that_zero_is_upright(
    pendulum: tuple[Callable[..., Path], Path]
) -> None:
    """It had been "an unbalance, or the given number is wrong", moved by -200 %."""
    write, model = pendulum
    found = diagnose([write(1, math.pi)], model, jobs=1).findings
    said = [f.sentence for f in found if f.effect == "gravity"]
    assert said and "0 is where it stands upright ([sensor] offset)" in said[0], found


def test_parts_of_one_recording_have_one_zero(
    pendulum: tuple[Callable[..., Path], Path]
) -> None:
    """A cubic spring that the model lacked made the halves of a recording hang apart: refused."""
    write, file = pendulum
    model = kernel_model(load_model(file))
    one, other = (
        prepare([read_signals(write(seed, zero), model)], model, 64.0).records[0][0]
        for seed, zero in ((1, 0.0), (2, 0.4))
    )
    records = ((one,), (replace(other, recording=one.recording),))
    check_zeros(Data(records, (64.0,)), model)
    with pytest.raises(RecordingError, match="by gravity"):
        check_zeros(Data(((one,), (other,)), (64.0,)), model)


@pytest.mark.parametrize(("zero", "weight"), [(0.4, WEIGHT), (0.0, 1.3 * WEIGHT)])
def test_zeros_that_agree_and_other_weights_are_no_matter_of_the_columns(
    zero: float, weight: float, pendulum: tuple[Callable[..., Path], Path]
) -> None:
    write, model = pendulum
    accepted([write(1, zero), write(2, zero, weight)], model)


def test_a_command_that_is_logged_more_seldom_than_the_loop_runs_is_said(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """A log of every tenth command was "0.0196 s late", without a word on its cause."""
    seldom = {**good, "u": np.repeat(good["u"][::10], 10)[: len(good["u"])]}
    given = kernel_model(load_model(model))
    for columns, told in ((good, False), (seldom, True)):
        signals = read_signals(reality.save(tmp_path / "a.csv", columns), given)
        notes = check_signals([signals], given)
        assert any("new in one row of 10 only" in note for note in notes) is told


@pytest.mark.parametrize(("weight", "turned"), [(1.0, True), (1.5, False)])
def test_a_gravity_that_only_turns_the_models_is_said_to_be_a_matter_of_its_zero(
    weight: float, turned: bool
) -> None:
    """0.7 rad of a wrong zero were "a gravity torque, balanced at 1.9 rad", and no word more."""
    zero = 0.7
    added = weight * np.exp(1j * zero) - 1.0
    numbers = {"torque": Quantity(abs(added)), "angle": Quantity(float(np.angle(added)))}
    values = {key: Estimate(q.value, 0.01, "") for key, q in numbers.items()}
    model = Model("m", None, "rotary", {"gravity": (Quantity(1.0),)})
    said = _turned(model, Term("gravity", 1, numbers), values)
    assert ("[sensor] offset = -0.7)" in said) is turned
