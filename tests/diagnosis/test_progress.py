"""The progress of a diagnosis, and what remains of one that is interrupted."""

from __future__ import annotations

import os
import pickle
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
import tomli_w
from click.testing import CliRunner
from reality import RATE
from waiting import status_of

from zendsp.cli import cli
from zendsp.cli.steps import in_steps
from zendsp.diagnosis import diagnose, engine
from zendsp.diagnosis.explain import joints
from zendsp.diagnosis.progress import Progress, Step


def test_progress_only_goes_forward() -> None:
    said: list[str] = []
    tell = in_steps(said.append)
    for step in (1, 2, 3, 2, 4, 3, 6, 0, 2):
        # as from the process of a joint
        tell(pickle.loads(pickle.dumps(Step(step).says("joint 1: fitting 8 hypotheses"))))
    steps = [int(line.partition("/")[0]) for line in said]
    assert steps == [1, 2, 3, 3, 4, 4, 6, 1, 2]
    assert said[4] == "4/6 assembling: joint 1: fitting 8 hypotheses"


def test_an_interrupt_waits_for_no_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after ``kill -INT`` of the process alone, which its children do not receive."""

    def endless(*given: Any) -> None:
        given[-1]("searching")
        time.sleep(60.0)

    def interrupted(_: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(joints, "explain_joint", endless)
    arm: Any = SimpleNamespace(joints=2)
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        joints._search(SimpleNamespace(), arm, arm, 2, interrupted, {})  # type: ignore[arg-type]
    assert time.monotonic() - begin < 30.0


def _two_joints(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The first lacks dry friction, the second is complete."""
    made = [
        reality.simulate(reality.Machine(coulomb=level), reality.multisine(8.0, RATE, 1), RATE)
        for level in (0.03, 0.0)
    ]
    columns = {"t": made[0]["t"]}
    for k, one in enumerate(made, 1):
        columns |= {f"q{k}": one["q"], f"u{k}": one["u"]}
    run = reality.save(folder / "run.csv", columns)
    model = {
        "sample_time": 1.0 / RATE,
        "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": [0.01, 0.01]}}},
        "effect": [{"kind": "viscous", "joint": k, "coefficient": 0.004} for k in (1, 2)],
        "sensor": {"position_resolution": reality.RESOLUTION},
        "columns": {"time": "t", "position": ["q1", "q2"], "command": ["u1", "u2"]},
    }
    return run, model


def test_ctrl_c_keeps_what_was_found_of_the_joints_that_were_finished(tmp_path: Path) -> None:
    run, model = _two_joints(tmp_path)
    pressed = []

    def press(text: str) -> None:
        if text.startswith("joint 2: ") and not pressed:
            pressed.append(text)
            raise KeyboardInterrupt

    said: list[str] = []

    def listen(text: str) -> None:
        said.append(text)
        press(text)

    with pytest.raises(KeyboardInterrupt):
        diagnose(run, model, jobs=1, progress=listen)
    assert "joint 1 is done, by itself: coulomb seems to be missing" in said
    pressed.clear()
    d = diagnose(run, model, jobs=1, progress=press, so_far=True)
    assert [(f.effect, f.joint) for f in d.findings] == [("coulomb", 1)]
    assert d.headline.startswith("So far, interrupted: Missing physics: dry friction")
    assert "Joint 2: it was not searched before the interrupt" in d.unexplained
    assert d.stopped and not d.detectable and d.next_recording is None
    assert str(d).startswith("verdict: missing, so far, interrupted\n")


def test_ctrl_c_after_the_search_keeps_all_that_was_found(tmp_path: Path) -> None:
    run, model = _two_joints(tmp_path)
    pressed = []

    def press(text: str) -> None:
        if text == "asking what could have been seen":
            pressed.append(text)
            raise KeyboardInterrupt

    d = diagnose(run, model, jobs=1, progress=press, so_far=True)
    assert pressed and d.stopped
    assert [(f.effect, f.joint) for f in d.findings] == [("coulomb", 1)]
    assert not d.unexplained and not d.detectable and d.next_recording is None
    assert "when all joints had been searched" in d.notes[0]
    assert d.headline.startswith("So far, interrupted: Missing physics: dry friction")
    with pytest.raises(KeyboardInterrupt):
        diagnose(run, model, jobs=1, progress=press)


@pytest.mark.parametrize(
    ("step", "says"),
    [
        (Step.SEARCHING, "no report is written; it was at 3/6 searching"),
        (Step.REPORTING, "it was at 6/6 reporting"),
    ],
)
def test_an_interrupted_diagnosis_says_how_far_it_was(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, step: Step, says: str
) -> None:
    """It says so by its step, so that no wording decides whether there is a report."""

    def interrupted(*_: Any, progress: Progress, **__: Any) -> None:
        progress(Step.READING.says("reading run.csv"))
        progress(step.says("6/6 reporting"))
        raise KeyboardInterrupt

    monkeypatch.setattr("zendsp.diagnosis.diagnose", interrupted)
    asked = ["diagnose", "run.csv", "--model", "arm.toml", "--out", str(tmp_path / "report")]
    done = CliRunner().invoke(cli, asked)
    assert done.exit_code != 0 and not (tmp_path / "report" / "report.json").exists()
    assert done.stderr.splitlines()[0] == f"{says}: 6/6 reporting"


def test_a_report_whose_pictures_are_interrupted_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupted(_: Any, out: Path, *__: Any) -> None:
        out.mkdir(exist_ok=True)
        (out / "report.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr("zendsp.diagnosis.diagnose", lambda *_, **__: SimpleNamespace())
    monkeypatch.setattr("zendsp.cli.diagnose._write", interrupted)
    out = tmp_path / "report"
    asked = ["diagnose", "run.csv", "--model", "arm.toml", "--out", str(out)]
    done = CliRunner().invoke(cli, asked)
    assert done.exit_code != 0
    said = f"{out / 'report.json'} is written, without pictures; it was at 6/6"
    assert said in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_diagnosis_that_is_ended_by_a_signal_says_so(tmp_path: Path, number: int) -> None:
    """A scheduler's SIGTERM, or a terminal that was closed, had ended it without a word."""
    run, model = _two_joints(tmp_path)
    (tmp_path / "m.toml").write_text(tomli_w.dumps(model))
    words = ["zendsp", "diagnose", str(run), "--model", "m.toml", "--jobs", "2"]
    code = f"import sys; sys.argv = {words}; from zendsp.__main__ import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        env={**os.environ, "ZENDSP_PROGRESS": "lines"},
    ) as process:  # fmt: skip
        assert process.stderr is not None
        next(line for line in process.stderr if line.startswith("1/6"))
        process.send_signal(number)  # before a joint is done, of which there would be a report
        said = process.stderr.read()
    assert status_of(process.returncode) == 128 + number, said
    assert said.endswith(f"ended by {signal.Signals(number).name}\n"), said
    assert re.search("it was at [123]/6", said) and "Traceback" not in said


def test_a_recording_that_takes_long_is_told_before_the_search() -> None:
    run: Any = SimpleNamespace(
        time=np.arange(4), sample_time=600.0, position=np.zeros((4, 1)), whole="", name="long.csv"
    )
    with pytest.warns(UserWarning, match=r"2400 s .* 'zendsp cut long.csv --to 300 -o part.csv'"):
        engine._warn_of_length([run])
    run.sample_time = 400.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        engine._warn_of_length([run])
