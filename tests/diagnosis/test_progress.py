"""What a diagnosis says of its progress."""

from __future__ import annotations

import pickle
import time
from types import SimpleNamespace
from typing import Any

import pytest

from zendsp.cli.steps import in_steps
from zendsp.diagnosis import joints
from zendsp.diagnosis.progress import Step


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
