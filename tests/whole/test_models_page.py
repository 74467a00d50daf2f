"""The model files that the pages print load."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from zendsp.physics import load_model

ROOT = Path(__file__).parents[2]


def _printed(page: str, folder: Path) -> Path:
    match = re.search(r"```toml\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    assert match is not None
    file = folder / "printed.toml"
    file.write_text(match[1])
    return file


def test_the_model_file_of_the_page_loads(tmp_path: Path) -> None:
    model = load_model(_printed("models.md", tmp_path))
    assert (model.kind, model.joints, model.sample_time) == ("rotary", 1, 0.001)
    assert [term.effect for term in model.terms] == ["viscous"]


def test_the_model_file_of_the_mujoco_page_loads(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    arm = ROOT / "tests" / "machines" / "models" / "bench_arm.xml"
    shutil.copy(arm, tmp_path / "arm.xml")
    model = load_model(_printed("machines_mujoco.md", tmp_path))
    assert (model.kind, model.columns["command"]) == ("mjcf", "tau")
