"""Reports are read as the contract says, and the command is run as a user would."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from known import truth

from zendsp.proof.answer import Answer, ContractError, Estimate, Smallest, read_report
from zendsp.proof.judge import judge
from zendsp.proof.score import answers, diagnose
from zendsp.proof.scoreboard import (
    failures,
)

REPORT = {
    "verdict": "missing",
    "findings": [
        {
            "effect": "coulomb",
            "joint": 1,
            "parameters": {"level": {"value": 0.05, "std": 0.001, "unit": "N m"}},
            "confidence": 0.99,
            "share": 0.8,
            "indistinguishable": ["stribeck"],
            "replaces": ["viscous"],
            "sentence": "",
        }
    ],
    "where": {
        "time": [[3.1, 3.4]],
        "state": [
            {
                "joint": 1,
                "variable": "velocity",
                "interval": [-0.05, 0.05],
                "share": 0.7,
                "time_share": 0.1,
            }
        ],
    },
    "fit": {
        "quantity": "position",
        "unit": "rad",
        "estimation": {},
        "heldout": {"given": 3.0, "calibrated": 2.0, "improved": 1.0},
        "noise_floor": 0.9,
    },
}


def test_report_of_the_contract_is_read(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text(json.dumps(REPORT))
    answer = read_report(path, 1.5)
    assert answer.findings[0].parameters["level"] == Estimate(0.05, 0.001)
    assert answer.findings[0].indistinguishable == ("stribeck",) and answer.times == ((3.1, 3.4),)
    known = replace(answer, cpu=1.2, untouched=(2.0, 1.0), smallest=(Smallest(1, "coulomb", 0.01),))
    assert Answer.from_json(json.loads(json.dumps(known.to_json()))) == known


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"verdict": "maybe"}, "verdict is 'maybe'"),
        ({"verdict": "complete"}, "complete but there are findings"),
        ({"findings": []}, "missing but there is no finding"),
        ({"fit": {"noise_floor": 1.0}}, "no 'heldout'"),
    ],
)
def test_report_against_the_contract_is_refused_by_name(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    path = tmp_path / "report.json"
    path.write_text(json.dumps({**REPORT, **change}))
    with pytest.raises(ContractError, match=words):
        read_report(path, 0.0)


def case_folder(root: Path) -> Path:
    folder = root / "case_0001"
    folder.mkdir(parents=True)
    (folder / "case.json").write_text(
        json.dumps({"train": ["a.csv"], "heldout": ["b.csv"], "model": "model.toml"})
    )
    return folder


def stand_in(tmp_path: Path, body: str) -> tuple[str, ...]:
    """A command with the contract's options, whose behaviour `body` says."""
    script = tmp_path / "stand_in.py"
    script.write_text(
        "import json, pathlib, sys\nout = pathlib.Path(sys.argv[sys.argv.index('--out') + 1])\n"
        + body
    )
    return (sys.executable, str(script))


def test_command_is_run_as_a_process_and_its_report_read(tmp_path: Path) -> None:
    command = stand_in(
        tmp_path, f"(out / 'report.json').write_text({json.dumps(json.dumps(REPORT))})\n"
    )
    answer = diagnose(case_folder(tmp_path / "cases"), tmp_path / "out", 30.0, command=command)
    assert answer.trouble == "" and answer.verdict == "missing" and answer.seconds > 0


def test_command_that_fails_or_hangs_is_a_failure_not_a_crash(tmp_path: Path) -> None:
    folder = case_folder(tmp_path / "cases")
    failed = diagnose(
        folder, tmp_path / "o1", 30.0, command=stand_in(tmp_path, "sys.exit('no such column')\n")
    )
    assert "exit status 1: no such column" in failed.trouble
    hung = diagnose(
        folder, tmp_path / "o2", 0.5, command=stand_in(tmp_path, "import time; time.sleep(60)\n")
    )
    assert "no answer within" in hung.trouble
    j = judge(truth([], kind="complete", verdict="complete"), failed)
    assert failures([j])


def test_interrupted_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    asked: list[str] = []

    def ask(folder: Path, out: Path, limit: float) -> Answer:
        asked.append(folder.name)
        return Answer("complete", seconds=1.0)

    folders = [tmp_path / f"case_{k:04d}" for k in range(1, 5)]
    first = dict(answers(folders[:2], tmp_path / "r.json", 1, 1.0, ask))
    with (tmp_path / "r.jsonl").open("a") as log:
        log.write('{"case": "case_0003", "ans')  # cut short by a power failure
    second = dict(answers(folders, tmp_path / "r.json", 1, 1.0, ask))
    assert set(first) == {"case_0001", "case_0002"} and set(second) == {f.name for f in folders}
    assert sorted(asked) == [f.name for f in folders]  # none twice


def test_answers_of_other_code_are_asked_again(tmp_path: Path) -> None:
    asked: list[str] = []

    def ask(folder: Path, out: Path, limit: float) -> Answer:
        asked.append(folder.name)
        return Answer("complete", seconds=1.0)

    for code in ("old", "old", "new"):
        dict(answers([tmp_path / "case_0001"], tmp_path / "r.json", 1, 1.0, ask, code))
    assert len(asked) == 2
