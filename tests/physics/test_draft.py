"""A model file begun from a recording: what is recognised, what is asked, and that it can be read
back.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from drafts import COUNTS, GRAVITY, INERTIA, STEP, N, T, model_of, recording

from zendsp.cli import main
from zendsp.diagnosis.data.inputs import model_of as of_diagnosis
from zendsp.errors import RecordingError
from zendsp.physics.files.draft import draft_model
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.files.questions import open_questions
from zendsp.recording import Table, read_table
from zendsp.recording.roles import role_of
from zendsp.recording.units import in_si, to_si, unit_in_name


def test_numbers_come_from_the_recording() -> None:
    units = {"t": "s", "q": "rad", "tau": "N m"}
    draft = draft_model(Table(recording(), units, {"kp": 12.0}, Path("run.csv")))
    model = model_of(draft.text)
    assert model.sample_time == STEP and model.kind == "rotary" and model.joints == 1
    assert model.columns == {"time": "t", "position": "q", "command": "tau", "reference": "r"}
    assert model.sensor.resolution[0] == pytest.approx(2 * np.pi / COUNTS, rel=1e-6)
    assert "4096 counts a turn" in draft.text and "also in the file: kp = 12" in draft.text
    # a first idea: the counts of the encoder and the smoothing cost some per cent
    assert model.mechanism["inertia"][0].value == pytest.approx(INERTIA, rel=0.05)
    assert model.mechanism["gravity"][0].value == pytest.approx(GRAVITY, rel=0.05)
    assert not any("N m" in question for question in draft.questions)


def test_the_draft_asks_what_the_recording_cannot_say() -> None:
    columns = recording()
    del columns["r"]
    draft = draft_model(
        Table({"q": columns["q"], "iq": columns["tau"]}, {"iq": "A"}, {}, Path("run.csv"))
    )
    asked = "\n".join(draft.questions)
    for words in (
        "no time column", "q has no unit: is it rad, degrees or m?",
        "how many N m (N) does one A of iq make", "how long until",
    ):
        assert words.lower() in asked.lower()
    assert draft.text.count("# ? ") == len(draft.questions)
    assert model_of(draft.text).columns["command"] == "iq"


def test_questions_stay_open_until_their_lines_are_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A position in degrees was taken for rad, and nothing said that it had been asked about."""
    draft = draft_model(Table(recording(), {}, {}, Path("run.csv")))
    file = tmp_path / "run.toml"
    file.write_text(draft.text)
    assert open_questions(file) == draft.questions and len(draft.questions) > 2
    _, (note,) = of_diagnosis(file)
    monkeypatch.setattr(sys, "argv", ["zendsp", "model", "check", str(file)])
    with pytest.raises(SystemExit):
        main()
    assert capsys.readouterr().err == f"zendsp: {note}\n"
    assert f"run.toml: {len(draft.questions)} questions open" in note
    assert "q has no unit: is it rad, degrees or m?" in note
    assert f"; and {len(draft.questions) - 2} more" in note
    answered = [line for line in draft.text.splitlines() if not line.startswith("# ?")]
    file.write_text("\n".join(answered))
    assert open_questions(file) == () and of_diagnosis(file)[1] == ()


def test_time_in_days_is_asked_about_and_read_once_its_unit_is_written() -> None:
    columns = recording()
    days = {**columns, "t": 739000.0 + columns["t"] / 86400.0}  # a datenum of MATLAB
    draft = draft_model(Table(days, {}, {}, Path("run.csv")))
    assert "write its unit: 't [days]'" in draft.text
    assert model_of(draft.text).sample_time == pytest.approx(STEP, rel=0.01)
    assert to_si("days") == (86400.0, "s")


def test_a_saturated_command_shows_the_limit() -> None:
    columns = recording()
    columns["tau"] = np.clip(columns["tau"], -1.25, 1.25)
    model = model_of(draft_model(Table(columns, {"tau": "N m"}, {}, Path("run.csv"))).text)
    assert model.actuator.limit == (1.25,)


def test_columns_are_grouped_into_joints_and_motor_and_load_sides_are_told_apart() -> None:
    one = recording()
    names = {
        f"axis{k}.{what}": one[short] * k
        for k in (1, 2, 3)
        for what, short in (("pos", "q"), ("torque", "tau"))
    }
    load = {f"q_load{k}": one["q"] for k in (1, 2, 3)}
    draft = draft_model(
        Table({"time": T, **names, **load, "noise": one["r"]}, {}, {}, Path("run.h5"))
    )
    model = model_of(draft.text)
    assert model.joints == 3 and model.columns["position"] == [
        "axis1.pos", "axis2.pos", "axis3.pos",
    ]
    assert model.columns["command"] == ["axis1.torque", "axis2.torque", "axis3.torque"]
    assert model.columns["position_load"] == ["q_load1", "q_load2", "q_load3"]
    assert "not used: noise" in draft.text and draft.unused == ("noise",)
    assert any("act on one another" in question for question in draft.questions)


def test_a_set_point_and_a_following_error_are_no_position_in_german_either(
    tmp_path: Path,
) -> None:
    one = recording()
    columns = [T * 1e3, 1e3 * one["r"], 1e3 * (one["r"] - one["q"]), 1e3 * one["q"], 1e3 * one["q"]]
    rows = np.column_stack([*columns, one["tau"]])
    header = "Zeit [ms];Sollposition [mm];Schleppfehler [mm];Linearmaßstab [mm];" + (
        "Istposition Motor [mm];Motorstrom [A]"
    )
    lines = [header, *(";".join(f"{x:.9f}".replace(".", ",") for x in row) for row in rows)]
    (tmp_path / "fahrt.csv").write_text("\r\n".join(lines), encoding="cp1252")
    draft = draft_model(read_table(tmp_path / "fahrt.csv"))
    model = model_of(draft.text)
    assert model.kind == "linear" and model.columns == {
        "time": "Zeit", "position": "Istposition Motor", "command": "Motorstrom",
        "reference": "Sollposition", "position_load": "Linearmaßstab",
    }
    assert draft.unused == ("Schleppfehler",)


def test_each_joint_is_asked_about_and_the_gain_where_numbers_depend_on_it() -> None:
    one = recording()
    still = {"q2": np.sin(7.0 * T), "i2": np.where(T % 0.1 < 0.05, 1.0, -1.0)}
    columns = {"t": T, "q1": one["q"], "q2": still["q2"], "i1": one["tau"], "i2": still["i2"]}
    draft = draft_model(Table(columns, {"i1": "A", "i2": "A"}, {}, Path("run.csv")))
    asked = "\n".join(draft.questions)
    assert "q1, q2 have no unit: is it rad, degrees or m?" in asked
    assert "how many N m (N) does one A of i1, i2 make? One for each joint" in asked
    assert "does not show the inertia of joint 2" in asked
    assert "And the numbers below are for a gain of 1" in asked
    for kind in ("planar2r", "urdf", "mjcf", "fmu", "python"):
        assert f'"{kind}"' in asked
    hanging = {"t": T, "q": one["q"], "i": one["tau"] + 2.0 * np.sin(one["q"])}
    draft = draft_model(Table(hanging, {"q": "rad", "i": "A"}, {}, Path("run.csv")))
    (gravity,) = (q for q in draft.questions if "hangs down" in q)
    assert "And the number below is for a gain of 1: times the actuator's gain" in gravity


def test_joint_states_name_their_joints_in_any_order() -> None:
    elbow, shoulder = (recording(), {k: 2 * v for k, v in recording().items()})
    columns = {
        "t": T,
        "arm/feedback.elbow.position": elbow["q"],
        "arm/feedback.shoulder.position": shoulder["q"],
        "arm/command.shoulder.effort": shoulder["tau"],
        "arm/command.elbow.effort": elbow["tau"],
    }
    model = model_of(draft_model(Table(columns, path=Path("bag"))).text)
    assert model.columns["command"] == ["arm/command.elbow.effort", "arm/command.shoulder.effort"]
    assert [q.value for q in model.mechanism["inertia"]] == pytest.approx([INERTIA] * 2, rel=0.1)


def test_first_numbers_come_from_the_longest_part_without_a_gap() -> None:
    columns = {name: np.delete(values, slice(5000, 5060)) for name, values in recording().items()}
    draft = draft_model(Table(columns, {"q": "rad", "tau": "N m"}, path=Path("run.csv")))
    assert "60 rows missing" in draft.text
    assert model_of(draft.text).mechanism["inertia"][0].value == pytest.approx(INERTIA, rel=0.05)


def test_joints_that_are_told_by_a_word_are_asked_about() -> None:
    """An antenna was a machine of one joint, its elevation "not used" without a question."""
    one = recording()
    columns = {"t": one["t"], "az_deg": one["q"], "el_deg": one["q"], "az_Nm": one["tau"]}
    units = {"az_deg": "rad", "el_deg": "rad", "az_Nm": "N m", "el_Nm": "N m"}

    def asked() -> list[str]:
        draft = draft_model(Table(columns, units, {}, Path("antenna.csv")))
        return [question for question in draft.questions if "more joints" in question]

    assert asked() == [], "a second position may be the same joint's"
    columns["el_Nm"] = one["tau"]
    (question,) = asked()
    assert 'position = ["az_deg", "el_deg"] and command = ["az_Nm", "el_Nm"]' in question


@pytest.mark.parametrize("begins", [0.0, -np.pi])
def test_first_numbers_of_an_angle_that_begins_anew_are_those_of_the_joint(begins: float) -> None:
    """It had "the recording does not show the inertia", of an antenna's azimuth from 0 to 360."""
    columns = recording()
    whole = columns["q"] + begins  # it passes through the end of the range many times
    columns["q"] = begins + np.mod(columns["q"], 2 * np.pi)
    first, put = (
        model_of(draft_model(Table({**columns, "q": q}, {"tau": "N m"}, {}, Path("run.csv"))).text)
        for q in (whole, columns["q"])
    )
    assert np.sum(np.abs(np.diff(columns["q"])) > 6.0) >= 4
    assert put.mechanism["inertia"][0].value == pytest.approx(
        first.mechanism["inertia"][0].value, rel=0.01
    )


def test_degrees_and_milliseconds_are_converted_to_si(tmp_path: Path) -> None:
    one = recording()
    rows = np.column_stack([T * 1e3, np.degrees(one["q"]), one["tau"] * 1e3])
    np.savetxt(
        tmp_path / "run.csv", rows, delimiter=",", header="t,angle,torque\nms,deg,mN m",
        comments="", fmt="%.17g",
    )
    draft = draft_model(read_table(tmp_path / "run.csv"))
    model = model_of(draft.text)
    assert model.sample_time == STEP and model.sensor.resolution[0] == pytest.approx(
        2 * np.pi / COUNTS, rel=1e-6
    )
    assert "angle: deg converted to rad" in draft.text


def asked_of(**columns: np.ndarray) -> str:
    return "\n".join(draft_model(Table(columns, {}, {}, Path("run.csv"))).questions)


def test_a_position_of_whole_numbers_is_asked_about_as_counts() -> None:
    """An encoder of int16 was taken for rad: a count was one."""
    columns = recording()
    enc = np.round(columns.pop("q") * 4096 / (2 * np.pi))
    dac = columns.pop("tau")
    draft = draft_model(Table({**columns, "enc": enc, "dac": dac}, {}, {}, Path("run.mat")))
    asked = "\n".join(draft.questions)
    assert "enc has no unit and whole numbers alone: is it in counts? rad is taken" in asked
    assert "as 'enc_counts', and begin anew" in asked
    assert 'command = "dac"' in draft.text
    named, units, _ = in_si({"enc_counts": enc}, {})
    again = draft_model(Table({**columns, **named, "dac": dac}, units, {}, Path("run.mat")))
    assert "# ? how many rad is one of the counts?" in again.text


def test_degrees_without_a_unit_are_suspected_by_their_counts() -> None:
    columns = recording()
    asked = asked_of(**columns | {"q": np.degrees(columns["q"])})
    assert "q has no known unit and looks like degrees (its steps are 360/4096): write" in asked
    assert "looks like degrees" not in asked_of(**columns)


def test_no_name_that_matlab_cannot_have_is_advised() -> None:
    columns = {f"run.{name}": values for name, values in recording().items()}
    for unit in ("", "furlong"):
        table = Table(columns, {"run.q": unit}, {}, Path("run.mat"))
        asked = "\n".join(draft_model(table).questions)
        assert "'q_deg'" in asked and "[deg]" not in asked
    assert to_si(unit_in_name("run.q_deg")) == to_si("deg")


@pytest.mark.parametrize("digits", [3, 4, 6])
@pytest.mark.parametrize("swing", [1.5, 20.0])
def test_radians_written_with_few_digits_are_not_taken_for_degrees(
    digits: int, swing: float
) -> None:
    columns = recording()
    asked = asked_of(**columns | {"q": np.round(swing * np.sin(3.0 * T), digits)})
    assert "looks like" not in asked and "is it rad, degrees or m?" in asked


def test_a_velocity_in_rad_per_second_tells_degrees_from_radians() -> None:
    columns = recording()
    columns["qd"] = np.gradient(columns["r"], STEP)
    fine = columns | {"q": np.degrees(columns["r"])}  # no counts
    assert "looks like degrees (it moves 57.3 times as fast as qd says)" in asked_of(**fine)
    assert "looks like" not in asked_of(**columns | {"q": columns["r"]})
    # by chance its counts are those of an encoder in degrees
    counted = columns | {"q": np.round(columns["r"] / 0.087890625) * 0.087890625}
    assert "looks like" in asked_of(**counted)
    table = Table(counted, {"qd": "rad/s"}, {}, Path("run.csv"))
    assert "looks like" not in "\n".join(draft_model(table).questions)


def test_an_unknown_unit_is_asked_about_and_time_backwards_names_the_file(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    rows = [f"{k * 0.01:.2f},{np.sin(k / 9):.5f}" for k in range(200)]
    file.write_text("\n".join(["t [s],angle [furlong]", *rows]))
    asked = " ".join(draft_model(read_table(file)).questions)
    assert "'furlong' is not known" in asked and "'angle [deg]'" in asked
    file.write_text("\n".join(["t [s],angle [rad]", *reversed(rows)]))
    with pytest.raises(RecordingError, match=r"run\.csv: column 't'.*sort the rows"):
        draft_model(read_table(file))
    file.write_text("\n".join(["t [s],angle [rad]", *(f"1.7e+09{row[4:]}" for row in rows)]))
    with pytest.raises(RecordingError, match=r"'t'.* at 1700000000: .*too few digits"):
        draft_model(read_table(file))


def test_a_position_in_counts_is_asked_for_what_one_is_and_refused_until_it_is_said(
    tmp_path: Path,
) -> None:
    columns = recording()
    columns["q"] = np.round(columns["q"] / (2 * np.pi / COUNTS))
    units = {"t": "s", "q": "counts", "tau": "N m"}
    draft = draft_model(Table(columns, units, {}, Path("run.csv")))
    assert any("how many rad is one of the counts" in ask for ask in draft.questions)
    model = model_of(draft.text)
    assert model.columns["position"] == "q" and not model.sensor.matrix
    assert model.mechanism["inertia"][0].value == pytest.approx(INERTIA, rel=0.05)
    said = parse_model(tomllib.loads(draft.text.replace("#matrix", "matrix")), "said.toml")
    assert said.sensor.matrix[0][0] == pytest.approx(2 * np.pi / COUNTS, rel=1e-5)


def test_nan_values_are_reported_and_do_not_hide_the_encoder_resolution() -> None:
    columns = recording()
    columns["q"][5000:5003] = np.nan
    draft = draft_model(Table(columns, {}, {}, Path("run.csv")))
    assert any("q has 3 values that are no finite numbers" in each for each in draft.questions)
    assert "4096 counts a turn" in draft.text
    assert model_of(draft.text).mechanism["inertia"][0].value == pytest.approx(INERTIA, rel=0.05)


def test_missing_rows_are_not_called_jitter() -> None:
    columns = {key: np.delete(x, [700, 3000, 3001]) for key, x in recording().items()}
    text = draft_model(Table(columns, {"t": "s"}, {}, Path("run.csv"))).text
    assert "3 rows missing" in text and "jitter" not in text


def test_a_second_that_is_missing_is_asked_about_before_it_is_refused() -> None:
    columns = {key: np.delete(x, slice(3000, 3500)) for key, x in recording().items()}
    draft = draft_model(Table(columns, {"t": "s"}, {}, Path("my run.csv")))
    asked = next(q for q in draft.questions if "gap" in q)
    assert "a gap of 1 s" in asked and "zendsp cut 'my run.csv' -o part.csv" in asked


def test_a_time_that_jumps_back_is_asked_about() -> None:
    """A file of two runs got a model file without a word, and was refused by the diagnosis."""
    time = np.concatenate([T[: N // 2], T[: N - N // 2]])
    columns = {"t": time, "q": np.sin(3 * time), "u": np.cos(3 * time)}
    drawn = draft_model(Table(columns, {}, {}, Path("two.csv")))
    (asked,) = [q for q in drawn.questions if "the time" in q]
    assert f"runs backwards at row {N // 2 + 1}" in asked and "zendsp cut two.csv" in asked


def test_a_table_with_a_velocity_alone_is_told_that_this_is_not_enough() -> None:
    """It was told to name a column q, so the velocity was."""
    with pytest.raises(RecordingError, match=r"A velocity alone \(qd\) is not diagnosed"):
        draft_model(Table({"t": T, "qd": T, "u": T}, {}, {}, Path("run.csv")))


def test_a_table_without_positions_is_refused_with_what_it_has() -> None:
    with pytest.raises(RecordingError, match=r"no column looks like a position; it has t, a, b"):
        draft_model(Table({"t": T, "a": T, "b": T}, {}, {}, Path("run.csv")))
    # a matrix as MATLAB saves it had the one name
    matrix = Table({"data": np.stack([T, T, T], axis=1)}, {}, {}, Path("run.mat"))
    with pytest.raises(RecordingError, match=r"it has data\[0\] … data\[2\]\. Name one"):
        draft_model(matrix)
    with pytest.raises(RecordingError, match=r"no column 'q'; it has data\[0\] … data\[2\]"):
        matrix["q"]


def test_a_column_without_a_number_is_named() -> None:
    nothing = np.full(len(T), np.nan)
    with pytest.raises(RecordingError, match="of which q holds no finite number"):
        draft_model(Table({"t": T, "q": nothing, "u": T}, {}, {}, Path("run.csv")))
    draft = draft_model(Table({**recording(), "u": nothing}, {}, {}, Path("run.csv")))
    assert "u holds no finite number: why?" in draft.questions


@pytest.mark.parametrize(
    ("name", "unit", "role"),
    [
        ("q[0]", "", "position"),
        ("q_ref", "rad", "reference"),
        ("tau_cmd", "", "command"),
        ("pos_cmd", "", "reference"),
        ("i_q", "A", "current"),
        ("motor_current", "", "current"),
        ("torque_meas", "", "torque_measured"),
        ("qd", "", "velocity"),
        ("desired_velocity", "", ""),
        ("joint_states.elbow.position", "", "position"),
        ("effort/commands.data", "", "command"),
        ("time_ms", "", "time"),
        ("Channel 3", "rad", "position"),
        ("exec_us", "us", ""),
        ("x", "N m", "command"),
        ("e", "", ""),
        ("e", "rad", ""),
        ("Schleppfehler", "mm", ""),
        ("Istposition Motor", "mm", "position"),
        ("Linearmaßstab", "mm", "position"),
        ("Sollposition", "mm", "reference"),
        ("Lageistwert", "", "position"),
        ("Lagesollwert", "", "reference"),
        ("Axis1.SetPos", "mm", "reference"),
        ("Axis1.ActPos", "mm", "position"),
        ("Axis1.ActVelo", "mm/s", "velocity"),
        ("Motorstrom", "A", "current"),
        ("Sollstrom", "A", "current"),
        ("Istmoment", "N m", "command"),
        ("Sollgeschwindigkeit", "mm/s", ""),
        ("Istdrehzahl", "rpm", "velocity"),
        ("Istbeschleunigung", "m/s^2", ""),
        ("Motortemperatur", "°C", "temperature"),
    ],
)
def test_a_column_gets_the_role_that_its_name_and_unit_say(name: str, unit: str, role: str) -> None:
    assert role_of(name, unit).value == role


@pytest.mark.parametrize("rows", ["", "0,0,0\n"])
def test_a_table_of_no_row_or_one_is_refused_as_such(tmp_path: Path, rows: str) -> None:
    path = tmp_path / "one.csv"
    path.write_text(f"t,q,u\n{rows}")
    with pytest.raises(RecordingError, match=r"one\.csv: has [01] row|no rows"):
        draft_model(read_table(path))


def test_the_uncertainty_of_first_numbers_scales_with_each_joints_own_number() -> None:
    columns = recording()
    both = {
        "t": T,
        "q": np.stack((columns["q"], columns["q"]), axis=1),
        "tau": np.stack((20.0 * columns["tau"], columns["tau"]), axis=1),
    }
    units = {"t": "s", "q": "rad", "tau": "N m"}
    one, two = model_of(draft_model(Table(both, units)).text).mechanism["inertia"]
    assert one.value > 10 * two.value
    assert one.std / one.value == pytest.approx(0.15, rel=0.05)  # of two digits
    assert two.std / two.value == pytest.approx(0.15, rel=0.05)


def test_gravity_about_the_hanging_pose_is_told_from_a_negative_inertia() -> None:
    # nearly one sine about q = 0: without gravity, least squares give J - g / w² < 0
    w, columns = 2.0, recording()
    q = 0.3 * np.sin(w * T) + 0.01 * np.sin(2.3 * w * T)
    qd, qdd = np.gradient(q, STEP), np.gradient(np.gradient(q, STEP), STEP)
    tau = INERTIA * qdd + 0.05 * qd + 0.1 * np.sign(qd) + GRAVITY * np.sin(q)
    table = Table(columns | {"q": q, "tau": tau, "r": q}, {"t": "s", "q": "rad", "tau": "N m"})
    model = model_of(draft_model(table).text)
    # as uncertain as the file says of a first idea
    assert model.mechanism["inertia"][0].value == pytest.approx(INERTIA, rel=0.15)
    assert model.mechanism["gravity"][0].value == pytest.approx(GRAVITY, rel=0.15)


def test_a_column_whose_name_ends_in_newton_metres_is_the_command_and_nothing_is_asked_of_it(
    tmp_path: Path,
) -> None:
    data = recording()
    rows = np.column_stack([1e3 * data["t"], np.degrees(data["q"]), data["tau"]])
    path = tmp_path / "bench.csv"
    np.savetxt(path, rows, delimiter=",", header="t_ms,J1_deg,M1_Nm", comments="")
    draft = draft_model(read_table(path))
    assert model_of(draft.text).columns == {
        "time": "t_ms", "position": "J1_deg", "command": "M1_Nm",
    }
    assert not any("M1_Nm" in question for question in draft.questions)


@pytest.mark.parametrize(("unit", "asked"), [("rad", True), ("m", False)])
def test_the_lever_of_a_force_that_turns_a_joint_is_asked(unit: str, asked: bool) -> None:
    columns = {"t": T, "q": np.sin(T), "force": np.cos(T)}
    drawn = draft_model(Table(columns, {"q": unit, "force": "N"}, {}, Path("run.csv")))
    assert any("one N of force make: at which radius" in q for q in drawn.questions) == asked
    assert not any("in N m (N)?" in q for q in drawn.questions)


def test_the_name_of_a_column_does_not_leave_its_comment() -> None:
    columns = {**recording(), "\x1b[2Jx\n[actuator]\ngain = 7.0": 1e3 * np.cos(T)}
    draft = draft_model(Table(columns, {}, {}, Path("run.csv")))
    assert "\x1b" not in draft.text and "\n[actuator]\ngain" not in draft.text
    model_of(draft.text)


def test_stamps_in_ms_of_an_even_clock_give_its_sample_time() -> None:
    """The median of stamps at 400 Hz is 3 ms."""
    columns = recording()
    columns["t"] = np.round(columns["t"] * 1.25, 3)  # 400 Hz
    text = draft_model(Table(columns, {"t": "s"}, {}, Path("run.csv"))).text
    (line,) = (line for line in text.splitlines() if line.startswith("sample_time"))
    assert "= 0.0025 " in line and "jitter" not in line and "missing" not in line
