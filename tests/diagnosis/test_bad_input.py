"""Bad input ends with exit status 2 and one clear sentence, never a traceback, never a diagnosis
(issue 5).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from click.testing import CliRunner
from mistakes import BAD, Columns, hung

import zendsp
from zendsp.cli.model import check
from zendsp.diagnosis.data import checks, plausibility
from zendsp.diagnosis.data.checks import check_signals
from zendsp.diagnosis.data.inputs import sources_of
from zendsp.diagnosis.data.plausibility import scaled
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.split import read_divided
from zendsp.errors import ModelError, RecordingError
from zendsp.physics.files.model_file import load_model, parse_model
from zendsp.recording import Recording, Table


@pytest.mark.parametrize("mistake", BAD)
def test_wrong_data_is_refused_with_the_likeliest_mistake(
    mistake: str, good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    change, words = BAD[mistake]
    columns = {k: v.copy() for k, v in good.items()}
    change(columns)
    text = refuse(reality.save(tmp_path / "run.csv", columns), "--model", model)
    assert words in text and "run.csv" in text, text


@pytest.mark.parametrize(
    ("rows", "words"), [(100, "at least 300 samples"), (700, "2 s: play a longer motion")]
)
def test_short_recordings_are_refused(
    rows: int, words: str, good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    columns = {k: v[500 : 500 + rows] for k, v in good.items()}
    assert words in refuse(reality.save(tmp_path / "run.csv", columns), "--model", model)


def test_a_short_recording_is_accepted_beside_a_longer_one(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """For example a robot's move of 1.9 s beside one of 5 s."""
    short = {k: v[500:1200] for k, v in good.items()}
    shorter = {k: v[500:900] for k, v in good.items()}
    files = [reality.save(tmp_path / "run.csv", good), reality.save(tmp_path / "m.csv", short)]
    assert len(read_divided(files, [], load_model(model))[0]) == 2
    with pytest.raises(RecordingError, match="at least 1 s each, where there are several"):
        read_divided([*files, reality.save(tmp_path / "s.csv", shorter)], [], load_model(model))


def test_zendsp_model_check_refuses_what_a_diagnosis_refuses(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    file = reality.save(tmp_path / "run.csv", {k: v[500:1200] for k, v in good.items()})
    done = CliRunner().invoke(check, [str(model), "--recording", str(file)])
    assert done.exit_code != 0 and "at least 2 s" in str(done.exception), done.output


def test_a_recording_with_exactly_the_rows_of_two_seconds_is_accepted(
    good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    def saved(rows: int) -> Path:
        return reality.save(tmp_path / "run.csv", {k: v[:rows] for k, v in good.items()})

    assert "lasts 1.998 s" in refuse(saved(999), "--model", model)
    given = load_model(model)
    check_signals([read_signals(saved(1000), given)], given)


def test_bad_held_out_recording_is_refused_by_its_name(
    good: Columns, other: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    train = reality.save(tmp_path / "run.csv", good)
    held = reality.save(tmp_path / "test.csv", {**other, "u": -other["u"]})
    text = refuse(train, "--model", model, "--heldout", held)
    assert "test.csv" in text and "flipped" in text


def test_missing_column_names_file_column_and_what_there_is(
    good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    text = refuse(
        reality.save(tmp_path / "run.csv", {k: v for k, v in good.items() if k != "u"}),
        "--model",
        model,
    )
    assert "run.csv" in text and "'u'" in text and "q" in text


def test_sample_time_that_contradicts_the_clock_is_refused(
    good: Columns, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    wrong = reality.model_file(
        tmp_path / "model.toml", 1000.0, reality.effect("viscous", coefficient=0.004)
    )
    said = refuse(reality.save(tmp_path / "run.csv", good), "--model", wrong)
    assert "leave sample_time out of" in said and "unit" not in said
    thousandfold = reality.save(tmp_path / "ms.csv", {**good, "t": good["t"] / 1000.0})
    assert "check the unit" in refuse(thousandfold, "--model", wrong)


def test_a_recording_without_a_clock_needs_the_model_to_state_one(
    good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    file = reality.save(tmp_path / "run.csv", {k: v for k, v in good.items() if k != "t"})
    model.write_text(
        "\n".join(
            line for line in model.read_text().splitlines() if not line.startswith("sample_time")
        )
    )
    assert "sample_time" in refuse(file, "--model", model)


FILES = {
    "missing.csv": (None, "no such file"),
    "empty.csv": (b"", "empty"),
    "words.csv": (b"hello\nworld\n", "words.csv"),
    "broken.mat": (b"MATLAB 5.0 MAT-file, but not really" + bytes(200), "broken.mat"),
    "broken.npz": (b"PK\x03\x04garbage", "broken.npz"),
    "broken.parquet": (b"PAR1garbagePAR1", "broken.parquet"),
    "picture.png": (b"\x89PNG", "unknown kind of file"),
    "binary.csv": (bytes(range(256)) * 20, "binary.csv"),
}


@pytest.mark.parametrize("name", FILES)
def test_unreadable_files_are_refused_by_name(
    name: str, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    content, words = FILES[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert words in refuse(tmp_path / name, "--model", model)


def _swap_text(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new)

    return change


MODELS: dict[str, tuple[Callable[[str], str], str]] = {
    "not TOML": (lambda t: t + "\n[[[", "not TOML"),
    "negative inertia": (
        _swap_text("inertia = { value = 0.0102 }", "inertia = { value = -0.01 }"),
        "inertia",
    ),
    "inertia missing": (
        _swap_text("inertia = { value = 0.0102 }", "mass = { value = 1.0 }"),
        "inertia",
    ),
    "inertia a word": (_swap_text("{ value = 0.0102 }", '"heavy"'), "inertia"),
    "inertia not finite": (_swap_text("0.0102", "nan"), "inertia"),
    "unknown kind": (_swap_text('"rotary"', '"wheel"'), "rotary | linear"),
    "unknown effect": (_swap_text('"coulomb"', '"friktion"'), "friktion"),
    "joint out of range": (_swap_text("joint = 1", "joint = 3"), "joint"),
    "parameter of an effect missing": (_swap_text("coefficient", "coeficient"), "coefficient"),
    "negative friction": (
        _swap_text("level = { value = 0.03 }", "level = { value = -0.03 }"),
        "level",
    ),
    "no position column": (_swap_text('position = "q"', 'place = "q"'), "position"),
    "gain zero": (_swap_text("gain = { value = 1.0", "gain = { value = 0.0"), "gain"),
    "negative resolution": (
        lambda t: t.replace("position_resolution = ", "position_resolution = -"),
        "position_resolution",
    ),
    "negative sample time": (
        _swap_text("sample_time = 0.002", "sample_time = -0.002"),
        "sample_time",
    ),
    "urdf missing": (
        lambda text: '[mechanism]\nkind = "urdf"\nfile = "nowhere.urdf"\n[columns]'
        + text.split("[columns]")[1],
        "nowhere.urdf",
    ),
    "python entry missing": (
        _swap_text('kind = "rotary"', 'kind = "python"\nentry = "nowhere:run"'),
        "nowhere",
    ),
}


@pytest.mark.parametrize("mistake", MODELS)
def test_wrong_models_are_refused_with_the_key(
    mistake: str, good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    change, words = MODELS[mistake]
    model.write_text(change(model.read_text()))
    assert words in refuse(reality.save(tmp_path / "run.csv", good), "--model", model)


@pytest.mark.parametrize(
    "given", [SimpleNamespace(columns=["q"]), np.zeros((9, 3)), [np.zeros(9)], 3]
)
def test_numbers_in_memory_are_refused_with_the_call_that_makes_a_recording_of_them(
    given: Any, model: Path
) -> None:
    """An array was taken for the names of files that do not exist."""
    with pytest.raises(RecordingError, match=r"no recording: give .* zendsp.Recording.from_col"):
        zendsp.diagnose(given, model)
    with pytest.raises(RecordingError, match="is no recording"):
        zendsp.diagnose("run.csv", model, given)


def test_the_command_of_a_joint_that_nothing_drives_has_an_empty_name() -> None:
    """["u", ""] was refused as a column that is not there."""
    t = np.arange(3000) / 1000
    columns = {"t": t, "a": np.sin(5 * t), "b": np.sin(7 * t), "u": np.cos(5 * t), "zero": 0 * t}

    def read(second: str) -> Any:
        model = parse_model({
            "name": "two", "sample_time": 0.001,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": [0.01, 0.01]}},
            "columns": {"time": "t", "position": ["a", "b"], "command": ["u", second]},
        })  # fmt: skip
        return read_signals(Table(columns, {}, {}, Path("run.csv")), model).command

    assert np.any(read("")[:, 0]) and not np.any(read("")[:, 1])
    assert np.array_equal(read(""), read("zero"))


def test_a_data_frame_is_read_as_the_csv_that_it_came_from(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    pandas = pytest.importorskip("pandas")
    columns = {"t [s]": good["t"], "q [°]": np.rad2deg(good["q"]), "u [Nm]": good["u"]}
    frame = pandas.DataFrame(columns)
    frame.to_csv(tmp_path / "run.csv", index=False)
    given = load_model(model)
    given = replace(given, columns={"time": "t", "position": "q", "command": "u"})
    csv = read_signals(tmp_path / "run.csv", given)
    of_zendsp = Recording.from_columns(columns, t=good["t"])
    assert of_zendsp.names == ("t", "q", "u") and of_zendsp.units["q"] == "°"
    for made in (frame, frame.set_index("t [s]"), columns, of_zendsp):
        (source,) = sources_of(made)
        read = read_signals(source, given)
        np.testing.assert_allclose(read.position, csv.position, rtol=1e-12)
        assert np.array_equal(read.time, csv.time) and read.name == "recording"


def test_what_is_no_model_is_refused() -> None:
    with pytest.raises(ModelError, match="model: int is no model: give the path of a model file"):
        zendsp.diagnose("run.csv", 3)  # type: ignore[arg-type]


def test_missing_model_file_is_refused(
    good: Columns, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    assert "nothing.toml" in refuse(
        reality.save(tmp_path / "run.csv", good), "--model", tmp_path / "nothing.toml"
    )


def test_scheduler_without_each_is_refused(
    model: Path, tmp_path: Path, refuse: Callable[..., str]
) -> None:
    words = (tmp_path / "a.csv", "--model", model, "--scheduler", "tcp://127.0.0.1:1")
    assert "--each" in refuse(*words)


@pytest.mark.parametrize("gain, factor", [(10.0, "10"), (0.05, "0.05")])
def test_a_command_wrong_by_the_same_factor_at_all_joints_is_refused(
    gain: float, factor: str
) -> None:
    with pytest.raises(RecordingError, match=f"divide the actuator's gain by about {factor}"):
        scaled("run.csv", [gain, 1.02 * gain, gain], "A")
    scaled("run.csv", [gain], "A")  # of one joint its load may be
    scaled("run.csv", [1.0, gain], "A")  # one of two


@pytest.mark.parametrize("gain, cause", [(1.1e3, "mA in place of A"), (9e-4, "A under a head")])
def test_a_command_off_by_1000_at_all_joints_is_called_a_unit_error(
    gain: float, cause: str
) -> None:
    with pytest.raises(RecordingError, match=cause) as refused:
        scaled("run.csv", [gain, 1.02 * gain], "A")
    assert "constant" not in str(refused.value)


@pytest.mark.parametrize("rotary", [False, True])
def test_of_a_joint_that_slides_millimetres_are_not_told_from_a_command_in_milli_units(
    rotary: bool,
) -> None:
    # a head that said mm stood there; the current's said mA, and its numbers were in A
    nothing: Any = SimpleNamespace(y=np.zeros(3), u=np.zeros(3), noise=np.zeros(3))
    said = plausibility._mistakes(nothing, rotary, "A")[0][0]
    assert ("if it stands there, the command is a thousandth" in said) is not rotary
    assert ("A under a head that says mA" in said) is not rotary
    assert ("degrees" if rotary else "'q [mm]'") in said


@pytest.mark.parametrize("mistake", ["two runs glued", "the same run twice", "NaN", "gap"])
def test_the_command_that_a_refusal_proposes_makes_acceptable_recordings(
    mistake: str, good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str],
    typed: Callable[..., tuple[object, str, str]],
) -> None:  # fmt: skip
    columns = {k: v.copy() for k, v in good.items()}
    if mistake == "gap":
        columns["t"][len(columns["t"]) // 3 :] += 7.0
    else:
        BAD[mistake][0](columns)
    path = reality.save(tmp_path / "run.csv", columns)
    said = refuse(path, "--model", model)
    assert f"'zendsp cut {path} " in said, said
    out = ("-o", tmp_path / "part.csv")
    if between := re.search(r"--to ([0-9.]+) ", said):
        typed("cut", path, "--to", between[1], "-o", tmp_path / "first.csv")
        status, *_ = typed("cut", path, "--from", between[1], *out)
    else:
        status, *_ = typed("cut", path, *(("--finite", "q") if mistake == "NaN" else ()), *out)
    assert not status
    parts = [p for p in tmp_path.glob("*.csv") if p != path]
    assert len(parts) == (1 if mistake == "NaN" else 2)
    check_signals([read_signals(part, load_model(model)) for part in parts], load_model(model))


def test_one_command_for_each_recording_removes_all_times_with_a_hanging_sensor(
    good: Columns, model: Path, tmp_path: Path, refuse: Callable[..., str],
    typed: Callable[..., tuple[object, str, str]],
) -> None:  # fmt: skip
    """Such a recording had been refused as two runs glued together, once for each jump."""
    columns = {k: v.copy() for k, v in good.items()}
    hung(columns)
    paths = [
        reality.save(tmp_path / f"{name}.csv", {k: v[first:] for k, v in columns.items()})
        for first, name in enumerate(("one", "two"))
    ]
    said = refuse(*paths, "--model", model)
    assert "glued" not in said and said.count("for 60 rows from row ") == 4, said
    commands = re.findall(r"'zendsp (cut .*?)'", said)
    assert len(commands) == 2, said
    for command in commands:
        *arguments, out = command.split()
        status, *_ = typed(*arguments, tmp_path / out)
        assert not status
    parts = sorted(tmp_path.glob("*-part-*.csv"))
    assert len(parts) == 6
    given = load_model(model)
    check_signals([read_signals(part, given) for part in parts], given)


def test_an_unknown_unit_is_refused_and_the_known_ones_are_listed(
    good: Columns, model: Path, tmp_path: Path
) -> None:
    """When this was only a note, nobody read it, and the whole report was wrong."""
    turns = reality.save(tmp_path / "run.csv", {**good, "q": good["q"] / (2 * np.pi)})
    head, rest = turns.read_text().split("\n", 1)
    turns.write_text(re.sub(r"\bq\b", "q [Umdrehungen]", head) + "\n" + rest)
    words = r"run.csv: position 'q': the unit 'Umdrehungen' is not known\. Known are rad.*Write one"
    with pytest.raises(RecordingError, match=words):
        read_signals(turns, load_model(model))
    plain = reality.save(tmp_path / "plain.csv", good)
    plain.write_text(plain.read_text().replace("u", "u [DAC]", 1))  # a command may have any
    read = read_signals(plain, load_model(model))
    degrees = turns.with_name("grad.csv")
    reality.save(degrees, {**good, "q": np.rad2deg(good["q"])})
    degrees.write_text(degrees.read_text().replace("q", "q [Grad]", 1))
    grad = read_signals(degrees, load_model(model))
    assert np.allclose(grad.position, read.position, atol=1e-9)


@pytest.mark.parametrize(("kind", "way"), [("planar2r", 'kind = "rotary"'), ("urdf", "fixed")])
def test_the_refusal_of_a_held_joint_says_how_to_describe_the_others(kind: str, way: str) -> None:
    model: Any = SimpleNamespace(kind=kind, joints=2)
    for still in (np.full(9, 0.3), np.linspace(0.3, 0.3004, 9)):  # exactly, and by four counts
        with pytest.raises(RecordingError, match=way):
            checks._moves("run.csv: joint 2", still, 1e-4, model)


def test_no_gain_is_called_wrong_by_a_part_that_hardly_moves_when_another_shows_it_right(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table ended after two seconds and the arm stood still for eight. By the test part alone the
    actuators had 0.026 times the model's gain.
    """
    few = SimpleNamespace(
        r2=0.99, slope=0.026, error=1e-4, share=0.5, excess=0.0, excess_t=0.0, alike=1.0
    )
    right = SimpleNamespace(**{**vars(few), "slope": 1.0})
    looked = {"still": few, "moving": right}
    monkeypatch.setattr(
        plausibility, "_looked",
        lambda part, _: SimpleNamespace(
            found=[looked[part]] * 2, slow=None, body=None, u=np.ones((2, 1))
        ),
    )  # fmt: skip
    monkeypatch.setattr(plausibility, "is_carried", lambda *_: True)
    monkeypatch.setattr(plausibility, "is_tool", lambda *_: False)
    monkeypatch.setattr(plausibility, "check_order", lambda *_: None)
    ask: Any = plausibility.check_driven
    model = SimpleNamespace(actuator=SimpleNamespace(unit="A"))
    ask(["a: joint 1", "a: joint 2"], "still", model, ["moving"])
    with pytest.raises(RecordingError, match="divide the actuator's gain by about"):
        ask(["a: joint 1", "a: joint 2"], "still", model)


@pytest.mark.parametrize("agrees", [True, False])
def test_a_part_accuses_no_column_that_another_part_of_the_recording_shows_to_be_right(
    agrees: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real acrobot that people pushed was "of different runs" in the last part of three files."""
    pushed = SimpleNamespace(
        r2=0.7, slope=-0.5, error=1e-3, share=0.5, friction=0.0, held=False, alike=1.0
    )
    found = {"pushed": pushed, "other": SimpleNamespace(**{**vars(pushed), "slope": 1.0})}
    monkeypatch.setattr(
        plausibility, "_looked",
        lambda part, _: SimpleNamespace(
            found=[found[part]], slow=None, body=None, u=np.ones((1, 1)), y=np.ones((1, 1))
        ),
    )  # fmt: skip
    for name in ("check_order", "is_carried", "is_tool", "_clipped", "_undo", "_mistakes"):
        monkeypatch.setattr(plausibility, name, lambda *_: False)
    ask: Any = plausibility.check_driven
    model = SimpleNamespace(actuator=SimpleNamespace(unit="A"), joint_kind=lambda _: "rotary")
    records = "pushed"
    if agrees:
        ask(["a"], records, model, ["other"])
    else:
        with pytest.raises(RecordingError, match="flipped"):
            ask(["a"], records, model, ["pushed"])
