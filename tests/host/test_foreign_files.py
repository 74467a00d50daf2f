"""Files of other tools: each kind is written here by its own library, read, and damaged."""

from __future__ import annotations

import gzip
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
import scipy.io

from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table
from zendsp.recording.formats import apart

RNG = np.random.default_rng(7)
N = 400
T = np.arange(N) * 0.002
Q = np.cumsum(RNG.normal(size=(N, 2)), axis=0) * 0.01
U = RNG.normal(size=N)


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


@pytest.mark.parametrize("name", ["taken.h5", "taken.mat"])
def test_a_file_takes_no_bytes_of_another_file_for_its_numbers(name: str, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(range(40)))
    path = tmp_path / name
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        file["t"] = np.arange(5.0)
        file.create_dataset("q", (5,), "f8", external=[(str(secret), 0, 40)])
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, written by a test")
    with pytest.raises(RecordingError, match=r"q.? stands in another file"):
        read_table(path, columns=["q"])


@pytest.mark.parametrize("name", ["run.mat", "run.h5"])
@pytest.mark.parametrize("how", ["link", "virtual", "link in a group"])
def test_a_file_follows_no_link_to_another_file(name: str, how: str, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    other, path = tmp_path / "other.h5", tmp_path / name
    with h5py.File(other, "w") as file:
        file["q"] = np.arange(5.0)
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = np.arange(5.0)
        if how == "virtual":
            layout = h5py.VirtualLayout((5,), "f8")
            layout[:] = h5py.VirtualSource(str(other), "q", (5,))
            file.create_virtual_dataset("q", layout)
        else:
            group = file.create_group("run") if how == "link in a group" else file
            group["q"] = h5py.ExternalLink(str(other), "q")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, written by a test")
    with pytest.raises(RecordingError, match=r"q.? stands in another file"):
        read_table(path, columns=["run.q" if how == "link in a group" else "q"])


@pytest.mark.parametrize("name", ["run.csv.gz", "run.mat"])
def test_a_small_file_that_unpacks_to_more_than_there_is_room_for_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory, path = tmp_path / "meminfo", tmp_path / name
    memory.write_text("MemAvailable: 1000 kB\n")
    monkeypatch.setattr("zendsp.recording.formats.raw.MEMORY", memory)
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(b"t,q\n" + b"0.001,0\n" * 100_000))
    else:
        scipy.io.savemat(path, {"q": np.zeros(100_000)}, do_compression=True)
    assert path.stat().st_size < 20_000
    with pytest.raises(RecordingError, match=r"says that it holds 0\.0 GB"):
        read_table(path, columns=["q"])


def test_cells_that_hold_one_another_are_refused_soon(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = np.arange(5.0)
        file["#refs#/0"] = np.arange(5.0)
        for k in range(12):  # ten of ten of ten …: 10^12 parts
            inner = np.full((10, 1), file[f"#refs#/{k}"].ref, dtype=h5py.ref_dtype)
            file.create_dataset(f"#refs#/{k + 1}", data=inner)
        file.create_dataset("q", data=inner)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, written by a test")
    with pytest.raises(RecordingError, match="cells that hold one another"):
        read_table(path, columns=["q"])


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


def test_an_unreadable_kind_of_file_is_refused_with_the_command_that_converts_it(
    tmp_path: Path
) -> None:
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
