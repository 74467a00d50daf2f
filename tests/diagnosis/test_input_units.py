"""Units and kinds of models that recordings of slides and arms need."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zendsp.diagnosis.data.columns import check_units, getter
from zendsp.diagnosis.data.plausibility import _geared
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.regression import Regression
from zendsp.diagnosis.data.sampling import resolution_of
from zendsp.errors import RecordingError
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.kernel.signals import is_set_value
from zendsp.recording import Recording, read_table

ALONE: dict[str, Any] = {
    "sample_time": 0.001, "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.1}},
    "columns": {"time": "t", "position": "q", "command": "tau"},
}  # fmt: skip


def test_units_of_sliding_joints_beside_turning_ones_are_known() -> None:
    made = Recording.from_columns(
        {"q": np.ones((5, 2))}, sample_time=0.001, units={"q": "mm, rad"}
    )
    arm = replace(parse_model(ALONE), joint_kinds=("linear", "rotary"))
    check_units("run", made, {"position": "q"}, arm)
    values = getter(made)[1]
    assert values("q")[0].tolist() == [1e-3, 1.0] and values("q[1]")[0] == 1.0
    odd = replace(made, channels=(replace(made.channels[0], unit="mm, furlong"),))
    with pytest.raises(RecordingError, match=r"'q\[1\]': the unit 'furlong' is not known"):
        check_units("run", odd, {"position": ["q[0]", "q[1]"]}, arm)


@pytest.mark.parametrize(
    ("role", "header", "mechanism", "unit", "said"),
    [
        ("command", "x [N m]", "rotary", "A", r"'x' is in N m: .*\[actuator\] unit is A: its"),
        ("command", "x [mA]", "rotary", "A", ""),
        ("command", "x [Nm]", "rotary", "mN m", ""),
        ("command", "x [V]", "rotary", "", ""),  # that of a command may be any
        ("command", "x [ch1]", "rotary", "A", ""),
        ("position", "x [mm]", "rotary", "", r"'x' is in m: .* a position is in rad"),
        ("position", "x [mm]", "linear", "", ""),
        ("position", "x [A]", "python", "", r"'x' is in A: .* a position is in rad or m"),
        ("position", "x [mm]", "python", "", ""),  # the simulator knows
        ("velocity", "x [rpm]", "rotary", "", ""),
        ("velocity", "x [1/s]", "rotary", "", ""),
        ("velocity", "x [deg]", "rotary", "", r"'x' is in rad: .* a velocity is in rad/s"),
        ("torque_measured", "x [A]", "rotary", "", r"'x' is in A: .* a torque_measured is in N m"),
        ("reference", "x [furlong]", "rotary", "", r"'furlong' is not known"),
    ],
)  # fmt: skip
def test_a_unit_that_contradicts_the_model_is_refused(
    tmp_path: Path, role: str, header: str, mechanism: str, unit: str, said: str
) -> None:
    file = tmp_path / "run.csv"
    file.write_text("\n".join([header, *map(str, range(9))]))
    model = parse_model({**ALONE, "actuator": {"unit": unit}})
    model = replace(model, kind=mechanism)
    if not said:
        check_units("run", read_table(file), {role: "x"}, model)
        return
    with pytest.raises(RecordingError, match=said):
        check_units("run", read_table(file), {role: "x"}, model)


@pytest.mark.parametrize("unit", ["counts", "furlong"])
def test_a_position_in_an_unknown_unit_needs_its_factor_in_the_model(
    tmp_path: Path, unit: str
) -> None:
    file = tmp_path / "run.csv"
    file.write_text("\n".join([f"x [{unit}]", *map(str, range(9))]))
    model, columns = parse_model(ALONE), {"position": "x"}
    with pytest.raises(RecordingError, match=rf"\[sensor\] matrix = \[\[rad \(m\) per {unit}"):
        check_units("run", read_table(file), columns, model)
    told = parse_model({**ALONE, "sensor": {"matrix": [[0.00153]]}})
    check_units("run", read_table(file), columns, told)


def test_recordings_of_an_arm_with_a_one_joint_model_are_refused_with_the_kinds_that_fit() -> None:
    t = 0.001 * np.arange(4000)
    q = np.stack([np.sin(3.0 * t), np.sin(5.0 * t)], axis=1)
    arm = Recording.from_columns({"q": q, "tau": -q}, sample_time=0.001)
    words = r'planar2r \(two\), urdf or mjcf.*position = "q\[0\]"'
    with pytest.raises(RecordingError, match=words):
        read_signals(arm, parse_model(ALONE))
    each = {"time": "t", "position": ["q[0]", "q[1]"], "command": ["tau[0]", "tau[1]"]}
    notes = read_signals(arm, parse_model({**ALONE, "columns": each})).notes
    assert any("takes each joint by itself" in note for note in notes)


def test_whole_counts_are_not_taken_for_radians() -> None:
    t, one = 0.001 * np.arange(4000), 2 * np.pi / 4000
    counts = np.round(0.8 * np.sin(3.0 * t) / one)[:, None]

    def read(sensor: dict[str, Any]) -> float:
        model = parse_model({**ALONE, "sensor": {"position_resolution": one, **sensor}})
        return resolution_of("run", {"position": "q"}, 0, counts, counts, model, [])

    with pytest.raises(RecordingError, match=r"counts; .*\[sensor\] matrix = \[\[0\.0015707963"):
        read({})
    assert read({"matrix": [[one]]}) == 1.0  # the resolution said in rad a count, behind the matrix
    assert read({"matrix": [[one]], "position_resolution": 1.0}) == 1.0


@pytest.mark.parametrize(("times", "swapped"), [(1, True), (3, False)])
def test_commands_that_a_controller_made_of_counts_are_no_positions(
    times: int, swapped: bool
) -> None:
    """Positions beside the counts, as a drive that interpolates them gives them, were refused."""
    t, one = 0.001 * np.arange(4000), 2e-7
    q = 0.1 * np.sin(3.0 * t)[:, None]
    command = times * one * np.round(1e-4 * np.sin(40.0 * t)[:, None] / one)
    model = parse_model({**ALONE, "sensor": {"position_resolution": one}})
    columns: Any = {"position": "q", "command": "u"}
    said: list[str] = []
    if swapped:
        with pytest.raises(RecordingError, match="swapped"):
            resolution_of("run", columns, 0, q, command, model, said)
    else:
        resolution_of("run", columns, 0, q, command, model, said)
        assert "does not lie on the model's position_resolution" in said[0]


def test_a_step_of_many_counts_is_told() -> None:
    """Angle and torque of the motor, beside the numbers of the joint behind its gear of 50."""
    model = parse_model({**ALONE, "sensor": {"position_resolution": 0.001}})
    wave = np.round(400 * np.sin(np.arange(3000) / 300))[:, np.newaxis]
    for ratio, told in ((50, True), (1, False)):
        notes: list[str] = []
        args = ("run", {"position": "q"}, 0, ratio * 0.001 * wave, np.zeros_like(wave), model)
        assert resolution_of(*args, notes) == 0.001
        assert any("50 times" in note and "gear" in note for note in notes) is told, notes


@pytest.mark.parametrize(("slope", "noise", "is_one"), [
    (1.07, 0.06, True), (0.85, 0.2, True), (0.29, 0.3, False), (3.7, 0.3, False), (1.0, 0.6, False),
])  # fmt: skip
def test_a_set_value_is_told_by_its_numbers(slope: float, noise: float, is_one: bool) -> None:
    """A loop that follows poorly has 1.07 and an R^2 of 0.996; its torque 0.29, its current 3.7,
    both with 0.87.
    """
    q = np.sin(np.arange(2000) / 60.0)
    u = 0.4 + slope * q + noise * np.random.default_rng(0).standard_normal(2000) / np.sqrt(2)
    assert is_set_value(u, q) is is_one


@pytest.mark.parametrize(
    ("slope", "carries", "refused"),
    [(170.0, True, False), (170.0, False, True), (0.004, True, True), (0.004, False, True)],
)
def test_a_light_link_may_carry_a_hundred_times_its_own_inertia(
    slope: float, carries: bool, refused: bool
) -> None:
    """`zendsp demo --machine wam7` refused three of seven of its own payloads as "different sides
    of a gear".
    """
    found = Regression(slope, 0.01 * slope, 0.99, 0.5, 0.1, 0.0, 0.0, 1.0, False)
    with pytest.raises(RecordingError, match="sides of a gear") if refused else nullcontext():
        _geared("run", found, carries, "N m")


def test_a_column_in_milli_units_is_told_as_that_before_any_gear() -> None:
    """Milliamperes under a head of amperes were "different sides of a gear"."""
    for slope, told in ((1200.0, "mA in place of A"), (8e-4, "A under a head that says mA")):
        found = Regression(slope, 0.01 * slope, 0.99, 0.5, 0.1, 0.0, 0.0, 1.0, False)
        with pytest.raises(RecordingError, match=told):
            _geared("run", found, False, "A")
