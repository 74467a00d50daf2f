"""What the report folder does to files that were there before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

TEXT = "# my model, and all that I know of the machine\n"


@pytest.mark.parametrize(
    ("out", "each", "lost"),
    [
        (".", False, True), ("report", False, False), (".", True, False), ("..", True, True),
        ("report/..", False, True),
    ],
)
def test_a_report_never_replaces_what_it_is_made_from(
    out: str, each: bool, lost: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    typed: Callable[..., tuple[object, str, str]],
) -> None:
    here = tmp_path / "run"  # as a folder of --each for run.csv
    here.mkdir()
    (here / "model.toml").write_text(TEXT)
    (here / "run.csv").write_text("")
    monkeypatch.chdir(here)
    words = ["run.csv", "--model", "model.toml", "--out", out, *["--each"] * each]
    status, _, said = typed("diagnose", *words)
    assert status == 2
    assert ("would replace model.toml" in said) == lost, said
    assert (here / "model.toml").read_text() == TEXT
