"""A number of the given model in another unit, and motion that cannot tell it from physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import reality
from reality import KNOWN, RATE

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.data.split import read_divided
from zendsp.errors import ModelError, RecordingError
from zendsp.physics.files.model_file import load_model

MACHINE = reality.Machine(gravity=0.4, coulomb=0.03)
VISCOUS = KNOWN[0]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    return [
        reality.save(
            folder / f"{seed}.csv",
            reality.simulate(MACHINE, reality.multisine(12.0, RATE, seed), RATE, seed),
        )
        for seed in (1, 2)
    ]


def test_a_weight_given_1000_times_too_large_hides_no_friction(
    runs: list[Path], tmp_path: Path
) -> None:
    """All shares were of that weight, and the missing friction "too small to be told"."""
    model = reality.model_file(tmp_path / "m.toml", RATE, VISCOUS, gravity=400.0)
    d = diagnose(runs[0], model, runs[1], jobs=1)
    found = {f.effect: f for f in d.findings}
    assert set(found) == {"coulomb", "gravity"}
    assert found["coulomb"].parameters["level"].value == pytest.approx(0.03, rel=0.03)
    assert "a factor of 0.001: a unit?" in found["gravity"].sentence


@pytest.mark.parametrize("head", ["q", "q [rad]"])
def test_degrees_are_not_suspected_of_a_position_whose_head_states_its_unit(
    head: str, runs: list[Path], tmp_path: Path
) -> None:
    """An inertia 100 times too large resembles degrees: it alone is at fault where these are
    excluded.
    """
    run = tmp_path / "run.csv"
    run.write_text(runs[0].read_text().replace("q", head, 1))
    model = reality.model_file(tmp_path / "m.toml", RATE, *KNOWN, inertia=1.0)
    stated, at_fault = head != "q", "the model's inertia (1; 0.01"
    with pytest.raises(RecordingError) as refused:
        diagnose(run, model, jobs=1)
    assert ("in degrees" not in str(refused.value)) is stated
    assert (at_fault in str(refused.value)) is stated


def test_a_dry_friction_that_nothing_could_overcome_is_refused_with_its_unit(
    runs: list[Path], tmp_path: Path
) -> None:
    stuck = reality.model_file(
        tmp_path / "m.toml", RATE, VISCOUS, reality.effect("coulomb", level=30.0), gravity=0.4
    )
    with pytest.raises(ModelError, match=r"coulomb of joint 1 has a level of 30 N m.*mN m"):
        diagnose(runs[0], stuck, runs[1], jobs=1)


def test_a_delay_of_1000_rows_is_asked_about(runs: list[Path], tmp_path: Path) -> None:
    path = reality.model_file(tmp_path / "m.toml", RATE, *KNOWN, gravity=0.4)
    text = path.read_text()
    assert "[actuator]" in text
    path.write_text(text.replace("[actuator]", "[actuator]\ndelay = 4.0"))
    d = diagnose(runs[0], path, runs[1], jobs=1)
    assert any("delay = 4 s is 1000 rows" in note and "in ms?" in note for note in d.notes)


@pytest.mark.parametrize(("coulomb", "verdict"), [(0.03, "Cannot tell"), (0.0, "Complete")])
def test_friction_that_steady_motion_puts_into_another_number_is_not_complete(
    coulomb: float, verdict: str, tmp_path: Path
) -> None:
    """Viscous friction took up the dry friction of a joint that turned at 2 rad/s: "complete"."""
    machine = reality.Machine(coulomb=coulomb)
    t = np.arange(int(14.0 * RATE)) / RATE
    made = reality.simulate(machine, 2.0 * t, RATE)
    steady = {name: column[int(2.0 * RATE) :] for name, column in made.items()}
    run = reality.save(tmp_path / "run.csv", steady)
    d = diagnose(run, reality.model_file(tmp_path / "m.toml", RATE, VISCOUS), jobs=1)
    assert d.findings == () and d.headline.startswith(verdict)
    assert any("viscous" in note and "never reverses" in note for note in d.notes)
    if coulomb:
        assert d.next_recording is not None, "a joint that reverses tells them apart"


def test_a_planar_arm_without_a_positive_mass_matrix_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    text = """name = "arm"
sample_time = 0.001
[mechanism]
kind = "planar2r"
[mechanism.parameters]
p1 = 0.45
p2 = {p2}
p3 = 0.09
"""
    path.write_text(text.format(p2=0.12))
    assert load_model(path).kind == "planar2r"
    path.write_text(text.format(p2=120.0))
    with pytest.raises(ModelError, match=r"p2 = 120 .*no arm"):
        load_model(path)


def test_a_recording_given_twice_is_told_and_counts_once(runs: list[Path], tmp_path: Path) -> None:
    """Twice the rows made each number seem surer by the root of two."""
    model = load_model(reality.model_file(tmp_path / "m.toml", RATE, *KNOWN))
    fitted, held, notes = read_divided([runs[0], runs[0]], [runs[1], runs[1]], model)
    assert len(fitted) == len(held) == 1
    assert any("1.csv has the same rows as" in note and "given twice" in note for note in notes)
    _, _, notes = read_divided([runs[0]], [runs[1]], model)
    assert not any("given twice" in note for note in notes)
