"""Files of other tools: each kind is written here by its own library, read, and damaged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from makers import N, Q, T, U, bag, hdf5, json_mcap, mdf, tdms, tdms_with_a_time_channel

from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table
from zendsp.recording.formats.mat import _read_v5
from zendsp.recording.formats.mat5 import read_plain


def test_time_stamps_of_parquet_are_seconds(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    stamps = pyarrow.array([1_700_000_000_000_000_001, 1_700_000_000_002_000_001])
    for kind in (pyarrow.timestamp("ns"), pyarrow.timestamp("ns", "UTC")):
        columns = {"timestamp": stamps.cast(kind), "q": [1.0, 2.0]}
        parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
        table = read_table(tmp_path / "log.parquet")
        np.testing.assert_allclose(table["timestamp"], [0.0, 0.002], rtol=1e-9)
        assert table.notes == ("timestamp: seconds since 2023-11-14T22:13:20.000000001",)


def test_durations_of_parquet_are_seconds(tmp_path: Path) -> None:
    """A timedelta of pandas was left out, and the rows stood without a clock."""
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    for unit, each in (("ms", 2), ("us", 2_000), ("ns", 2_000_000)):
        passed = pyarrow.array([0, each, None]).cast(pyarrow.duration(unit))
        made = pyarrow.table({"time": passed, "q": [1.0, 2.0, 3.0]})
        parquet.write_table(made, tmp_path / "l.parquet")
        table = read_table(tmp_path / "l.parquet")
        np.testing.assert_allclose(table["time"], [0.0, 0.002, np.nan], rtol=1e-9)
        assert table.units["time"] == "s"


def test_a_complex_column_is_left_out_and_told(tmp_path: Path) -> None:
    """Nothing said where q was."""
    scipy.io.savemat(tmp_path / "run.mat", {"t": T, "q": Q + 0j, "u": U})
    table = read_table(tmp_path / "run.mat")
    assert set(table.columns) == {"t", "u"}
    assert table.notes == (
        "q: left out: it holds complex numbers: save its real part, real(x) in MATLAB",
    )


@pytest.mark.parametrize("packed", [False, True])
def test_plain_matrices_of_matlab_are_read_as_scipy_reads_them(
    packed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Importing SciPy's reader takes a third of a second."""
    rng, path = np.random.default_rng(0), tmp_path / "run.mat"
    plain = {
        "t": T, "q": rng.standard_normal((len(T), 3)), "k": np.arange(4, dtype=np.int16),
        "few": np.array([[1, 2]], np.uint8), "none": np.zeros((0, 3)),
        "cube": np.float32(rng.standard_normal((3, 4, 2))), "a_long_name_of_a_gain": 2.5,
    }  # fmt: skip
    scipy.io.savemat(path, plain, do_compression=packed)
    expected = scipy.io.loadmat(path)
    with monkeypatch.context() as scipyless:
        scipyless.setattr(scipy.io, "loadmat", None)
        found = _read_v5(path)
    assert list(found) == list(plain)
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], strict=True)
    for other in (np.ones(3) * 1j, "text", np.array([True]), {"of": 1.0}):
        scipy.io.savemat(path, {**plain, "other": other}, do_compression=packed)
        assert read_plain(path) is None, other
        assert list(_read_v5(path)) == [*plain, "other"]
    cut = path.read_bytes()
    for end in (len(cut) - 1, len(cut) // 2, 150, 129, 100):
        path.write_bytes(cut[:end])
        assert read_plain(path) is None, end


@pytest.mark.parametrize("version", [5, 7.3])
def test_an_object_of_matlab_is_no_column_and_the_way_to_its_numbers_is_told(
    version: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference of a timeseries, six whole numbers, had been read as a position."""
    path = tmp_path / "run.mat"
    if version == 5:
        scipy.io.savemat(path, {"t": T, "who": "me"})  # what SciPy alone reads
        kept = [("q_ts", "MCOS", "timeseries", np.zeros((6, 1), np.uint32))]
        opaque = np.array(kept, dtype=[(key, object) for key in ("s0", "s1", "s2", "arr")])
        found = {"t": T[:, np.newaxis], "None": opaque.view(scipy.io.matlab.MatlabOpaque)}
        monkeypatch.setattr(scipy.io, "loadmat", lambda *_, **__: found)
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w", userblock_size=512) as file:
            file.create_dataset("t", data=T[np.newaxis]).attrs["MATLAB_class"] = np.bytes_("double")
            made = file.create_dataset("q_ts", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]]))
            made.attrs.update({"MATLAB_class": np.bytes_("timeseries"), "MATLAB_object_decode": 3})
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    table = read_table(path)
    assert list(table.columns) == ["t"]
    assert "t = q_ts.Time; q = q_ts.Data" in "".join(table.notes)
    with pytest.raises(RecordingError, match=r"'q_ts' is an object of MATLAB \(timeseries\)"):
        read_table(path, columns=["t", "q_ts"])


def test_own_recordings_keep_their_units_and_tables_of_them_are_si(tmp_path: Path) -> None:
    own = Recording.from_columns(
        {"q": np.degrees(Q), "u": U}, sample_time=0.002, units={"q": "deg"}
    )
    for suffix in (".csv", ".mcap", ".mf4"):
        path = own.save(tmp_path / f"own{suffix}")
        assert (
            np.array_equal(Recording.load(path)["q"], own["q"])
            and Recording.load(path).units["q"] == "deg"
        )
        assert np.allclose(read_table(path)["q"], Q)


@pytest.mark.parametrize("name", ["run.h5", "run.mat"])
def test_hdf5_without_its_package_is_refused_with_its_pip_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = hdf5(tmp_path / name)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match=r"needs h5py: pip install 'zendsp\[hdf5\]'"):
        read_table(made)


def positions(table: Any) -> Any:
    for names in (
        ["q"],
        ["q1", "q2"],
        ["motor.position"],
        ["joint_states.elbow.position", "joint_states.wrist.position"],
    ):
        if names[0] in table:
            return np.column_stack([table[name] for name in names])
    raise AssertionError(list(table.columns))


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (hdf5, "run.h5"),
        (tdms, "run.tdms"),
        (tdms_with_a_time_channel, "lv.tdms"),
        (mdf, "run.mf4"),
        (json_mcap, "run.mcap"),
    ],
)
def test_each_kind_gives_positions_in_radians_on_a_clock_in_seconds(
    make: Any, name: str, tmp_path: Path
) -> None:
    path = make(tmp_path / name)
    table = read_table(path)
    assert np.allclose(positions(table), Q, atol=1e-12)
    assert np.allclose(table["t" if "t" in table else "Time"], T, atol=1e-7)
    recording = Recording.load(path)
    assert recording.sample_time == pytest.approx(0.002) and len(recording) == N


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_a_bag_of_ros_has_joints_by_name_and_the_command_held_beside_them(
    plugin: str, tmp_path: Path
) -> None:
    folder = bag(tmp_path / "bag", plugin, command_every=2, command_from=10)
    (single,) = (p for p in folder.iterdir() if p.suffix in (".db3", ".mcap"))
    for path in (folder, single):
        table = read_table(path)
        rows = len(table)
        assert rows == N - 10  # nothing was commanded before
        assert np.allclose(positions(table), Q[10:])
        # held from message to message
        assert np.array_equal(table["effort/commands.data"], np.repeat(U[10::2], 2))
        # of the headers, not of their arrival
        assert np.allclose(table["t"], T[: N - 10], atol=1e-9)
        assert any("newest value is held" in note for note in table.notes)
        assert any("10 rows left out" in note for note in table.notes)


def test_groups_of_other_rates_are_held_on_the_clock_of_the_positions(tmp_path: Path) -> None:
    table = read_table(mdf(tmp_path / "run.mf4"))
    assert np.array_equal(table["u"], np.repeat(U[::2], 2)) and table.units == {
        "t": "s",
        "q1": "rad",
        "q2": "rad",
        "u": "V",
    }


MAKERS = {"run.h5": hdf5, "run.tdms": tdms, "run.mf4": mdf, "run.mcap": json_mcap}


@pytest.mark.parametrize("name", MAKERS)
def test_files_cut_short_or_of_another_kind_are_refused_by_name(name: str, tmp_path: Path) -> None:
    whole = MAKERS[name](tmp_path / name).read_bytes()
    suffix = Path(name).suffix
    for label, content in {
        "head": whole[:40],
        "half": whole[: len(whole) // 2],
        "rubbish": b"\xff\x00\x17" * 999,
        "text": b"t,q\n0,1\n" * 99,
    }.items():
        path = tmp_path / f"{label}{suffix}"
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=rf"{label}\{suffix}"):
            read_table(path)


@pytest.mark.parametrize("name", MAKERS)
def test_a_flipped_byte_never_crashes_the_reader(name: str, tmp_path: Path) -> None:
    whole = bytearray(MAKERS[name](tmp_path / name).read_bytes())
    path = tmp_path / f"flipped{Path(name).suffix}"
    for place in np.random.default_rng(3).integers(0, len(whole), 8 if name == "run.mf4" else 40):
        damaged = whole.copy()
        damaged[place] ^= 0x5A
        path.write_bytes(damaged)
        try:
            # where no checksum covers the byte, other numbers are what the file says
            read_table(path)
        except RecordingError as error:
            assert path.name in str(error)


def test_a_bag_with_bad_metadata_is_refused_in_a_few_words(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9, x: y\n" * 9)
    with pytest.raises(RecordingError, match="no bag of ROS: it cannot be read") as refused:
        read_table(tmp_path)
    said = str(refused.value).replace(str(tmp_path), "")
    assert len(said) < 300 and "\n" not in said


def test_an_unreadable_kind_of_file_is_refused_with_the_command_that_converts_it(
    tmp_path: Path
) -> None:
    for name, command in (
        ("run.xlsx", "libreoffice --headless --convert-to csv"),
        ("run.ulg", "ulog2csv"),
        ("a.pkl", r"pandas.read_pickle.*\.pkl .*\.csv  \(only where you trust its author"),
        ("a;b.feather", r"pandas.read_feather.*'.*a;b\.feather' '.*a;b\.csv'"),
    ):
        (tmp_path / name).write_bytes(b"x" * 99)
        with pytest.raises(RecordingError, match=f"convert it: .*{command}"):
            read_table(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "module"),
    [("a.mcap", "mcap"), ("a.mf4", "asammdf"), ("a.tdms", "nptdms"), ("a.bag", "rosbags")],
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    for loaded in [m for m in sys.modules if m.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setattr(sys, "meta_path", [_Missing(module), *sys.meta_path])
    (tmp_path / name).write_bytes(b"x" * 99)
    with pytest.raises(RecordingError, match=rf"needs {module}: pip install 'zendsp\[files\]'"):
        read_table(tmp_path / name)


class _Missing:
    def __init__(self, module: str) -> None:
        self.module = module

    def find_spec(self, name: str, *_: object) -> None:
        if name.partition(".")[0] == self.module:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.mark.parametrize("name", ["none.npz", "none.csv"])
def test_a_table_without_a_row_is_refused_by_name(name: str, tmp_path: Path) -> None:
    empty = {"t": np.zeros(0), "q": np.zeros(0)}
    path = tmp_path / name
    if name.endswith("npz"):
        np.savez(path, **empty)
    else:
        path.write_text("t,q\n")
    with pytest.raises(RecordingError, match=rf"{name}: .*no row"):
        Recording.load(path)
    assert len(Recording.from_columns({"q": []}, sample_time=0.1)) == 0


@pytest.mark.parametrize("paths", [["Encoder/pos", "Control/i"], ["Encoder/Out1", "Control/Out1"]])
def test_an_export_of_controldesk_has_columns_by_the_names_of_its_variables(
    tmp_path: Path, paths: list[str]
) -> None:
    rows, full = np.arange(5.0), [f"Model Root/{path}" for path in paths]
    y = np.zeros((1, 2), dtype=[(key, object) for key in ("Name", "Data", "Unit", "XIndex")])
    for k, unit in enumerate(("deg", "A")):
        quoted = '"{}"/"{}"'.format(*full[k].rsplit("/", 1))
        y[0, k] = (quoted, rows[None, :] + k, unit, 1.0)
    x = {"Name": "HostService", "Data": 0.001 * rows[None, :]}
    scipy.io.savemat(tmp_path / "rec1.mat", {"rec1": {"X": x, "Y": y, "Description": "a swing"}})
    table = read_table(tmp_path / "rec1.mat")
    position, current = ("pos", "i") if "pos" in paths[0] else full
    np.testing.assert_allclose(table["time"], 0.001 * rows)
    np.testing.assert_allclose(table[position], np.radians(rows))
    assert table.units[current] == "A" and set(table.columns) == {"time", position, current}


def test_what_describes_a_signal_of_simulink_is_no_column_of_another_length(
    tmp_path: Path,
) -> None:
    rows = np.arange(5.0)[:, None]
    signals = {"values": np.c_[rows, rows], "dimensions": 2.0, "plotStyle": np.zeros((1, 2))}
    scope = {"time": rows, "signals": signals, "blockName": "pend/Scope"}
    scipy.io.savemat(tmp_path / "scope.mat", {"Scope": scope})
    table = read_table(tmp_path / "scope.mat")
    assert set(table.columns) == {"Scope.time", "Scope.signals.values"}
    with pytest.raises(RecordingError, match="describes Scope"):
        read_table(tmp_path / "scope.mat", ["Scope.signals.plotStyle"])


def test_several_signals_of_a_scope_of_simulink_are_named_by_their_labels(tmp_path: Path) -> None:
    """Structure with time; signals whose labels are missing, or the same, keep their numbers."""
    rows = np.arange(5.0)[:, None]
    for labels, names in (
        (("theta", "tau"), {"Scope.theta", "Scope.tau"}),
        (("theta", ""), {"Scope.signals(1).values", "Scope.signals(2).values"}),
        (("x", "x"), {"Scope.signals(1).values", "Scope.signals(2).values"}),
    ):
        signals = np.zeros((1, 2), dtype=[("values", object), ("label", object)])
        for k, label in enumerate(labels):
            signals[0, k] = (rows + k, label)
        scipy.io.savemat(tmp_path / "scope.mat", {"Scope": {"time": rows, "signals": signals}})
        table = read_table(tmp_path / "scope.mat")
        assert set(table.columns) == {"Scope.time", *names}
    assert np.array_equal(table["Scope.signals(2).values"], rows[:, 0] + 1)


@pytest.mark.parametrize("fields", [("Time", "Data"), ("time", "signals")])
def test_structures_of_two_rates_are_held_on_the_clock_of_the_positions(
    tmp_path: Path, fields: tuple[str, str]
) -> None:
    """They had been refused: "columns differ in length"."""
    time, data = fields
    fast = np.arange(0.0, 4.0, 0.001)
    slow, u = fast[::5], np.sin(fast)
    both = np.column_stack([np.cos(slow), np.sin(slow)])

    def log(t: Any, values: Any) -> dict[str, Any]:
        held = {"values": values} if data == "signals" else values
        return {time: t[:, np.newaxis], data: held}

    scipy.io.savemat(
        tmp_path / "run.mat", {"pos": log(slow, both), "cur": log(fast, u[:, np.newaxis])}
    )
    table = read_table(tmp_path / "run.mat")
    end = ".values" if data == "signals" else ""
    assert np.allclose(table["t"], slow) and np.allclose(table[f"pos.{data}{end}"], both)
    assert np.allclose(table[f"cur.{data}{end}"], u[::5])
    assert "the newest value is held of" in "".join(table.notes)
    scipy.io.savemat(
        tmp_path / "run.mat",
        {"pos": log(slow, both), "cur": log(fast, u[:, np.newaxis]), "other": np.ones(7)},
    )
    with pytest.raises(RecordingError, match="columns differ in length"):
        read_table(tmp_path / "run.mat")
