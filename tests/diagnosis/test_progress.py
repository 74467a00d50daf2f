"""What a diagnosis says of its progress."""

from __future__ import annotations

import ast
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import zendsp.diagnosis
from zendsp.cli.steps import ANEW, STEPS, in_steps, step_of
from zendsp.diagnosis import joints

ANY_STEP = "1 (1 simulations)"  # of a simulator: how often it was called until now


def sentences() -> list[str]:
    """Every sentence that the code of the diagnosis tells, with 1 in the place of what varies."""
    found = []
    for path in sorted(Path(zendsp.diagnosis.__path__[0]).rglob("*.py")):
        if path.name == "fleet.py":  # tells of whole diagnoses
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Call) and node.args):
                continue
            if ast.unparse(node.func).rpartition(".")[2] not in ("tell", "progress"):
                continue
            said = node.args[0]
            parts = said.values if isinstance(said, ast.JoinedStr) else [said]
            if not isinstance(said, ast.JoinedStr | ast.Constant):
                continue
            found.append(
                "".join(str(p.value) if isinstance(p, ast.Constant) else "1" for p in parts)
            )
    return found


def test_every_sentence_belongs_to_a_step() -> None:
    told = sentences()
    assert len(told) > 20 and ANY_STEP in told
    assert [words for words in told if not step_of(words) and words != ANY_STEP] == []
    assert {step_of(words) for words in [*told, "writing the report"]} >= {*range(1, len(STEPS))}


def test_a_progress_only_goes_forward() -> None:
    said: list[str] = []
    tell = in_steps(said.append)
    for words in (
        "reading the recordings", "joint 1: calibrating the given model",
        "joint 2: screening the library", "joint 1: calibrating the given model",
        "once more, without what was pushed", "joint 1: fitting 8 hypotheses", "1 (5 simulations)",
        "drawing the figures", f"{ANEW[1:]} on imi", "calibrating the given model",
    ):
        tell(words)
    steps = [int(line.partition("/")[0]) for line in said]
    assert steps == [1, 2, 3, 3, 4, 4, 4, 6, 1, 2]
    assert said[5] == "4/6 assembling: joint 1: fitting 8 hypotheses"


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
