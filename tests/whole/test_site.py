"""The site is built from docs/ without a warning, with every page."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("material")
ROOT = Path(__file__).parents[2]


def _build(tree: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tree / "site")],
        cwd=tree,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what the site is made of."""
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    return tmp_path


def test_the_site_has_every_page_and_no_link_is_broken(tree: Path) -> None:
    done = _build(tree)
    assert done.returncode == 0, done.stderr
    pages = [p for p in (tree / "docs").rglob("*.md") if p.name not in ("index.md", "README.md")]
    made = [tree / "site" / p.relative_to(tree / "docs").with_suffix("") for p in pages]
    assert len(made) > 25 and all((p / "index.html").is_file() for p in made)
    text = (tree / "site" / "tui" / "index.html").read_text()
    assert "fonts.googleapis" not in text, "nothing is fetched from elsewhere"
    api = (tree / "site" / "api" / "index.html").read_text()
    assert 'id="zendsp.link.programs.Programs.download"' in api, "made from the docstrings"


@pytest.mark.long("who writes pages builds the site; lost: that --strict notices these two")
def test_a_page_that_the_nav_lacks_or_a_broken_link_is_noticed(tree: Path) -> None:
    (tree / "docs" / "api.md").write_text("# API\n")  # made once, by the test above
    (tree / "docs" / "forgotten.md").write_text("# Forgotten\n\n[gone](gone.md)\n")
    done = _build(tree)
    assert done.returncode != 0
    assert "forgotten.md" in done.stderr and "gone.md" in done.stderr
