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


@pytest.mark.parametrize(("out", "lost"), [("was", True), ("report", False)])
def test_a_report_never_replaces_the_file_that_its_model_names(
    out: str, lost: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    typed: Callable[..., tuple[object, str, str]],
) -> None:
    (tmp_path / "was").mkdir()  # the folder of an earlier report
    (tmp_path / "was" / "model.mjcf").write_text(TEXT)
    (tmp_path / "arm.toml").write_text('[mechanism]\nkind = "mjcf"\nfile = "was/model.mjcf"\n')
    (tmp_path / "run.csv").write_text("")
    monkeypatch.chdir(tmp_path)
    status, _, said = typed("diagnose", "run.csv", "--model", "arm.toml", "--out", out)
    assert status == 2
    assert ("model.mjcf would replace was/model.mjcf" in said) == lost, said
    assert (tmp_path / "was" / "model.mjcf").read_text() == TEXT
