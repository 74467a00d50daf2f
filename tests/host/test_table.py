"""Foreign tables are read, or refused with file, line and column."""

from __future__ import annotations

import gzip
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from zendsp.cli import cli
from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_csv_with_units_gaps_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    table = read_table(
        write(tmp_path / "a.csv", "\ufefft [s],Position (rad),u\r\n0,1,2\r\n0.5,,4\r\n")
    )
    assert table.units == {"t": "s", "Position": "rad", "u": ""}
    assert np.isnan(table["Position"][1]) and table["Position (rad)"][0] == 1.0
    table = read_table(write(tmp_path / "b.csv", "t;q\n0,5;1\n1,5;-2,25\n"))
    assert list(table["q"]) == [1.0, -2.25] and list(table["t"]) == [0.5, 1.5]
    (tmp_path / "c.csv.gz").write_bytes(gzip.compress(b"t,q\n0,1\n1,2\n"))
    assert list(read_table(tmp_path / "c.csv.gz")["q"]) == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"is empty \(0 bytes\)"),
        ("\n", "is empty; expected a line of column names"),
        ("t,q\n", "no rows"),
        ("0,1\n1,2\n", "names of its 2 columns there: put a line such as t,position above"),
        ('t,q\n0,1\n1,"2\n2,3\n', "line 3: a quote .* is opened and not closed"),
        ("t,q\n0,1\n1\n", r"line 3 \('1'\) has 1 value, parted by ',', where the header"),
        ("t,q\n0,1\n1,2,3\n", r"line 3 \('1,2,3'\) has 3 values, parted by ','"),
        ("t;q\n0,5;1,2\n1,5;1,2,3\n", "line 3: '1,2,3' is not a number with a decimal comma"),
        ("t;q\n0,5;1,2\n1,5,1,2\n", r"line 3 \('1,5,1,2'\) has 1 value, parted by ';', where"),
        ("t,q\n0,1\n1,east\n", "column 'q', line 3: 'east' is not a number"),
        ("t,q,q\n0,1,1\n", "names column 'q' twice"),
        ("t,,q\n0,1,1\n", "column 2 has no name"),
    ],
)
def test_malformed_csv_names_file_line_and_column(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path / "bad.csv", text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_table(path)
    assert "bad.csv" in str(caught.value)


def test_binary_rubbish_and_truncated_files_are_refused(tmp_path: Path) -> None:
    good = Recording.from_columns(
        {"q": np.random.default_rng(0).normal(size=5000)}, sample_time=0.001
    )
    for suffix in (".mat", ".npz", ".parquet"):
        whole = good.save(tmp_path / f"whole{suffix}").read_bytes()
        for name, content in {
            "cut": whole[: len(whole) * 2 // 3],
            "rubbish": b"\xff\x00\x17" * 999,
        }.items():
            path = tmp_path / f"{name}{suffix}"
            path.write_bytes(content)
            with pytest.raises(RecordingError, match=rf"{name}\{suffix}"):
                read_table(path)
    (tmp_path / "binary.csv").write_bytes(whole[:999])
    with pytest.raises(RecordingError, match="is not text; is it a file of another kind"):
        read_table(tmp_path / "binary.csv")
    (tmp_path / "cut.csv.gz").write_bytes(gzip.compress(b"t,q\n" + b"0,1\n" * 999)[:40])
    with pytest.raises(RecordingError, match="gzip"):
        read_table(tmp_path / "cut.csv.gz")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_a_spreadsheet_of_any_encoding_is_read_with_its_degrees(
    tmp_path: Path, encoding: str
) -> None:
    file = tmp_path / "run.csv"
    file.write_bytes("Zeit;Prüfling [°]\r\n0,0;180,0\r\n0,1;90,0\r\n".encode(encoding))
    table = read_table(file)
    assert table["Prüfling"] == pytest.approx([np.pi, np.pi / 2])


@pytest.mark.parametrize("below", ["", "s;rad;\n"])
def test_a_separator_at_the_end_of_each_line_is_no_column(tmp_path: Path, below: str) -> None:
    table = read_table(write(tmp_path / "run.csv", f"t;q;\n{below}0;1;\n0,1;;\n0,2;3\n"))
    assert list(table.columns) == ["t", "q"]
    assert table["q"] == pytest.approx([1.0, np.nan, 3.0], nan_ok=True)


def test_lines_above_the_names_of_the_columns_are_to_be_deleted(tmp_path: Path) -> None:
    file = write(tmp_path / "run.csv", "Messung;3\nMaschine;Pendel\nt;q\n0;1\n0,1;2\n")
    with pytest.raises(RecordingError, match=r"delete the lines above the names of the columns"):
        read_table(file)


@pytest.mark.parametrize("units", ["", "s,rad,N m\n"])
def test_the_command_that_deletes_them_is_named_and_does(tmp_path: Path, units: str) -> None:
    rows = "".join(f"{0.1 * k:.1f},{k},{2 * k}\n" for k in range(20))
    above = "channel,sensor,drive\nname,encoder,motor\n"
    file = write(tmp_path / "run.csv", f"{above}t,q,u\n{units}{rows}")
    with pytest.raises(RecordingError) as refused:
        read_table(file)
    said = str(refused.value)
    assert "if these are line 3 ('t,q,u'), by 'tail -n +3 " in said
    command = re.search(r"by '(tail .*)'$", said)
    assert command is not None
    subprocess.run(command[1], shell=True, cwd=tmp_path, check=True)
    assert list(read_table(tmp_path / "named.csv").columns) == ["t", "q", "u"]


def test_a_folder_of_one_recording_is_read_as_that(tmp_path: Path) -> None:
    """``zendsp model new runs/NAME`` said that it is a folder, and not what is in it."""
    run = tmp_path / "runs" / "today"
    run.mkdir(parents=True)
    write(run / "a.csv", "t,q\n0,1\n1,2\n")
    write(run / "run.json", "{}")
    assert list(read_table(run).columns) == ["t", "q"]
    write(run / "b.csv", "t,q\n0,1\n1,2\n")
    with pytest.raises(RecordingError, match=r"with 2 recordings \(a\.csv, b\.csv\): give one"):
        read_table(run)
    made = Recording.from_columns({"u": np.arange(3.0)}, t=np.arange(3.0))
    made.save(run / "recording.mat")
    assert list(read_table(run).columns) == ["t", "u"], "that of the run"
    assert list(Recording.load(run).names) == ["u"]
    done = CliRunner().invoke(cli, ["model", "new", str(run), "-o", str(tmp_path / "m.toml")])
    assert done.exit_code == 0 or "is a folder" not in str(done.exception)


def test_missing_file_folder_and_unknown_kind_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(RecordingError, match="is a folder with 0 recordings"):
        read_table(tmp_path)
    with pytest.raises(RecordingError, match=r"unknown kind of file '\.xlsx'"):
        read_table(write(tmp_path / "run.xlsx", "x"))


@pytest.mark.parametrize(
    ("name", "kind"), [("arm.urdf", "urdf"), ("arm.xml", "mjcf"), ("arm.urdf.xacro", "urdf")]
)
def test_the_description_of_a_robot_is_no_recording_and_goes_into_a_model_file(
    tmp_path: Path, name: str, kind: str
) -> None:
    says = rf'\[mechanism\] kind = "{kind}", file = "{name}".*zendsp target --machine .*{name}'
    with pytest.raises(RecordingError, match=says):
        read_table(write(tmp_path / name, "<robot/>"))


def test_mat_vectors_scalars_structures_and_cells(tmp_path: Path) -> None:
    import scipy.io

    cells = np.empty((2, 1), dtype=object)
    cells[0, 0], cells[1, 0] = np.arange(5.0)[:, None], np.arange(7.0)[:, None]
    contents = {
        "t": np.arange(9.0)[:, None],
        "qm": np.arange(9.0)[None, :],
        "kp": 160.18,
        "Theta": {"time": np.arange(9.0), "signals": {"values": np.ones((9, 2))}},
    }
    scipy.io.savemat(tmp_path / "a.mat", contents)
    table = read_table(tmp_path / "a.mat")
    assert table["qm"].shape == (9,) and table["Theta.signals.values"].shape == (9, 2)
    assert table.constants == {"kp": 160.18}
    scipy.io.savemat(tmp_path / "b.mat", contents | {"Y": cells})
    with pytest.raises(
        RecordingError, match=r"columns differ in length: 't' has 9 rows, 'Y\{1\}' has 5"
    ):
        read_table(tmp_path / "b.mat")
    assert len(read_table(tmp_path / "b.mat", columns=["t", "qm"])) == 9
    assert len(read_table(tmp_path / "b.mat", columns=["Y{2}"])) == 7


def test_mat_v73_is_read_in_the_orientation_that_matlab_wrote(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "v73.mat"
    # MATLAB writes its text header into a user block
    with h5py.File(path, "w", userblock_size=512) as file:
        # the transpose of a 5 x 2 matrix, as MATLAB stores it
        file["q"] = np.arange(10.0).reshape(2, 5)
        file["t"] = np.arange(5.0).reshape(1, 5)
        file["name"] = np.array([[104], [105]], dtype=np.uint16)
        file["name"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, written by a test")
    table = read_table(path)
    assert np.array_equal(table["q"][:, 1], [5.0, 6.0, 7.0, 8.0, 9.0]) and len(table["t"]) == 5


def test_npz_refuses_pickles_and_names_ragged_and_non_numeric_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=np.arange(4.0), q=np.arange(3.0))
    with pytest.raises(RecordingError, match="'t' has 4 rows, 'q' has 3"):
        read_table(tmp_path / "a.npz")
    np.savez(
        tmp_path / "b.npz", t=np.arange(4.0), who=np.array([{"a": 1}], dtype=object),
        s=np.array(["x"] * 4),
    )
    assert list(read_table(tmp_path / "b.npz").columns) == ["t"]
    with pytest.raises(RecordingError, match=r"column 'who' is not a plain numeric array"):
        read_table(tmp_path / "b.npz", columns=["who"])
    with pytest.raises(RecordingError, match=r"column 's' holds <U1"):
        read_table(tmp_path / "b.npz", columns=["s"])
    with pytest.raises(RecordingError, match=r"no column 'z'; it has t"):
        read_table(tmp_path / "b.npz", columns=["z"])


def test_foreign_table_with_a_time_column_loads_as_a_recording(tmp_path: Path) -> None:
    rec = Recording.load(write(tmp_path / "a.csv", "time,q1,q2\n0,1,2\n0.5,3,4\n1,5,6\n"))
    assert rec.sample_time == 0.5 and rec.names == ("q1", "q2")
    with pytest.raises(RecordingError, match="no time column"):
        Recording.load(write(tmp_path / "b.csv", "x,y\n0,1\n"))


def test_published_data_sets_read(tmp_path: Path) -> None:
    import os

    if not os.environ.get("ZENDSP_DATA"):
        pytest.skip("set ZENDSP_DATA to the folder of published recordings (see its README)")
    folder = Path(os.environ["ZENDSP_DATA"])
    emps = read_table(folder / "emps/DATA_EMPS.mat")
    assert emps["qm"].shape == (24841,) and emps.constants["gtau"] == pytest.approx(35.15, abs=0.01)
    swing = read_table(
        folder / "single_pendulum/SingleDataFreeSwing_1_Dt_0_0001.mat", ["Theta1.signals.values"]
    )
    assert len(swing) > 200_000
    assert read_table(folder / "tx40/pos_read_data.csv.gz")["Joint_6"].shape == (45_000,)


def test_an_unrecognised_suffix_stays_in_the_column_name_and_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,q (raw),q (filtered) [deg],u (N m)\n0,1,2,3\n1,2,4,5\n")
    table = read_table(path)
    assert list(table.columns) == ["t", "q (raw)", "q (filtered)", "u"]
    assert table["q (raw)"].tolist() == [1.0, 2.0]
    assert table["q (filtered)"][0] == pytest.approx(np.radians(2.0))
    assert [note for note in table.notes if "'raw' is no unit" in note]
    assert not [note for note in table.notes if "'filtered'" in note], "its unit is written"
