"""Files of other people's tools: each kind is made here by its own library, read, and damaged."""

from __future__ import annotations

import io
import json
import os
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table
from zendsp.recording.formats import apart, csv
from zendsp.recording.units import to_si, unit_in_name

RNG = np.random.default_rng(7)
N = 400
T = np.arange(N) * 0.002
Q = np.cumsum(RNG.normal(size=(N, 2)), axis=0) * 0.01
U = RNG.normal(size=N)


@pytest.mark.parametrize(
    ("written", "factor", "si"),
    [
        ("deg", np.pi / 180, "rad"),
        ("deg/s", np.pi / 180, "rad/s"),
        ("°/s²", np.pi / 180, "rad/s^2"),
        ("rpm", np.pi / 30, "rad/s"),
        ("ms", 1e-3, "s"),
        ("µs", 1e-6, "s"),
        ("mN m", 1e-3, "N m"),
        ("mNm", 1e-3, "N m"),
        ("N·mm", 1e-3, "N m"),
        ("mA", 1e-3, "A"),
        ("mm/s", 1e-3, "m/s"),
        ("kN", 1e3, "N"),
        ("rad/s", 1.0, "rad/s"),
        ("Nm", 1.0, "Nm"),
        ("counts", 1.0, "counts"),
    ],
)
def test_units_are_converted_by_their_factor(written: str, factor: float, si: str) -> None:
    found = to_si(written)
    assert found is not None and found[0] == pytest.approx(factor, rel=1e-12) and found[1] == si


@pytest.mark.parametrize("unknown", ["furlong", "", "rad/", "°F", "mol", "q1"])
def test_a_unit_that_is_not_known_is_not_guessed(unknown: str) -> None:
    assert to_si(unknown) is None


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("zeit_ms", "ms"),
        ("Time_rel_ms", "ms"),
        ("log.time_us", "us"),
        ("tiempo_s", "s"),
        ("v_ms", ""),
        ("times_ms", ""),
        ("drift_ms", ""),
        ("torque_Nm", "N m"),
        ("gap_nm", ""),
        ("joint.q_rad", "rad"),
    ],
)
def test_ms_is_milliseconds_where_a_word_of_the_name_says_time(name: str, unit: str) -> None:
    assert unit_in_name(name) == unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [("pos_rad", "rad"), ("torque_Nm", "N m"), ("qd_rad_s", ""), ("gap_nm", ""), ("rad", "")],
)
def test_radians_and_newton_metres_at_the_end_of_a_name_are_its_unit(name: str, unit: str) -> None:
    assert unit_in_name(name) == unit


def test_a_log_with_dates_and_words_is_read_without_the_words(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(
        "timestamp,clock,q,mode,note\n"
        "2026-11-23T23:59:59.999Z,10:00:00.000,1,AUTO,start\n"
        "2026-11-24T00:00:00.001Z,10:00:00.002,2,AUTO,\n"
    )
    table = read_table(path)
    assert list(table.columns) == ["timestamp", "clock", "q"] and table.units["timestamp"] == "s"
    for name in ("timestamp", "clock"):
        np.testing.assert_allclose(table[name], [0.0, 0.002], atol=1e-12)
    assert table.notes == (
        "timestamp: seconds since 2026-11-23T23:59:59.999Z",
        "clock: seconds since 10:00:00.000",
        "mode: left out, it holds text",
        "note: left out, it holds text",
    )
    with pytest.raises(RecordingError, match="'mode' holds text"):
        read_table(path, ["q", "mode"])
    assert Recording.load(path).t[-1] == pytest.approx(0.002)


@pytest.mark.parametrize("decimal", [",", "."])
def test_days_that_come_first_are_dates_and_those_that_may_not_are_told(
    tmp_path: Path, decimal: str
) -> None:
    path, cell = tmp_path / "log.csv", ";" if decimal == "," else ","
    rows = [("31.1.2026 23:59:59.998", "0.1"), ("01.02.2026 00:00:00.000", "0.2"),
            ("01.02.2026 00:00:00.002", "0.3")]  # fmt: skip
    for slashes in (False, True):
        lines = [
            f"{stamp[: stamp.index(' ')]}{stamp[stamp.index(' ') :].replace('.', decimal)}{cell}"
            f"{number.replace('.', decimal)}"
            for stamp, number in rows
        ]
        if slashes:
            lines = [
                f"{line.partition(' ')[0].replace('.', '/')} {line.partition(' ')[2]}"
                for line in lines
            ]
        path.write_text("\n".join([f"Zeit{cell}q [rad]", *lines]) + "\n")
        if slashes:
            with pytest.raises(RecordingError, match=r"dates, of which 2026-02-01 12:00:00\.5 is"):
                Recording.load(path)
        else:
            table = read_table(path)
            np.testing.assert_allclose(table["Zeit"], [0.0, 0.002, 0.004], atol=1e-9)
            np.testing.assert_allclose(table["q"], [0.1, 0.2, 0.3])


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


def test_units_in_headers_rows_of_units_and_names(tmp_path: Path) -> None:
    (tmp_path / "header.csv").write_text("t [ms],q [deg],u [mN m]\n0,180,1000\n1,90,500\n")
    (tmp_path / "row.tsv").write_text(
        "t\tq\tu\tnote\nms\tdeg\tmNm\t-\n0\t180\t1000\t1\n1\t90\t500\t2\n"
    )
    (tmp_path / "name.csv").write_text("time_ms,q_deg,u_mNm\n0,180,1000\n1,90,500\n")
    for name, t, q, u in (
        ("header.csv", "t", "q", "u"),
        ("row.tsv", "t", "q", "u"),
        ("name.csv", "time_ms", "q_deg", "u_mNm"),
    ):
        table = read_table(tmp_path / name)
        assert (
            np.allclose(table[t], [0, 0.001])
            and np.allclose(table[q], [np.pi, np.pi / 2])
            and np.allclose(table[u], [1, 0.5])
        )
        assert table.units[q] == "rad" and any("converted" in note for note in table.notes)
        assert Recording.load(tmp_path / name).sample_time == pytest.approx(0.001)
    (tmp_path / "words.csv").write_text("t,q\neast,west\n0,1\n")
    with pytest.raises(RecordingError, match=r"line 2: 'east' is not a number"):
        read_table(tmp_path / "words.csv")


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


def hdf5(path: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        run = file.create_group("run")
        run["t"], run["q"], run["u"] = T * 1e3, np.degrees(Q), U
        run["t"].attrs["units"], run["q"].attrs["unit"] = "ms", "deg"
        run["who"], file["rate"] = "me", 500.0
    return path


@pytest.mark.parametrize("name", ["run.h5", "run.mat"])
def test_hdf5_without_its_package_is_refused_with_its_pip_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = hdf5(tmp_path / name)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match=r"needs h5py: pip install 'zendsp\[hdf5\]'"):
        read_table(made)


def tdms(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 0.002, "wf_start_offset": 0.0}
    with TdmsWriter(path) as writer:
        writer.write_segment([
            ChannelObject("DAQ", "q1", np.degrees(Q[:, 0]), {**clock, "unit_string": "deg"}),
            ChannelObject("DAQ", "q2", np.degrees(Q[:, 1]), {**clock, "unit_string": "deg"}),
            ChannelObject("DAQ", "u", U, clock),
        ])  # fmt: skip
    return path


def tdms_with_a_time_channel(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    columns = {"Time (ms)": T * 1e3, "q1": Q[:, 0], "q2": Q[:, 1], "u": U}
    units = {"Time (ms)": "ms"}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("g", n, v, {"unit_string": units.get(n, "")})
                for n, v in columns.items()
            ]
        )
    return path


def mdf(path: Path) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append(
            [Signal(np.degrees(Q[:, k]), T, unit="deg", name=f"q{k + 1}") for k in (0, 1)],
            comment="fast",
        )
        file.append([Signal(U[::2], T[::2], unit="V", name="u")], comment="slow")
        file.save(path)
    return path


def json_mcap(path: Path) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Sample", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/motor", "json", schema)
        for k in range(N):
            body = {"position": list(Q[k]), "effort": U[k]}
            stamp = 1_700_000_000_000_000_000 + k * 2_000_000
            writer.add_message(channel, stamp, json.dumps(body).encode(), stamp)
        writer.finish()
    return path


def bag(path: Path, plugin: str, *, command_every: int = 1, command_from: int = 0) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header = store.types["sensor_msgs/msg/JointState"], store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    array = store.types["std_msgs/msg/Float64MultiArray"]
    layout, words = store.types["std_msgs/msg/MultiArrayLayout"], store.types["std_msgs/msg/String"]
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        joints = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = writer.add_connection("/effort/commands", array.__msgtype__, typestore=store)
        log = writer.add_connection("/log", words.__msgtype__, typestore=store)
        for k in range(N):
            ns = 1_700_000_000_000_000_000 + k * 2_000_000
            head = header(stamp(ns // 10**9, ns % 10**9), "base")
            both = state(head, ["elbow", "wrist"], Q[k], np.zeros(2), np.array([]))
            late = ns + 300_000 + 200_000 * (k % 3)  # received later than measured, and with jitter
            writer.write(joints, late, store.serialize_cdr(both, state.__msgtype__))
            if k >= command_from and k % command_every == 0:
                writer.write(
                    commands,
                    ns - 1000,
                    store.serialize_cdr(array(layout([], 0), U[k : k + 1]), array.__msgtype__),
                )
        writer.write(
            log, 1_700_000_000_000_000_000, store.serialize_cdr(words("started"), words.__msgtype__)
        )
    return path


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


def vast_hdf5(path: Path) -> Path:
    with pytest.importorskip("h5py").File(path, "w") as file:
        file.create_dataset("q", (10**13,), dtype="f8", chunks=(1 << 16,))
    return path


def vast_npz(path: Path) -> Path:
    header = io.BytesIO()
    facts = {"descr": "<f8", "fortran_order": False, "shape": (10**13,)}
    np.lib.format.write_array_header_1_0(header, facts)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("q.npy", header.getvalue() + bytes(800))
    return path


@pytest.mark.parametrize(
    ("make", "name"), [(vast_hdf5, "vast.h5"), (vast_hdf5, "vast.mat"), (vast_npz, "vast.npz")]
)
def test_a_small_file_that_says_it_is_vast_is_refused_before_anything_is_allocated(
    make: Callable[[Path], Path], name: str, tmp_path: Path
) -> None:
    path = make(tmp_path / name)
    assert path.stat().st_size < 10_000
    with pytest.raises(RecordingError, match=rf"{name}: says that it holds 80000\.0 GB"):
        read_table(path)


def test_one_process_reads_many_files_and_another_follows_where_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mdf(tmp_path / "run.mf4")
    monkeypatch.chdir(tmp_path)
    first = read_table("run.mf4")
    (reader,) = (r for (pid, _), r in apart._readers.items() if pid == os.getpid())
    monkeypatch.chdir("/")  # a name is meant from where it is given
    again = read_table(tmp_path / "run.mf4")
    assert list(apart._readers.values()) == [reader]
    reader.process.kill()
    reader.process.wait()
    monkeypatch.chdir(tmp_path)
    third = read_table("run.mf4")
    assert list(apart._readers.values()) != [reader]
    for other in (again, third):
        assert all(np.array_equal(first[c], other[c], equal_nan=True) for c in first.columns)


def test_a_bag_with_bad_metadata_is_refused_in_a_few_words(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9, x: y\n" * 9)
    with pytest.raises(RecordingError, match="no bag of ROS: it cannot be read") as refused:
        read_table(tmp_path)
    said = str(refused.value).replace(str(tmp_path), "")
    assert len(said) < 300 and "\n" not in said


def test_what_is_not_read_names_the_command_that_converts_it(tmp_path: Path) -> None:
    for name, command in (
        ("run.xlsx", "libreoffice --headless --convert-to csv"),
        ("run.ulg", "ulog2csv"),
        ("a.pkl", "pandas.read_pickle"),
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


@pytest.mark.timeout(20)  # half a second; each name looked for among all the others took a minute
def test_so_many_columns_as_a_logger_may_have_are_told_apart(tmp_path: Path) -> None:
    names = ["t", *(f"c{k}" for k in range(100_000))]
    file = tmp_path / "wide.csv"
    assert csv._header(file, ",".join(names), ",", 1)[0] == names
    with pytest.raises(RecordingError, match="names column 'c7' twice"):
        csv._header(file, ",".join([*names, "c7"]), ",", 1)


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


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_points_between_thousands_and_tabs_beside_decimal_commas_are_read(
    delimiter: str, tmp_path: Path
) -> None:
    """As Excel writes them in Germany: the first point comes after a thousand rows."""
    rows = [("Zeit [ms]", "q"), *((f"{k},000", "-0,25") for k in range(900))]
    rows += [("1.000,000", "-1.234,5"), ("222.866,25", "0,5")]
    path = tmp_path / "run.csv"
    path.write_text("".join(f"{delimiter.join(row)}\n" for row in rows))
    table = read_table(path)
    assert table["Zeit"][-2:].tolist() == pytest.approx([1.0, 222.86625])
    assert table["q"][[0, -2, -1]].tolist() == [-0.25, -1234.5, 0.5]


def test_a_point_that_parts_no_thousands_is_no_thousands_point(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t;q\n" + "".join(f"{k},0;1\n" for k in range(2000)) + "2000,0;1.5\n")
    assert read_table(path)["q"][-1] == 1.5


def test_points_beside_a_comma_in_a_text_stay_decimal_points(tmp_path: Path) -> None:
    """0.500 would be 500, and 1.500 would be 1500."""
    path = tmp_path / "run.csv"
    path.write_text("t;q;note\n0.500;1.500;a,b\n1.500;2.500;a,b\n")
    table = read_table(path)
    assert table["t"].tolist() == [0.5, 1.5] and table["q"].tolist() == [1.5, 2.5]
