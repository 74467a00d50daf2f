"""What a diagnosis says of its progress."""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from zendsp.cli import cli
from zendsp.cli.steps import in_steps
from zendsp.diagnosis import joints
from zendsp.diagnosis.progress import Progress, Step


def test_a_progress_only_goes_forward() -> None:
    said: list[str] = []
    tell = in_steps(said.append)
    for step in (1, 2, 3, 2, 4, 3, 6, 0, 2):
        # as from the process of a joint
        tell(pickle.loads(pickle.dumps(Step(step).says("joint 1: fitting 8 hypotheses"))))
    steps = [int(line.partition("/")[0]) for line in said]
    assert steps == [1, 2, 3, 3, 4, 4, 6, 1, 2]
    assert said[4] == "4/6 assembling: joint 1: fitting 8 hypotheses"


def test_an_interrupt_waits_for_no_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    """As ``kill -INT`` of the process alone, which its children do not get."""

    def endless(*given: Any) -> None:
        given[-1]("searching")
        time.sleep(60.0)

    def interrupted(_: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(joints, "_search_joint", endless)
    arm: Any = SimpleNamespace(joints=2)
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        joints._search(SimpleNamespace(), arm, arm, 2, interrupted, {})  # type: ignore[arg-type]
    assert time.monotonic() - begin < 30.0


@pytest.mark.parametrize(
    ("step", "says"),
    [
        (Step.SEARCHING, "no report is written; it was at 3/6 searching"),
        (Step.REPORTING, "it was at 6/6 reporting"),
    ],
)
def test_what_is_interrupted_says_how_far_it_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, step: Step, says: str
) -> None:
    """By its step: no word of a sentence decides whether there is a report."""

    def interrupted(*_: Any, progress: Progress, **__: Any) -> None:
        progress(Step.READING.says("reading run.csv"))
        progress(step.says("6/6 reporting"))
        raise KeyboardInterrupt

    monkeypatch.setattr("zendsp.diagnosis.diagnose", interrupted)
    asked = ["diagnose", "run.csv", "--model", "arm.toml", "--out", str(tmp_path / "report")]
    done = CliRunner().invoke(cli, asked)
    assert done.exit_code != 0 and not (tmp_path / "report" / "report.json").exists()
    assert done.stderr.splitlines()[0] == f"{says}: 6/6 reporting"
