"""The result of an experiment: its file, the model that takes it in, and the report."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from zendsp.cli.experiment import command
from zendsp.errors import ModelError, RecordingError
from zendsp.experiment import EXPERIMENTS, Estimate, Lab, Result, fit_model, put_into
from zendsp.experiment.report import table, wrapped, write_report
from zendsp.experiment.result import FoundEffect
from zendsp.physics import library, load_model

MODELS = Path(__file__).parents[2] / "examples" / "models"


def result() -> Result:
    where = "imi_planar (simulated, fast clock)"
    r = Result("friction-curve", "Friction", "imi_planar", target=where)
    r.values["level"] = Estimate(8.4, 0.1, "N m")
    r.effects = [FoundEffect("coulomb", 1, {"level": Estimate(np.float64(8.4), 0.1, "N m")})]
    r.mechanism = {"p1": Estimate(3.5, 0.01, "kg m^2")}
    r.tables = {"points": [{"joint": 1, "speed": np.float64(0.5)}]}
    r.warnings = ["take care"]
    return r


def test_a_result_file_says_all_and_reads_back(tmp_path: Path) -> None:
    file = result().save(tmp_path / "result.toml")
    data = tomllib.loads(file.read_text())
    assert (
        data["values"]["level"] == {"value": 8.4, "std": 0.1, "unit": "N m"}
        and data["effect"][0]["kind"] == "coulomb"
    )
    again = Result.load(file)
    assert (
        again.values == result().values
        and again.warnings == ["take care"]
        and again.tables["points"][0]["speed"] == 0.5
    )
    (tmp_path / "other.toml").write_text("a = 1")
    with pytest.raises(RecordingError, match="not the result"):
        Result.load(tmp_path / "other.toml")


def test_a_model_file_takes_the_result_in_and_keeps_what_was_not_measured(tmp_path: Path) -> None:
    model = tmp_path / "imi.toml"
    model.write_text((MODELS / "imi_planar.toml").read_text())
    changes = put_into(result(), model)
    after = load_model(model)
    assert [(t.effect, t.joint) for t in after.terms] == [
        ("viscous", 2),
        ("coulomb", 2),
        ("coulomb", 1),
    ]
    assert after.terms[-1].value("level") == 8.4 and after.terms[-1].parameters["level"].std == 0.1
    assert (
        after.mechanism["p1"][0].value == 3.5
        and after.actuator.delay == 0.00116
        and after.controller["kp"] == [2000.0, 300.0]
    )
    assert any("joint 1 replaced (2 terms by 1)" in text for text in changes)


@pytest.mark.parametrize("kind", ["coulomb_tanh", "friction_block", "stribeck", "quadratic_drag"])
def test_friction_over_the_speed_gives_way_to_what_was_measured(tmp_path: Path, kind: str) -> None:
    """Otherwise the joint would have that friction twice. Friction over the position was not
    measured and stays.
    """
    model = tmp_path / "imi.toml"
    old = library()[kind]
    numbers = "".join(f"{p.name} = 0.5\n" for p in old.parameters)
    ripple = 'kind = "position_friction"\njoint = 1\namplitude = 0.1\nperiod = 1.0\nphase = 0.0\n'
    model.write_text(
        (MODELS / "imi_planar.toml").read_text()
        + f'\n[[effect]]\nkind = "{kind}"\njoint = 1\n{numbers}\n[[effect]]\n{ripple}'
    )
    put_into(result(), model)
    assert [t.effect for t in load_model(model).terms if t.joint == 1] == [
        "position_friction", "coulomb",
    ]


def test_a_urdf_stays_beside_its_model_file(tmp_path: Path) -> None:
    for name in ("wam7.toml", "wam7.urdf"):
        (tmp_path / name).write_text((MODELS / name).read_text())
    put_into(
        Result("x", "x", "wam7", effects=[FoundEffect("coulomb", 7, {"level": Estimate(0.1)})]),
        tmp_path / "wam7.toml",
    )
    assert 'file = "wam7.urdf"' in (tmp_path / "wam7.toml").read_text()
    assert load_model(tmp_path / "wam7.toml").terms[-1].joint == 7


def test_what_cannot_go_into_a_model_is_refused(tmp_path: Path) -> None:
    model = tmp_path / "imi.toml"
    model.write_text((MODELS / "imi_planar.toml").read_text())
    with pytest.raises(ModelError, match="nothing that a model file holds"):
        put_into(Result("circle", "Circle", "imi_planar"), model)
    before = model.read_text()
    for machine, joints in (("wam7", 7), ("pendulum", 1)):
        with pytest.raises(
            ModelError, match=rf"has 2 joints and {machine}, which was measured, {joints}"
        ):
            put_into(
                Result(
                    "x", "x", machine, effects=[FoundEffect("coulomb", 1, {"level": Estimate(1.0)})]
                ),
                model,
            )
    assert model.read_text() == before and not list(tmp_path.glob("*.new"))


def test_what_can_go_into_a_model_is_checked_before_the_machine_moves() -> None:
    assert fit_model(list(EXPERIMENTS), MODELS / "imi_planar.toml") == ["friction-curve"]
    assert fit_model(list(EXPERIMENTS), MODELS / "wam7.toml") == ["friction"]
    with pytest.raises(
        ModelError,
        match=r"finds nothing .* friction, friction-curve, mechanical do",
    ):
        fit_model(["circle"], MODELS / "imi_planar.toml")
    with pytest.raises(ModelError, match="has 2 joints and pendulum, which was measured, 1"):
        fit_model(["mechanical"], MODELS / "imi_planar.toml")


def test_the_report_asks_for_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="lacks breakaway"):
        write_report(tmp_path, tmp_path / "results.md")
    assert table(["a", "b"], [["1", "2"]]).splitlines() == ["| a | b |", "|---|---|", "| 1 | 2 |"]


def test_the_prose_of_the_report_is_wrapped_and_its_tables_are_not() -> None:
    long, row = "word " * 40 + "end", "| " + "cell " * 40 + "|"
    page = wrapped(f"{long}\n- {long}\n{row}").split("\n")
    assert page[-1] == row and all(len(line) <= 100 for line in page[:-1])
    first = next(i for i, line in enumerate(page) if line.startswith("- "))
    assert all(line.startswith("  ") for line in page[first + 1 : -1])
    assert " ".join(page[:first]) == long


def test_the_command_lists_every_experiment() -> None:
    shown = CliRunner().invoke(command, [])
    assert shown.exit_code == 0 and all(name in shown.output for name in EXPERIMENTS)


def test_ctrl_c_names_a_folder_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(name: str, lab: Lab) -> None:
        (lab.folder / "breakaway").mkdir(parents=True)  # another's, which this one begins with
        raise KeyboardInterrupt

    monkeypatch.setattr("zendsp.experiment.run_experiment", interrupted)
    shown = CliRunner().invoke(command, ["friction-curve", "--out", str(tmp_path / "runs")])
    assert f"what was recorded is in {tmp_path / 'runs'}; the simulated" in shown.output
