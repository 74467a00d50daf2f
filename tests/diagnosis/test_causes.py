"""Columns that no machine could have made are refused, and those that one could are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import reality
from acceptance import accepted
from mistakes import Columns
from reality import FAST, RATE

from zendsp.errors import RecordingError
from zendsp.physics.kernel.signals import is_set_value

COUNT = reality.RESOLUTION


def smooth(y: np.ndarray, seconds: float, late: bool) -> np.ndarray:
    """Through a low-pass: one that makes it late, as a drive does, or one that does not."""
    t = np.arange(-4.0 * seconds, 4.0 * seconds, 1.0 / FAST)
    kernel = np.exp(-((t / seconds) ** 2))
    if late:
        kernel = np.where(t >= 0.0, np.exp(-t / seconds), 0.0)
    wide = np.pad(y, len(t) // 2, "edge")
    return np.convolve(wide, kernel / kernel.sum(), "same")[len(t) // 2 :][: len(y)]


@pytest.fixture
def without_reference(model: Path) -> Path:
    """The model, which does not say which column is the reference."""
    text = model.read_text()
    assert 'reference = "r"\n' in text
    model.write_text(text.replace('reference = "r"\n', ""))
    return model


POSITIONS: dict[str, tuple[Callable[[Columns], np.ndarray], bool]] = {
    "measured": (lambda c: c["q"], False),
    "a set value": (lambda c: c["r"], True),
    "a set value of six digits": (lambda c: np.round(c["r"], 6), True),
    "a set value in counts": (lambda c: COUNT * np.round(c["r"] / COUNT), False),  # cannot be told
    "behind the filter of a drive": (lambda c: smooth(c["q"], 0.01, late=True), False),
    "smoothed afterwards": (lambda c: smooth(c["q"], 0.02, late=False), False),
}


@pytest.mark.parametrize("position", POSITIONS)
def test_a_set_value_is_no_position_without_a_reference_either(
    position: str, good: Columns, without_reference: Path, tmp_path: Path
) -> None:
    make, refused = POSITIONS[position]
    file = reality.save(tmp_path / "run.csv", {**good, "q": make(good)})
    if not refused:
        accepted(file, without_reference)
        return
    words = r"moves \d+ ms before the command.*names a set value as the position. Name the column"
    with pytest.raises(RecordingError, match=words):
        accepted(file, without_reference)


@pytest.mark.parametrize(("size", "rows"), [(1.0, 10), (0.1, 50)])
def test_a_late_command_beside_a_sensor_is_no_set_value(
    size: float, rows: int, without_reference: Path, tmp_path: Path
) -> None:
    """Nor where the motion is so slow that its counts hardly change: rounding is no noise there."""
    machine = reality.Machine(late=rows)
    late = reality.simulate(machine, reality.multisine(10.0, FAST, 1, size=size), FAST)
    accepted(reality.save(tmp_path / "run.csv", late), without_reference)


@pytest.mark.parametrize(
    ("weak", "limit", "times", "words"),
    [
        (np.inf, 0.8, 10.0, r"for \d+ % of the time, to .* \(a current in A.*gain \(0\.1\)"),
        (np.inf, 0.8, 0.4, ""),  # within the limit: no recording tells it from another inertia
        (np.inf, 0.5, 1.0, r"give \[actuator\] the limit that it has, or none"),
        (0.5, 0.5, 1.0, ""),  # what the drive does not give moves nothing
    ],
)
def test_a_command_that_acts_beyond_the_limit_is_in_another_unit_or_the_limit_is_wrong(
    weak: float, limit: float, times: float, words: str, model: Path, tmp_path: Path
) -> None:
    machine = reality.Machine(weak=weak)
    made = reality.simulate(machine, reality.multisine(10.0, FAST, 1), FAST)
    text = model.read_text()
    assert "limit = 3.0" in text
    model.write_text(text.replace("limit = 3.0", f"limit = {limit}"))
    file = reality.save(tmp_path / "run.csv", {**made, "u": times * made["u"]})
    if not words:
        accepted(file, model)
        return
    with pytest.raises(RecordingError, match=words):
        accepted(file, model)


@pytest.mark.parametrize(("column", "refused"), [("u", False), ("r", True)])
def test_a_slow_pendulum_that_weighs_its_position_in_numbers_has_no_set_value(
    column: str, refused: bool, tmp_path: Path
) -> None:
    """Of 1 N m, and with a given inertia that is a third of the true one, which hardly shows. Its
    reference in place of the command is refused as before.
    """
    machine = reality.Machine(gravity=1.0, inertia=0.02, coulomb=0.05, kp=20.0, kd=0.8)
    slow = reality.multisine(12.0, RATE, 1, low=0.1, high=0.3)
    columns = reality.simulate(machine, slow, RATE)
    assert is_set_value(columns["u"], columns["q"])
    file = reality.save(tmp_path / "run.csv", {**columns, "u": columns[column]})
    dry = reality.effect("coulomb", level=0.05)
    model = reality.model_file(tmp_path / "m.toml", RATE, dry, inertia=0.0065, gravity=1.05)
    if not refused:
        accepted(file, model)
        return
    with pytest.raises(RecordingError, match="names a set value of the position as the command"):
        accepted(file, model)
