"""Files that are damaged, vast, or lead elsewhere: refused, and no reader crashes."""

from __future__ import annotations

import gzip
import io
import os
import resource
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from makers import mdf

from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table
from zendsp.recording.formats import apart


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


@pytest.mark.parametrize("begin", [
    b"\x80\4K\1.", b"t,q,u\n0,1,2\n", b"\x93NUMPY\1\0", b"PK.", b"PK\3\4",
])  # fmt: skip
def test_what_is_no_archive_gets_no_advice_to_load_it_unsafely(
    tmp_path: Path, begin: bytes
) -> None:
    """NumPy says of any such file that it is a pickle, and how to run what is in it."""
    path = tmp_path / "run.npz"
    path.write_bytes(begin + bytes(range(200)))
    with pytest.raises(RecordingError, match=r"run\.npz: is (not a readable NPZ|a single)") as said:
        read_table(path)
    assert "pickle" not in str(said.value)


@pytest.mark.parametrize("begin", [b"", b"t,q,u\n0,1,2\n", "\ufefft,q\n".encode("utf-16-le")])
def test_a_vast_file_of_nothing_is_refused_by_its_first_bytes(tmp_path: Path, begin: bytes) -> None:
    """One of 2 GB took 27 s: it was read as a whole."""
    path = tmp_path / "sparse.csv"
    with path.open("wb") as file:
        file.write(begin)
        file.truncate(1 << 30)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError, match="is not text"):
        read_table(path)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before  # kB
    assert grown < 1 << 18, "a quarter of it"


def test_a_text_that_is_larger_than_the_memory_is_refused_by_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, memory = tmp_path / "run.csv", tmp_path / "meminfo"
    path.write_text("t,q\n" + "0.001,0\n" * 100_000)
    memory.write_text("MemAvailable: 1000 kB\n")
    monkeypatch.setattr("zendsp.recording.formats.raw.MEMORY", memory)
    with pytest.raises(RecordingError, match=r"says that it holds 0\.0 GB"):
        read_table(path)


@pytest.mark.parametrize("said", ["null", "[]", "7", '"q"', "{}"])
def test_a_description_that_is_no_table_of_names_is_refused_as_damaged(
    tmp_path: Path, said: str
) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f"t,q\n0,1\n1,2\n# zendsp {said}\n")
    with pytest.raises(RecordingError, match=r"run\.csv: its description is damaged"):
        Recording.load(path)
