"""The report folder, which other programs read (docs/diagnosis.md): its JSON, its model, its
compensation in C, and its page, which works offline.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE

from zendsp.cli import main
from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.data.split import split
from zendsp.diagnosis.decide.contract import Rejected, contradicted
from zendsp.diagnosis.decide.findings import Estimate, Finding, waves
from zendsp.diagnosis.decide.result import Next
from zendsp.diagnosis.measure.curve import Axis, samples_of
from zendsp.diagnosis.measure.where import Missing
from zendsp.diagnosis.report import files
from zendsp.diagnosis.report.chart import Panel, Series
from zendsp.diagnosis.report.figures import charts, from_a_whole_second
from zendsp.diagnosis.report.files import stands_for, write_report
from zendsp.diagnosis.report.laws import axis_of
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.files.model_file import load_model
from zendsp.physics.model import Model, Quantity, Term


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of one diagnosis from the command line: Coulomb friction and a ripple are missing.
    """
    folder = tmp_path_factory.mktemp("report")
    machine = reality.Machine(ripple=0.02)
    for name, seed in (("train", 1), ("heldout", 2)):
        reality.save(
            folder / f"{name}.csv",
            reality.simulate(machine, reality.multisine(6.0, RATE, seed), RATE),
        )
    reality.model_file(folder / "model.toml", RATE, reality.KNOWN[0])
    out = folder / "out"
    argv = sys.argv
    sys.argv = [
        "zendsp",
        "diagnose",
        *map(
            str,
            (
                folder / "train.csv", "--model", folder / "model.toml", "--heldout",
                folder / "heldout.csv", "--out", out,
            ),
        ),
    ]
    said = io.StringIO()
    try:
        with pytest.raises(SystemExit) as stop, contextlib.redirect_stdout(said):
            main()
    finally:
        sys.argv = argv
    assert stop.value.code == 0
    (folder / "said.txt").write_text(said.getvalue())
    return folder


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    value: dict[str, Any] = json.loads((folder / "out" / "report.json").read_text())
    return value


def test_the_report_says_where_the_next_motion_is_or_why_there_is_none(folder: Path) -> None:
    line = (folder / "said.txt").read_text().splitlines()[-1]
    reference = folder / "out" / "next_reference.mat"
    there = reference if reference.is_file() else "none, nothing is left open"
    assert line == f"next motion: {there}"
    said = [
        files.no_reference(_proposing(proposal))
        for proposal in (None, Next("by hand"), Next("played", (np.zeros((1, 1)), 1.0)))
    ]
    assert said[::2] == ["nothing is left open", ""]
    assert said[1].startswith("where an experiment is named, it is set up by hand")
    assert "'zendsp reference' plans one" in said[1]


def _proposing(proposal: object, *rejected: Rejected) -> Diagnosis:
    return SimpleNamespace(  # type: ignore[return-value]
        next_recording=proposal, verdict="complete", rejected=rejected, regions=(), times=(),
        stopped=False, doubted=contradicted(rejected), nameless=(),
    )


def test_two_diagnoses_can_be_compared_in_a_list() -> None:
    """Their arrays were compared, which have no one truth: `found == read_again` was an error."""
    none: Any = ((), (), ())
    model: Any = None
    one, other = (
        Diagnosis(
            "complete", *none, "rad", model, model, 0.0, (), None, 0.0, (), model, model, model,
            missing={1: [np.zeros(3)]},  # type: ignore[list-item]
        )
        for _ in range(2)
    )  # fmt: skip
    assert one == one and one != other and [other, one].index(one) == 1


def test_report_has_every_key_of_the_contract_with_its_type(report: dict[str, Any]) -> None:
    assert report["verdict"] == "missing"
    assert {f["effect"] for f in report["findings"]} == {"coulomb", "ripple"}
    for f in report["findings"]:
        assert f["effect"] in library() and f["joint"] == 1
        assert {n: set(p) for n, p in f["parameters"].items()} == {
            n: {"value", "std", "unit"} for n in f["parameters"]
        }
        for p in f["parameters"].values():
            assert isinstance(p["value"], float) and p["std"] >= 0 and isinstance(p["unit"], str)
        assert 0 < f["confidence"] <= 1 and 0 <= f["share"] <= 1
        assert (
            isinstance(f["indistinguishable"], list)
            and isinstance(f["replaces"], list)
            and "{" not in f["sentence"]
        )
    assert sum(f["share"] for f in report["findings"]) == pytest.approx(1.0, abs=0.35)
    for a, b in report["where"]["time"]:
        assert 0 <= a < b <= 9.0
    for row in report["where"]["state"]:
        assert (
            set(row) == {"joint", "variable", "interval", "unit", "share", "time_share"}
            and row["unit"]
            in {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s²", "command": "N m"}[
                row["variable"]
            ]
            and row["interval"][0] <= row["interval"][1]
        )
    fit = report["fit"]
    assert (fit["quantity"], fit["unit"]) == ("position", "rad")
    for table in (fit["estimation"], fit["heldout"]):
        assert set(table) == {"given", "calibrated", "improved"}
        assert table["given"] >= table["calibrated"] > table["improved"] > 0
    assert fit["noise_floor"] > 0
    for row in report["rejected"]:
        assert set(row) == {"effect", "joint", "why", "score"} and row["why"]
    assert report["next_recording"] is None or {"sentence", "reference"} <= set(
        report["next_recording"]
    )
    assert report["seconds"] > 0


def test_the_summary_says_in_one_line_what_may_have_been_missed(
    folder: Path, report: dict[str, Any]
) -> None:
    said = " ".join((folder / "said.txt").read_text().split())
    line = said.partition("what may have been missed: ")[2].partition("note:")[0]
    sizes = [f"{x['effect']} below {x['size']:.2g}" for x in report["detectable"]]
    named = [size for size in sizes if size in line]
    assert len(named) == min(3, len(sizes)) and named


def test_found_parameters_are_in_the_units_of_the_contract(report: dict[str, Any]) -> None:
    units = {
        f["effect"]: {n: p["unit"] for n, p in f["parameters"].items()} for f in report["findings"]
    }
    assert units["coulomb"] == {"level": "N m"}
    assert units["ripple"]["amplitude"] == "N m"


def test_the_model_file_states_the_uncertainties_of_the_report(
    folder: Path, report: dict[str, Any]
) -> None:
    terms = load_model(folder / "out" / "model.toml").terms
    for finding in report["findings"]:
        (term,) = [t for t in terms if t.effect == finding["effect"]]
        for name, told in finding["parameters"].items():
            assert term.parameters[name].std == pytest.approx(told["std"], rel=1e-9), name


def test_improved_model_given_again_is_complete(folder: Path) -> None:
    again = folder / "out" / "model.toml"
    data = tomllib.loads(again.read_text())
    assert {e["kind"] for e in data["effect"]} == {"viscous", "coulomb", "ripple"}
    d = diagnose(folder / "train.csv", again, folder / "heldout.csv", jobs=1)
    assert d.verdict == "complete", d.findings


def test_time_stamps_of_a_calendar_are_drawn_from_a_whole_second_that_the_axis_names() -> None:
    t = 1763890000.25 + np.arange(3.0)
    lacking = (Series("line", "before", t, t),)
    stamped = Panel("time [s]", "torque [N m]", lacking, spans=((t[1], t[2]),), clock=True)
    shown = from_a_whole_second(stamped)
    assert shown.xlabel == "time [s] after 1763890000 s"
    assert shown.series[0].x.tolist() == [0.25, 1.25, 2.25] and shown.spans == ((1.25, 2.25),)
    own = Panel("time [s]", "torque [N m]", (Series("line", "before", t - t[0], t),), clock=True)
    assert from_a_whole_second(own) is own


def test_a_wrong_given_number_is_drawn_as_given_and_calibrated(tmp_path: Path) -> None:
    heavy = reality.Machine(inertia=0.016)
    for name, seed in (("train", 1), ("heldout", 2)):
        rows = reality.simulate(heavy, reality.multisine(9.0, RATE, seed), RATE)
        rows["t"] += 100.0  # the target had run for so long
        reality.save(tmp_path / f"{name}.csv", rows)
    model = reality.model_file(tmp_path / "model.toml", RATE, *reality.KNOWN)
    d = diagnose(tmp_path / "train.csv", model, tmp_path / "heldout.csv", jobs=1)
    assert [f.effect for f in d.findings] == ["inertia"]
    drawn = charts(d)
    (chart,) = (c for c in drawn if c.finding == 0)
    given, calibrated = chart.panels
    assert (given.title, calibrated.title) == ("as given", "calibrated")
    assert given.xlabel == "acceleration [rad/s²]"
    line, left = given.series[-1], calibrated.series[1]
    slope = np.polyfit(line.x, line.y, 1)[0]
    assert slope == pytest.approx(0.016 - 0.0102, rel=0.1), "what calibration added"
    assert np.max(np.abs(left.y)) < 0.05 * np.max(np.abs(line.y))
    errors = next(c for c in drawn if c.section == "fit").panels[0].series[0]
    assert 103.0 < errors.x[0] < 106.0, "the half to test on, by the target's clock"
    _, (last,), (note,) = split([read_signals(tmp_path / "train.csv", d.given)])
    assert f"train.csv from {last.time[0]:.2f} s on" in note and last.time[0] > 105.0


def test_page_is_self_contained(folder: Path) -> None:
    text = (folder / "out" / "report.html").read_text()
    assert (
        "http://" not in text
        and "https://" not in text
        and "<script src" not in text
        and "<link" not in text
    )
    assert text.count("data:image/png;base64,") >= 3
    assert "coulomb" in text and "held-out" in text
    assert len(list((folder / "out").glob("*.png"))) >= 3


def test_compensation_compiles_for_the_isr(folder: Path, tmp_path: Path) -> None:
    import shutil
    import subprocess

    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    code = (folder / "out" / "compensation.c").read_text()
    assert "coulomb" in code and "ripple" in code
    include = Path(__import__("zendsp_isr").__file__).parent / "include"
    (tmp_path / "compensation.c").write_text(code)
    done = subprocess.run(
        [
            compiler, "-std=c11", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function",
            f"-I{include}", "-c", "compensation.c", "-o", "compensation.o",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("undriven", [[], [2]])
def test_a_joint_that_nothing_drives_gets_no_torque(undriven: list[int], tmp_path: Path) -> None:
    """The pole of a cart was given a torque against its friction."""
    report: Any = {
        "findings": [{"effect": "coulomb", "joint": j, "mechanism": ""} for j in (1, 2)],
        "refinements": [], "undriven": undriven,
    }  # fmt: skip
    level = {"level": Quantity(0.5)}
    terms = tuple(Term("coulomb", j, level) for j in (1, 2))
    model = Model("cart", None, "rotary", {}, terms=terms)
    d: Any = SimpleNamespace(report=lambda: report, improved=model, findings=[], notes=[])
    files._compensation(d, tmp_path)
    code = (tmp_path / "compensation.c").read_text()
    assert "comp_coulomb1_level" in code and ("comp_coulomb2_level" in code) is not bool(undriven)
    assert ("Not compensated: joint 2, which nothing drives." in code) is bool(undriven)


@pytest.mark.parametrize(
    ("refines", "mechanism", "stands"),
    [
        ("ripple", "position_torque", True),
        ("viscous", "position_torque", False),  # of another mechanism
        ("cubic_stiffness", "position_torque", False),  # grows without end
        # friction that only refines was bent to 40 N m beside the planar arm's 8
        ("position_friction", "dry_friction", False),
    ],
)
def test_of_an_unknown_torque_only_ripples_are_compensated(
    refines: str, mechanism: str, stands: bool, tmp_path: Path
) -> None:
    found = {"effect": "unknown", "joint": 1, "mechanism": mechanism}
    drawn = {"effect": refines, "joint": 1, "mechanism": mechanism_of(refines)}
    report: Any = {"findings": [found], "refinements": [drawn]}
    numbers = {p.name: Quantity(0.5) for p in get_effect(refines).parameters}
    model = Model("bench", None, "rotary", {}, terms=(Term(refines, 1, numbers),))
    said = SimpleNamespace(sentence="A torque …", effect="unknown", joint=1)
    d: Any = SimpleNamespace(
        report=lambda: report, improved=model, findings=[said], notes=[]
    )
    assert stands_for(report) == {("unknown", 1)} | ({(refines, 1)} if stands else set())
    files._compensation(d, tmp_path)
    code = " ".join((tmp_path / "compensation.c").read_text().split())
    assert (f"comp_{refines}1" in code) is stands is ("as far as was recorded" in code)
    assert ("Not compensated: the torque without a law at joint 1" in code) is not stands
    assert ("model2c model.toml --effects-only" in code) is not stands


@pytest.mark.parametrize("refines", ["hysteresis", "ripple"])
def test_the_compensation_has_the_numbers_of_the_sentence(refines: str, tmp_path: Path) -> None:
    # hysteresis, left out of the code, had taken 0.09 of the 0.40 N m that the sentence states
    coulomb = Term("coulomb", 1, {"level": Quantity(0.31)})
    numbers = {p.name: Quantity(0.09) for p in get_effect(refines).parameters}
    model = Model("bench", None, "rotary", {}, terms=(coulomb, Term(refines, 1, numbers)))
    level = {"level": Estimate(0.4, 0.04, "N m")}
    found = Finding("coulomb", 1, level, 0.97, 1.0, (), (), "0.4 N m", mechanism="dry_friction")
    more = Finding(refines, 1, {}, 0.2, 0.0, (), (), "", mechanism=mechanism_of(refines))
    said: Any = {"findings": [vars(found)], "refinements": [vars(more)]}
    d: Any = SimpleNamespace(
        report=lambda: said, improved=model, findings=[found], refinements=[more],
        notes=[],
    )
    files._compensation(d, tmp_path)
    code = (tmp_path / "compensation.c").read_text()
    assert f"comp_coulomb1_level, {0.4 if refines == 'hysteresis' else 0.31}," in code


def test_json_on_the_terminal_is_the_report(
    folder: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    words = ("--model", folder / "model.toml", "--heldout", folder / "heldout.csv")
    plain = ("--json", "--out", folder / "plain", "--no-figures")
    (folder / "plain").mkdir()
    for old in ("report.html", "error.chart.json", "error.png", "next_reference.mat"):
        (folder / "plain" / old).write_text("of another diagnosis")
    (folder / "plain" / "my.png").write_text("the user's own")
    status, out, err = typed("diagnose", folder / "train.csv", *words, *plain)
    assert status == 0 and err == ""
    printed = json.loads(out)
    filed = json.loads((folder / "out" / "report.json").read_text())
    for value in (printed, filed):
        del value["seconds"]
    assert printed == filed  # the same seed, the same bits
    made = {path.name for path in (folder / "plain").iterdir()}
    assert {"report.json", "model.toml", "calibrated.toml", "compensation.c"} <= made
    shown = [name for name in made if name.endswith((".html", ".png", ".chart.json"))]
    assert shown == ["my.png"], "what another diagnosis left would be taken for this one's"
    next_recording = (printed["next_recording"] or {}).get("reference")
    assert ("next_reference.mat" in made) == (next_recording is not None)


def test_a_report_that_a_full_disk_refuses_is_written_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: Callable[..., tuple[object, str, str]]
) -> None:
    def write(result: object, out: Path, *, pictures: bool, progress: object = None) -> Path:
        if out == tmp_path / "out":
            raise OSError(28, "No space left on device", str(out / "report.html"))
        (out / "report.html").write_text("written")
        return out

    for name in ("run.csv", "model.toml"):
        (tmp_path / name).write_text("")
    made = SimpleNamespace(stopped=False)
    monkeypatch.setattr("zendsp.diagnosis.diagnose", lambda *_, **__: made)
    monkeypatch.setattr("zendsp.diagnosis.report.files.write_report", write)
    monkeypatch.setattr("zendsp.diagnosis.report.files.report_text", lambda result: "{}")
    words = ("--model", tmp_path / "model.toml", "--out", tmp_path / "out", "--json")
    status, _, said = typed("diagnose", tmp_path / "run.csv", *words)
    assert status == 1 and "No space left" in said, said
    elsewhere = Path(said.split("it is in ", 1)[1].split()[0])
    assert (elsewhere / "report.html").read_text() == "written"


def test_a_coupling_is_drawn_over_the_motion_of_the_other_joint() -> None:
    states = np.arange(24.0).reshape(2, 3, 4)  # joints, (position, velocity, acceleration), samples
    q, qd, qdd = states[0]
    variables = {"position": q, "velocity": qd, "acceleration": qdd, "command": q}
    lacks = Missing(q, q, q, variables, others=states)
    over = {}
    for law in ("inertia", "coriolis", "viscous", "coulomb"):
        said = {"from_joint": 2, "law": law}
        over[law] = axis_of(Finding("coupling", 1, {}, 0.9, 1.0, (), (), "", said, "inertia"))
    assert {law: str(axis) for law, axis in over.items()} == {
        "inertia": "acceleration of joint 2",
        "coriolis": "velocity of joint 2",
        "viscous": "velocity of joint 2",
        "coulomb": "velocity of joints 1 + 2",
    }
    assert np.array_equal(samples_of(lacks, over["inertia"]), states[1, 2])
    assert np.array_equal(samples_of(lacks, over["coulomb"]), states[0, 1] + states[1, 1])
    assert np.array_equal(samples_of(lacks, Axis("time")), lacks.time)


def test_longer_recordings_are_proposed_where_these_show_nothing(tmp_path: Path) -> None:
    """Two seconds of 0.08 rad, seen by a coarse encoder."""
    t = np.arange(2000) / 1000.0
    command = 0.02 * np.sin(2 * np.pi * t)
    position, speed, rows = 0.0, 0.0, []
    for u in command:
        rows.append(0.0015 * round(position / 0.0015))
        speed += (u - 0.05 * speed) / 0.01 / 1000.0
        position += speed / 1000.0
    np.savez(tmp_path / "run.npz", t=t, q=np.array(rows), u=command)
    (tmp_path / "model.toml").write_text(
        'name = "m"\nsample_time = 0.001\n[mechanism]\nkind = "rotary"\n[mechanism.parameters]\n'
        'inertia = 0.01\n[[effect]]\nkind = "viscous"\njoint = 1\ncoefficient = 0.05\n[sensor]\n'
        'position_resolution = 0.0015\n[columns]\ntime = "t"\nposition = "q"\ncommand = "u"\n'
    )
    d = diagnose(tmp_path / "run.npz", tmp_path / "model.toml", jobs=1)
    assert d.headline.startswith("Cannot tell: ") and d.next_recording is not None
    assert d.next_recording.sentence.startswith("Record joint 1 for longer, ")
    write_report(d, tmp_path / "report")
    assert "class='verdict unexplained'" in (tmp_path / "report" / "report.html").read_text()


def test_ripples_that_describe_an_unknown_torque_are_reported_with_their_numbers() -> None:
    """A cogging of 14 periods a turn had stood in model.toml, but not in the report."""
    each = [
        {"order": Estimate(order, 0.008, "1"), "amplitude": Estimate(size, 0.002, "N m")}
        for order, size in ((13.9986, 0.147), (28.03, 0.045), (41.96, 0.029))
    ]
    assert waves(each[:1]) == "a wave of 0.1470 ± 0.0020 N m, 13.9986 ± 0.0080 times a turn"
    assert waves(each).endswith(
        ", and others 28.0300 ± 0.0080 times a turn and 41.9600 ± 0.0080 times a turn"
    )
