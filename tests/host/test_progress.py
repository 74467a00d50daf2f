"""What a terminal shows while a command works."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from zendsp.cli import progress


def test_a_stage_says_how_long_it_has_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A swing was planned for half a minute under a spinner that said nothing."""
    now = 10.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    stage = progress.Timed("planning")

    def shown() -> str:
        console = Console(file=io.StringIO(), width=60)
        with console.capture() as seen:
            console.print(stage)
        return seen.get().strip()

    assert shown() == "planning"
    now = 17.4
    assert shown() == "planning  7 s"
