"""Text files as loggers and spreadsheets write them: dates, units, decimal commas, many columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zendsp.diagnosis import diagnose
from zendsp.errors import RecordingError
from zendsp.recording import Recording, read_table
from zendsp.recording.formats import cells, csv
from zendsp.recording.roles import Role, role_of


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
def test_day_first_dates_are_read_and_ambiguous_ones_are_reported(
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


def test_a_day_and_a_time_of_day_in_columns_of_their_own_are_a_time(tmp_path: Path) -> None:
    """The points of the day had made all decimal commas text; and the log goes on past midnight."""
    path = tmp_path / "log.csv"
    path.write_text(
        "Datum;Uhrzeit;Azimut [°];M [Nm]\n03.11.2026;23:59:59,990;180,0;-1,5\n"
        "04.11.2026;00:00:00,000;90,0;2,25\n04.11.2026;00:00:00,010;0,0;3,0\n"
    )
    table = read_table(path)
    assert list(table.columns) == ["Uhrzeit", "Azimut", "M"]
    np.testing.assert_allclose(table["Azimut"], [np.pi, np.pi / 2, 0.0])
    np.testing.assert_allclose(Recording.load(path).t, [0.0, 0.01, 0.02], atol=1e-9)
    assert "Datum: left out, it holds dates without a time of day" in table.notes


@pytest.mark.parametrize("parts", ["header.stamp.sec,header.stamp.nanosec", "secs,nsecs"])
def test_a_stamp_of_ros_in_two_columns_is_one_time(tmp_path: Path, parts: str) -> None:
    """It had been taken for a time with too few digits."""
    path = tmp_path / "bag.csv"
    path.write_text(
        f"{parts},position[0],effort[0]\n1762178707,990000000,0.1,1\n1762178708,0,0.2,2\n"
    )
    recording = Recording.load(path)
    np.testing.assert_allclose(recording.t, [0.99, 1.0], atol=1e-9)
    assert not any("sec" in name for name in recording.columns)


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


@pytest.mark.timeout(20)  # half a second; each name looked for among all the others took a minute
@pytest.mark.parametrize(
    ("head", "names"),
    [
        ("t/s;phi/°;M/Nm", ("t", "phi", "M")),
        ("t / s;phi / (deg);M / (N·m)", ("t", "phi", "M")),
        ("Time(s);Pos(deg);Trq(Nm)", ("Time", "Pos", "Trq")),
        ("t[s];q<deg>;tau<N*m>", ("t", "q", "tau")),
        ("Zeit in s;Winkel in Grad;Moment in N-m", ("Zeit", "Winkel", "Moment")),
        ("time, s;motor angle, deg;torque, N.m", ("time", "motor angle", "torque")),
        ("time_s;theta_degrees;torque_N_m", ("time_s", "theta_degrees", "torque_N_m")),
    ],
)
def test_a_unit_is_read_however_the_head_sets_it_apart(
    tmp_path: Path, head: str, names: tuple[str, ...]
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{head}\n0.0;90.0;1.0\n0.1;180.0;2.0\n")
    table = read_table(path)
    assert tuple(table.columns) == names
    np.testing.assert_allclose(table[names[1]], [np.pi / 2, np.pi])
    assert [table.units[name].replace(" ", "") for name in names] == ["s", "rad", "Nm"]


@pytest.mark.parametrize(
    "head",
    ["t;Plant/A;q(1)", "t;Root/Plant/theta;q[0,1]", "t;f(x);lp(tau, 20)", "t;state, raw;q in"],
)
def test_what_is_no_unit_that_is_known_stays_in_the_name(tmp_path: Path, head: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{head}\n0.0;90.0;1.0\n0.1;180.0;2.0\n")
    table = read_table(path)
    assert list(table.columns) == head.split(";")
    assert not any(table.units.values())


def test_a_hundred_thousand_columns_are_read_and_a_name_twice_is_refused(tmp_path: Path) -> None:
    names = ["t", *(f"c{k}" for k in range(100_000))]
    file = tmp_path / "wide.csv"
    assert csv._header(file, ",".join(names), ",", 1)[0] == names
    with pytest.raises(RecordingError, match="names column 'c7' twice"):
        csv._header(file, ",".join([*names, "c7"]), ",", 1)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_thousands_points_beside_decimal_commas_are_read(delimiter: str, tmp_path: Path) -> None:
    """As German Excel writes them; the first such point comes only after a thousand rows."""
    rows = [("Zeit [ms]", "q"), *((f"{k},000", "-0,25") for k in range(900))]
    rows += [("1.000,000", "-1.234,5"), ("222.866,25", "0,5")]
    path = tmp_path / "run.csv"
    path.write_text("".join(f"{delimiter.join(row)}\n" for row in rows))
    table = read_table(path)
    assert table["Zeit"][-2:].tolist() == pytest.approx([1.0, 222.86625])
    assert table["q"][[0, -2, -1]].tolist() == [-0.25, -1234.5, 0.5]


def test_a_point_that_does_not_separate_thousands_is_not_a_thousands_point(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t;q\n" + "".join(f"{k},0;1\n" for k in range(2000)) + "2000,0;1.5\n")
    assert read_table(path)["q"][-1] == 1.5


def test_points_beside_a_comma_within_a_text_stay_decimal_points(tmp_path: Path) -> None:
    """Otherwise 0.500 would become 500, and 1.500 would become 1500."""
    path = tmp_path / "run.csv"
    path.write_text("t;q;note\n0.500;1.500;a,b\n1.500;2.500;a,b\n")
    table = read_table(path)
    assert table["t"].tolist() == [0.5, 1.5] and table["q"].tolist() == [1.5, 2.5]


@pytest.mark.parametrize("head", ["t q_deg i", "t [s] q [deg] i[A]", "  t   q_deg i  "])
def test_blanks_part_columns_where_nothing_else_does(tmp_path: Path, head: str) -> None:
    """As halsampler of LinuxCNC, gnuplot and numpy.savetxt write them."""
    path = tmp_path / "axis.log"
    path.write_text(f"{head}\n0.000  180 -0.5 \n0.001   90  0.25\n")
    table = read_table(path)
    time, q, i = (table[name] for name in table.columns)
    np.testing.assert_allclose([time, q, i], [[0, 0.001], [np.pi, np.pi / 2], [-0.5, 0.25]])
    path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_allclose(list(read_table(path).columns.values())[2], [-0.5, 0.25])
    path.write_text("0 0.5 1\n1 0.6 2\n")
    with pytest.raises(RecordingError, match="of its 3 columns there: put a line such as t pos"):
        read_table(path)
    path.write_text("t q i\n0 1 2\noverrun\n1 2 3\n")
    with pytest.raises(RecordingError, match=r"line 3 \('overrun'\) has 1 value"):
        read_table(path)


PREFACE = "Device: bench 3\nOperator: Anna\n\nRate [Hz];1000\n"


@pytest.mark.parametrize(
    ("head", "rows"),
    [
        ("t [s];q [rad];u [N m]\n", "0,000;0,1;1,5\n0,001;0,2;1,6\n0,002;0,3;1,7\n"),
        ("t;q;u\ns;rad;N m\n", "0,000;0,1;1,5\n0,001;0,2;1,6\n0,002;0,3;1,7\n"),
        ("t [s],q [rad],u [N m],\n", "0.000,0.1,1.5,\n0.001,0.2,1.6,\n0.002,0.3,1.7,\n"),
        (
            "t\tq [rad]\tu [N m]\n",
            "10:00:00.000\t0.1\t1.5\n10:00:00.001\t0.2\t1.6\n10:00:00.002\t0.3\t1.7\n",
        ),
    ],
)
def test_lines_above_the_header_are_passed_over_and_told(
    tmp_path: Path, head: str, rows: str
) -> None:
    path = tmp_path / "run.csv"
    path.write_text(PREFACE + head + rows)
    table = read_table(path)
    assert list(table.columns) == ["t", "q", "u"] and table.units["q"] == "rad"
    np.testing.assert_allclose(table["t"], [0.0, 0.001, 0.002], atol=1e-12)
    np.testing.assert_allclose(table["u"], [1.5, 1.6, 1.7])
    assert table.notes[0] == "4 lines above the names of the columns passed over"
    path.write_text(head + rows)
    assert not any("passed over" in note for note in read_table(path).notes)


@pytest.mark.parametrize("above", ["", "Limits;-10;10;V;peak\n\n"])
@pytest.mark.parametrize("units", ["", "s;;rad;N m\n"])
def test_a_title_is_passed_over_where_a_column_holds_words(
    tmp_path: Path, above: str, units: str
) -> None:
    """No line below the title was one of numbers only, so the title was taken for the names."""
    path = tmp_path / "run.csv"
    rows = ["0,000;up;0,1;1,5", "0,001;;0,2;1,6", "0,002;down;0,3;1,7", "0,003;up;0,4;"]
    path.write_text("Test bench; run 7\n" + above + "t;phase;q;u\n" + units + "\n".join(rows))
    table = read_table(path)
    assert list(table.columns) == ["t", "q", "u"]
    assert "phase: left out, it holds text" in table.notes
    np.testing.assert_allclose(table["q"], [0.1, 0.2, 0.3, 0.4])
    assert "passed over" in table.notes[0]


@pytest.mark.parametrize(
    "text",
    [
        "Rate;1000\nt;q\n0;0,1\n1;0,2\n2;0,3\n",  # either line may name the columns
        "Bench\nfirst;second\nt;q\n0;0,1\n1;0,2\n2;0,3\n",
        "Bench\nt;q;u\n0;0,1\n1;0,2\n2;0,3\n",  # no line does
        "Bench\nt;q\n0;0,1\n1;0,2;7\n2;0,3\n",  # numbers that part otherwise
    ],
)
def test_where_no_line_is_surely_the_header_it_is_asked_for(tmp_path: Path, text: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"delete the lines above the names of the columns"):
        read_table(path)


@pytest.mark.parametrize(
    "text",
    [
        "# t q u\n0.0 1.0 2.0\n0.1 1.5 2.5\n",  # np.savetxt(..., header="t q u")
        "# by hand\n# t,q,u\n0.0,1.0,2.0\n0.1,1.5,2.5\n",
        "% t q u\n  0.0 1.0 2.0\n  0.1 1.5 2.5\n",  # MATLAB
        "%t,q,u\n0.0,1.0,2.0\n0.1,1.5,2.5\n",
        "# a logger\n\nt,q,u\n0.0,1.0,2.0\n0.1,1.5,2.5\n",
        "t,q,u\n0.0,1.0,2.0\n,,\n0.1,1.5,2.5\n,,\n\n",  # a spreadsheet
    ],
)
def test_names_in_a_comment_and_empty_rows_are_understood(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    table = read_table(path)
    assert {name: values.tolist() for name, values in table.columns.items()} == {
        "t": [0.0, 0.1], "q": [1.0, 1.5], "u": [2.0, 2.5]
    }  # fmt: skip


def test_a_comment_of_numbers_or_words_names_no_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    for comment in ("# 1,2,3", "# taken on a monday"):
        path.write_text(f"{comment}\n0.0,1.0,2.0\n0.1,1.5,2.5\n")
        with pytest.raises(RecordingError, match="expected the names of its 3 columns"):
            read_table(path)


@pytest.mark.parametrize(("left", "right"), [("(", ")"), ("[", "]")])
def test_the_array_of_a_message_in_one_cell_is_a_column_of_each_joint(
    tmp_path: Path, left: str, right: str
) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(
        f"{0.1 * k},\"{left}'hip', 'knee'{right}\",\"{left}{k}.5, -{k}{right}\"\n" for k in range(3)
    )
    path.write_text(f"t,name,position\n{rows}")
    table = read_table(path)
    assert table["position"].tolist() == [[0.5, 0.0], [1.5, -1.0], [2.5, -2.0]]
    assert table.notes == ("name: left out, it holds text",)
    path.write_text(f"t,name,position\n{rows}0.3,x,\"{left}1.0{right}\"\n")
    with pytest.raises(RecordingError, match="'position' holds text"):
        read_table(path, ["position"])


def test_the_time_of_rostopic_is_in_nanoseconds(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    body = "1700000000000000000,5000000,0.1\n1700000000002000000,7000000,0.2\n"
    path.write_text(f"%time,field.header.stamp,field.position0\n{body}")
    table = read_table(path)
    for name in ("%time", "field.header.stamp"):
        assert np.diff(table[name]) == pytest.approx(0.002, abs=3e-7)  # digits of 1.7e9 s
        assert table.units[name] == "s"
    path.write_text(f"%time,q,u\n{body}")  # of another program: nothing is known
    assert read_table(path).units["time"] == ""


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("t,q", "{t},{q}"),
        ("t;q", "{t};{q}"),
        ("t q", "{t} {q}"),
        ("day,q", "01.02.2026 00:00:{t:09.6f},{q}"),  # one by one: no share is told
    ],
)
def test_a_long_text_is_read_in_pieces_to_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, head: str, row: str
) -> None:
    file = tmp_path / "long.csv"
    lines = [row.format(t=0.1 * k, q=(-1.0) ** k / (k + 1)) for k in range(300)]
    file.write_text("\n".join([head, *lines, "", ""]))
    at_once = read_table(file)
    monkeypatch.setattr(cells, "READ", 100)
    shares: list[float] = []
    in_pieces = read_table(file, progress=shares.append)
    for name, values in at_once.columns.items():
        assert len(values) == 300 and np.array_equal(in_pieces[name], values)
    assert shares == sorted(shares)
    assert shares[-1:] == ([] if head.startswith("day") else [1.0]) and len(shares) != 1


def test_a_short_line_far_down_in_a_long_text_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cells, "READ", 100)
    file = tmp_path / "long.csv"
    lines = [f"{0.1 * k},{k}" for k in range(300)]
    for wrong in ("29.9", "29.9,1,2", "29.9,x"):
        file.write_text("\n".join(["t,q", *lines[:250], wrong, *lines[250:]]))
        with pytest.raises(RecordingError, match="line 252"):
            read_table(file)
    whole_piece = [line.split(",")[0] for line in lines[200:]]  # pieces that differ in width
    file.write_text("\n".join(["t,q", *lines[:200], *whole_piece]))
    with pytest.raises(RecordingError, match="line 202"):
        read_table(file)


def test_a_diagnosis_tells_the_share_of_a_long_file_that_it_has_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cells, "READ", 2000)
    file = tmp_path / "still.csv"
    file.write_text("\n".join(["t,q,u", *(f"{0.01 * k:.2f},1,0" for k in range(500))]))
    model = {"sample_time": 0.01, "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}}}
    said: list[str] = []
    with pytest.raises(RecordingError):
        diagnose([file], model, progress=said.append)
    assert said[0] == "reading the recordings"
    shares = [one for one in said if one.startswith("reading still.csv: ")]
    assert len(shares) > 1 and shares[-1] == "reading still.csv: 100%"


def test_quoted_decimal_commas_are_read_where_commas_part_the_columns(tmp_path: Path) -> None:
    """They were refused, with the advice to delete all lines of numbers."""
    path = tmp_path / "log.csv"
    path.write_text('"Zeit [s]","Winkel [deg]"\n"0,0000","180,00"\n"0,0020",""\n"0,0040","-90,5"\n')
    table = read_table(path)
    assert table["Zeit"].tolist() == [0.0, 0.002, 0.004]
    assert np.allclose(table["Winkel"], np.radians([180.0, np.nan, -90.5]), equal_nan=True)
    path.write_text('t,x\n1,"1,234"\n2,"2,345"\n')  # may be thousands: no number is made of it
    assert read_table(path).notes == ("x: left out, it holds text",)
    path.write_text('t,x\n"1,234","1,234"\n"2,345","2,345"\n')
    with pytest.raises(RecordingError, match="'1,234' is not a number") as error:
        read_table(path)
    assert "tail" not in str(error.value)


def test_a_german_time_stamp_is_the_time() -> None:
    assert role_of("Zeitstempel", "s") is role_of("Messzeit [s]") is Role.TIME


@pytest.mark.parametrize(
    ("rows", "last"),
    [
        (["7;999;2,5", "8;1.000;2,5"], [1000.0, 2.5]),  # 1.000 was one
        (["7;0;0"] * 900 + ["8;3;1,5"], [3.0, 1.5]),  # at rest there were no commas
        (["7;12.345;2.5", "8;1.007;2.5"], [1.007, 2.5]),
        (["7;1.000,5;v1.2", "8;1.000;v1.2"], [1000.0]),  # words say nothing of numbers
        (["7;0,5;rev 1.2"] * 900 + ["8;1.000;v1.2"], [1000.0]),
        (["7;0,5;ok"] * 900 + ["8;1.000;1.2.3"], [1000.0]),
        (["7;0,5;12:00:00.500", "8;1.000;12:00:01.500"], [1000.0, 1.0]),
    ],
)
def test_a_point_beside_decimal_commas_is_between_thousands(
    tmp_path: Path, rows: list[str], last: list[float]
) -> None:
    file = tmp_path / "run.csv"
    file.write_text("\n".join(["t [s];q;tau", *(f"{k};{r[2:]}" for k, r in enumerate(rows)), ""]))
    assert Recording.load(file).data[-1].tolist() == last


@pytest.mark.parametrize("cell", ["1.111", "1.", "111", "x", "1.000", "(1,"])
def test_a_cell_of_many_points_holds_nobody_up(tmp_path: Path, cell: str) -> None:
    """64 kB of them took 19 s."""
    file = tmp_path / "run.csv"
    file.write_text("t;q;tau\n0;" + cell * 30_000 + ";2,5\n1;x.y;3,5\n")
    with pytest.raises(RecordingError):
        Recording.load(file)
