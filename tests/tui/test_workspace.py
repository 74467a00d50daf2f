"""What the terminal finds in its folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from zendsp.tui import workspace
from zendsp.tui.screens.analysis import models_for


def test_the_newest_references_are_listed_where_there_are_more_than_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workspace, "MOST", 3)
    monkeypatch.setattr(workspace, "is_reference", lambda path: path.stem != "table")
    (tmp_path / "below").mkdir()
    # newest last, and last found too: the folders below come after the folder itself
    names = ["a.mat", "b.mat", "c.mat", "d.mat", "below/e.mat", "below/table.mat"]
    for age, name in enumerate(names):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    found = workspace.Workspace(tmp_path).saved_references()
    assert [p.stem for p in found] == ["e", "d"]  # of the three newest files, one is no reference


def test_a_model_that_is_taken_by_itself_is_one_that_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text("name = 'arm'\n[mechanism\n")  # cut off
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'arm'\n")  # no model
    (tmp_path / "rig.toml").write_text("name = 'arm'\n[mechanism]\nkind = 'rotary'\n")
    (tmp_path / "rotor.toml").write_text("name = 'rotor'\n[mechanism]\nkind = 'rotary'\n")
    space = workspace.Workspace(tmp_path)
    assert [p.name for p in models_for("arm", space)] == ["rig.toml", "rotor.toml", "arm.toml"]
    assert [p.name for p in models_for("", space)] == ["rig.toml", "rotor.toml", "arm.toml"]


def test_programs_come_before_what_they_include_the_nearest_and_newest_first(
    tmp_path: Path,
) -> None:
    program, part = "void UserISR_INT2(void) {\n}\n", "/* UserISR_INT2: tau += C(q); */\n"
    texts = {
        "a/pd.c": program, "old.c": program, "new.c": program, "compensation.c": part,
        "a/compensation.c": part, ".hidden/pd.c": program,
    }  # fmt: skip
    for age, (name, text) in enumerate(texts.items()):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    programs, parts = workspace.Workspace(tmp_path).sources()
    assert [str(p.relative_to(tmp_path)) for p in programs] == ["new.c", "old.c", "a/pd.c"]
    assert [str(p.relative_to(tmp_path)) for p in parts] == ["compensation.c", "a/compensation.c"]


def test_recordings_are_listed_without_references_and_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workspace, "is_reference", lambda path: path.stem == "circle")
    names = ["run.mat", "circle.mat", "notes.txt", "pd.c", "lab/day.csv.gz", ".git/index.csv"]
    for age, name in enumerate(names):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    found = workspace.Workspace(tmp_path).recordings()
    assert [p.name for p in found] == ["day.csv.gz", "run.mat"]
