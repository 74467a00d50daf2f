"""What a Recording promises: nothing is lost between saving and loading, in any format."""

from __future__ import annotations

import gc
import json
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from zendsp import local
from zendsp.errors import RecordingError
from zendsp.link.parameters import ParameterSet
from zendsp.recording import ParameterChange, Recording, read_table
from zendsp.recording.cut import read_parts
from zendsp.recording.names import units_in
from zendsp.reference import Reference, load_reference, save_reference


@pytest.fixture
def recording() -> Recording:
    rng = np.random.default_rng(1)
    return Recording.from_columns(
        {
            "q": rng.normal(size=(200, 2)),
            "u": rng.normal(size=200) * 1e-9,
            "w": np.arange(200) / 3.0,
        },
        sample_time=0.002,
        units={"q": "rad", "u": "N m"},
        start_tick=17,
        decimation=2,
        trigger_row=5,
        lost=3,
        timing={"ticks": 400, "exec_mean_ns": 12.5, "exec_histogram": np.array([1, 2])},
        log=(
            ParameterChange(20, 1.7e9, "Kp", 1.0, 2.0, "host-1"),
            ParameterChange(21, 1.7e9, "a", [1, 2], [3, 4], "b"),
        ),
        parameters={"Kp": 2.0, "a": [3, 4]},
        sources={"pd.c": '#include "isr.h"\n/* Grüße, 模型, comma, "quotes" */\n'},
        compiler="gcc 12",
        flags=("-O2", "-Wall"),
        machine="imi_planar",
        target="imi",
        versions={"zendsp": "0.1.0"},
        created=1.7e9,
        note="first run, line\nbreak",
        extra={"reference": "circle"},
    )


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_every_format_gives_back_the_same_recording_bit_for_bit(
    recording: Recording, tmp_path: Path, suffix: str
) -> None:
    path = recording.save(tmp_path / f"run{suffix}")
    back = Recording.load(path)
    assert np.array_equal(back.t, recording.t)
    assert np.array_equal(back.data, recording.data)
    assert back.channels == recording.channels
    assert back.log == recording.log
    assert back.sources == recording.sources and back.source_hash == recording.source_hash != ""
    for name in (
        "sample_time", "start_tick", "decimation", "trigger_row", "lost", "parameters", "compiler",
        "flags",
    ):
        assert getattr(back, name) == getattr(recording, name), name
    for name in ("machine", "target", "versions", "created", "note", "extra"):
        assert getattr(back, name) == getattr(recording, name), name
    assert back.timing["exec_histogram"] == [1, 2]
    assert list(tmp_path.iterdir()) == [path]  # no half-written file is left behind


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_a_recording_also_reads_as_a_plain_table(
    recording: Recording, tmp_path: Path, suffix: str
) -> None:
    table = read_table(recording.save(tmp_path / f"run{suffix}"))
    assert table["q"].shape == (200, 2)
    assert np.array_equal(table["q[1]"], recording["q"][:, 1])
    assert np.array_equal(table["t"], recording.t)


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_an_element_beside_its_vector_and_the_time_as_a_signal_come_back(
    tmp_path: Path, suffix: str
) -> None:
    """As CSV such a recording was written, and then refused: "names column 'q[1]' twice"."""
    with local("imi_planar", clock="fast") as target:
        target.download("pd.c")
        run = target.acquire(["t", "q", "q[1]"], seconds=0.05, start=True)
    back = Recording.load(run.save(tmp_path / f"run{suffix}"))
    assert back.names == ("t", "q", "q[1]") and np.array_equal(back.data, run.data)
    assert np.array_equal(back["q[1]"], back["q"][:, 1])


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_as_a_table_every_format_knows_its_units(tmp_path: Path, suffix: str) -> None:
    degrees = np.linspace(0.0, 90.0, 50).reshape(25, 2)
    run = Recording.from_columns({"q": degrees}, sample_time=0.01, units={"q": "deg"})
    table = read_table(run.save(tmp_path / f"run{suffix}"))
    assert table.units["q"] == "rad" and table.units["t"] == "s"
    assert table["q"] == pytest.approx(np.deg2rad(degrees))


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_a_recording_of_one_row_survives_saving(tmp_path: Path, suffix: str) -> None:
    one = Recording.from_columns({"q": [[1.0, 2.0]], "u": [3.0]}, sample_time=0.1)
    back = Recording.load(one.save(tmp_path / f"one{suffix}"))
    assert np.array_equal(back.data, [[1.0, 2.0, 3.0]]) and back.t.shape == (1,)


def test_mat_opens_as_a_matrix_with_one_column_per_signal_and_their_names(
    recording: Recording, tmp_path: Path
) -> None:
    import scipy.io

    contents = scipy.io.loadmat(recording.save(tmp_path / "run.mat"))
    names = [str(cell[0]) for cell in contents["names"][0]]
    assert names == ["t", "q[0]", "q[1]", "u", "w"]
    assert np.array_equal(contents["data"][:, 2], recording["q"][:, 1])
    assert [str(cell[0]) if cell.size else "" for cell in contents["units"][0]] == [
        "s", "rad", "rad", "N m", "",
    ]


def test_pandas_reads_our_csv_with_its_own_reader(recording: Recording, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(recording.save(tmp_path / "run.csv"), comment="#")
    times = recording.save(tmp_path / "run.csv").read_text().splitlines()[2:]
    written = [line.split(",")[0] for line in times[:20]]
    assert written == [repr(t) for t in recording.t[:20].tolist()], "as short as they are exact"
    assert list(frame.columns) == ["t [s]", "q[0] [rad]", "q[1] [rad]", "u [N m]", "w"]
    assert len(frame) == 200


def test_a_csv_begins_with_a_line_for_people(recording: Recording, tmp_path: Path) -> None:
    path = recording.save(tmp_path / "run.csv")
    first, header, *_, last = path.read_text().splitlines()
    assert first.startswith("# A recording of zendsp") and len(first) <= 120, first
    assert "200 rows" in first and header.startswith("t [s],")
    assert last.startswith("# zendsp {")


def test_a_csv_of_an_older_version_is_read(recording: Recording, tmp_path: Path) -> None:
    path = recording.save(tmp_path / "run.csv")
    _, *rows, last = path.read_text().splitlines()
    path.write_text("\n".join([last, *rows, ""]))
    again = Recording.load(path)
    assert np.array_equal(again.data, recording.data) and again.log == recording.log


def test_a_csv_that_is_cut_short_is_refused(recording: Recording, tmp_path: Path) -> None:
    path = recording.save(tmp_path / "run.csv")
    path.write_text("\n".join(path.read_text().splitlines()[:100]) + "\n")
    with pytest.raises(RecordingError, match="cut short"):
        Recording.load(path)


def test_pandas_and_xarray_carry_values_and_units(recording: Recording) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    assert np.array_equal(recording.to_pandas()["q[1]"].to_numpy(), recording["q[1]"])
    dataset = recording.to_xarray()
    assert dataset["q"].attrs["units"] == "rad" and dataset["q"].shape == (200, 2)


def test_plot_draws_one_panel_per_unit(recording: Recording, tmp_path: Path) -> None:
    figure = recording.plot(path=tmp_path / "run.png")
    assert [axis.get_ylabel() for axis in figure.axes] == ["rad", "N m", "–"]
    assert len(figure.axes[0].lines) == 2
    figure.draw_without_rendering()
    for axis in figure.axes:  # beside the curves: it covers none
        assert axis.get_legend().get_window_extent().x0 >= axis.get_window_extent().x1
    assert (tmp_path / "run.png").stat().st_size > 5000
    with pytest.raises(RecordingError, match="no channel 'qq'; it has q, u, w"):
        recording.plot(["qq"])


def test_unequal_columns_are_refused_by_name() -> None:
    with pytest.raises(RecordingError, match=r"q \(3,\), u \(4,\)"):
        Recording.from_columns({"q": np.zeros(3), "u": np.zeros(4)}, sample_time=1.0)


def test_a_newer_layout_is_refused_with_advice(recording: Recording, tmp_path: Path) -> None:
    path = recording.save(tmp_path / "run.csv")
    path.write_text(path.read_text().replace('"form": 1', '"form": 2', 1))
    with pytest.raises(RecordingError, match="newer zendsp"):
        Recording.load(path)


def test_importing_the_recording_loads_nothing_heavy() -> None:
    import subprocess
    import sys

    code = (
        "import sys, zendsp.recording; print([m for m in"
        " ('scipy','h5py','pyarrow','matplotlib','pandas') if m in sys.modules])"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip()
        == "[]"
    )


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet", ".csv", ".mcap", ".mf4"])
def test_a_flipped_byte_is_never_a_wrong_number(
    recording: Recording, tmp_path: Path, suffix: str
) -> None:
    path = recording.save(tmp_path / f"whole{suffix}")
    whole, columns = path.read_bytes(), read_table(path).columns
    hurt = tmp_path / f"hurt{suffix}"
    told = 0
    places = 20 if suffix == ".mf4" else 150  # each has a process of its own there
    for place in np.linspace(0, len(whole) - 1, places).astype(int):
        hurt.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        try:
            loaded = Recording.load(hurt)
        except RecordingError as error:
            assert "hurt" in str(error)
            told += 1
        else:  # it hit what means nothing: a date of the archive, a comment
            assert np.array_equal(loaded.data, recording.data, equal_nan=True), place
            assert np.array_equal(loaded.t, recording.t), place
        with suppress(RecordingError):  # as a diagnosis reads it
            for name, values in read_table(hurt).columns.items():
                assert np.array_equal(values, columns[name], equal_nan=True), place
    assert told > places / 2, "most places matter"


def test_a_number_changed_by_hand_is_told_and_an_older_file_loads(
    recording: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "r.npz"
    recording.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["t"] = arrays["t"] + 1e-9
    np.savez(path, **arrays)
    with pytest.raises(RecordingError, match=r"r\.npz: is damaged"):
        Recording.load(path)
    body = json.loads(str(arrays["zendsp"]))
    del body["checksum"]
    np.savez(path, **{**arrays, "zendsp": np.array(json.dumps(body))})
    assert np.array_equal(Recording.load(path).data, recording.data, equal_nan=True)


def test_a_recording_is_one_line_that_a_person_can_read(recording: Recording) -> None:
    said = repr(recording)
    assert said.startswith("<Recording ") and f"{len(recording)} rows" in said
    assert "\n" not in said and len(said) < 120


def test_a_recording_cannot_be_changed_and_what_is_loaded_is_a_recording(
    recording: Recording, tmp_path: Path
) -> None:
    with pytest.raises(AttributeError):
        recording.note = "another"  # type: ignore[misc]
    assert type(Recording.load(recording.save(tmp_path / "a.npz"))) is Recording


def test_columns_are_taken_by_name_and_other_ways_say_so(recording: Recording) -> None:
    table = dict(recording)
    assert list(table) == ["t", "q[0]", "q[1]", "u", "w"]
    assert all(column.shape == (200,) for column in table.values())
    for wrong, rows in ((3, r"\[3\]"), (slice(10, 20), r"\[10:20\]"), (slice(None, 5), r"\[:5\]")):
        with pytest.raises(RecordingError, match=rf"by their names.*\['q'\]{rows}"):
            recording[wrong]  # type: ignore[index]
    with pytest.raises(RecordingError, match=r"dict\(rec\)"):
        list(recording)


def test_tab_completes_what_a_recording_takes_by_name(recording: Recording) -> None:
    offered = recording._ipython_key_completions_()
    assert offered == ["t", "q", "u", "w", "q[0]", "q[1]"]
    assert all(len(recording[name]) == 200 for name in offered)


def test_analog_inputs_keep_the_unit_of_each(tmp_path: Path) -> None:
    program = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
    with local("pendulum", clock="fast", options=["--speed", "20"]) as target:
        target.download({"idle.c": program})
        target.start()
        assert target.builtins()["adc"].unit == "A, V"
        rec = target.acquire(["adc", "enc"], seconds=0.01)
        assert target.acquire(["adc[1]"], seconds=0.01).column_units == ("V",)
    assert rec["adc"].shape == (10, 2)
    for name in ("run.mat", "run.csv", "run.npz"):
        assert Recording.load(rec.save(tmp_path / name)).column_units == ("A", "V", "counts")


def test_a_part_of_a_recording_keeps_what_was_true_of_it(
    recording: Recording, tmp_path: Path
) -> None:
    path = recording.save(tmp_path / "run.mat")
    (part,) = read_parts(path, begin=0.0, end=0.004)  # rows 0 and 1, ticks 17 and 19
    assert len(part) == 2 and part.start_tick == 17 and part.trigger_row == -1
    assert part.log == () and part.parameters == {"Kp": 1.0, "a": [1, 2]}
    (part,) = read_parts(path, begin=0.004)
    assert part.start_tick == 21 and part.trigger_row == 3
    assert part.log == recording.log and part.parameters == recording.parameters
    assert np.array_equal(part.data, recording.data[2:]) and part.sources == recording.sources
    with pytest.raises(RecordingError, match=r"no row is left of 200; it is 0.398 s long"):
        read_parts(path, begin=1.0)
    with pytest.raises(RecordingError, match=r"from 0\.2 s to 0\.1 s is no time: exchange them"):
        read_parts(path, begin=0.2, end=0.1)


def test_a_foreign_file_is_cut_at_its_gaps_and_keeps_its_columns(tmp_path: Path) -> None:
    stamp = np.concatenate([np.arange(50), 500.0 + np.arange(30), 10.0 + np.arange(20)]) * 0.01
    (tmp_path / "run.csv").write_text(
        "stamp,q [deg]\n" + "".join(f"{t:.2f},{k}\n" for k, t in enumerate(stamp))
    )
    parts = read_parts(tmp_path / "run.csv", time="stamp")
    assert [len(part) for part in parts] == [50, 30, 20], "time that runs backwards is a gap too"
    assert parts[1].names == ("q",) and parts[1].t[0] == 5.0, "the time once, as t"
    table = read_table(parts[1].save(tmp_path / "part.csv"))
    assert list(table.columns) == ["stamp", "q"], "a model file finds it as in the file it was"
    assert parts[1]["q"][0] == pytest.approx(np.radians(50))
    with pytest.raises(RecordingError, match="no time column \\(when\\)"):
        read_parts(tmp_path / "run.csv", time="when")


@pytest.mark.parametrize("name", ["run.csv", "run.npz"])
def test_cut_says_which_columns_it_leaves_out(
    tmp_path: Path, typed: Callable[..., tuple[object, str, str]], name: str
) -> None:
    path, part = tmp_path / name, tmp_path / "part.csv"
    if name.endswith(".npz"):
        np.savez(path, t=np.arange(9.0), q=np.arange(9.0), phase=np.array(["up"] * 9))
    else:
        path.write_text("t,q,phase\n" + "".join(f"{k},{k},up\n" for k in range(9)))
    status, said, _ = typed("cut", path, "--to", 5, "-o", part)
    assert not status
    assert said.startswith(f"{part}: 5 rows, 4 s\n  phase: left out, it holds "), said
    status, said, _ = typed("cut", part, "--to", 3, "-o", tmp_path / "less.csv", "--json")
    assert not status and json.loads(said)[0]["notes"] == [], "of this file nothing is left out"


def test_times_left_out_of_a_recording_split_it(
    recording: Recording, tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    run = recording.save(tmp_path / "run.mat")
    parts = read_parts(run, without=[(0.1, 0.104), (0.3, 0.35)])
    assert [len(part) for part in parts] == [50, 98, 25], "however short what is left out is"
    assert parts[1].t[0] - recording.t[0] == pytest.approx(0.104)
    assert [len(p) for p in read_parts(run, without=[(0.0, 0.1)])] == [150], "nothing is before it"
    status, *_ = typed("cut", run, "--without", "0.1:0.104,0.3:0.35", "-o", tmp_path / "part.csv")
    assert not status and len(list(tmp_path.glob("part-*.csv"))) == 3
    for range_of in ("0.3", "0.3:0.1", "a:b"):
        status, _, said = typed("cut", run, "--without", range_of, "-o", tmp_path / "other.csv")
        assert status == 2 and "is no range of times" in said, said


def test_cut_writes_over_no_file_unless_told(
    tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    run = tmp_path / "run.csv"
    run.write_text("t [s],q [rad]\n" + "".join(f"{k / 100},{k}\n" for k in range(90)))
    before = run.read_bytes()
    status, _, said = typed("cut", run, "--to", 0.3, "-o", run)
    assert status == 2 and "--force" in said and run.read_bytes() == before
    status, *_ = typed("cut", run, "--to", 0.3, "-o", run, "--force")
    assert status == 0 and len(Recording.load(run)) == 30


def test_a_tilde_is_the_home_folder_and_missing_folders_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody would look for a folder named ``~`` in the working directory."""
    home, here = tmp_path / "home", tmp_path / "here"
    here.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(here)
    made = Recording.from_columns({"q": np.arange(5.0)}, sample_time=0.001)
    made.save("~/runs/today/a.mat")
    made.plot(["q"], "~/pictures/a.png")
    save_reference(Reference(np.zeros(3), 0.001), "~/references/rest")
    ParameterSet({"Kp": 1.0}).save("~/sets/good.json")
    assert list(here.iterdir()) == []
    assert sorted(p.name for p in home.rglob("*.*")) == ["a.mat", "a.png", "good.json", "rest.mat"]
    assert len(Recording.load("~/runs/today/a.mat")) == 5
    assert read_table("~/runs/today/a.mat")["q"][4] == 4.0
    assert load_reference("~/references/rest.mat").samples == 3
    assert ParameterSet.load("~/sets/good.json").values == {"Kp": 1.0}


@pytest.mark.parametrize("suffix", ["mat", "csv", "npz"])
def test_a_file_that_was_read_is_closed(tmp_path: Path, suffix: str) -> None:
    path = Recording.from_columns({"q": np.zeros(3)}, sample_time=0.1).save(
        tmp_path / f"run.{suffix}"
    )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", ResourceWarning)
        read_table(path)
        gc.collect()
    assert [str(warning.message) for warning in said] == []


@pytest.mark.parametrize("recorded", ["tau", "tau[0]"])
def test_a_signal_of_one_column_has_its_name_with_and_without_the_index(recorded: str) -> None:
    """An array of one element was `tau`, of two `tau[0]`: what read one did not read the other."""
    rec = Recording.from_columns({recorded: np.arange(3.0), "q": np.zeros((3, 2))}, 1e-3)
    for name in ("tau", "tau[0]"):
        assert name in rec and rec[name].tolist() == [0.0, 1.0, 2.0]
    assert "tau[1]" not in rec and "q[2]" not in rec and rec["q"].shape == (3, 2)
    assert units_in({recorded: "N m"}, "tau") == units_in({recorded: "N m"}, "tau[0]") == ["N m"]
