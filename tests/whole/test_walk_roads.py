"""The script that measures the roads of the code overview."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_roads_of_a_tree_are_walked_whatever_is_installed(tmp_path: Path) -> None:
    """In a clone beside another installation every count was 0."""
    for room in ("host", "target", "protocol", "c_isr", "tests"):
        (tmp_path / room).symlink_to(ROOT / room)
    script = tmp_path / "docs" / "walk_roads.py"
    script.parent.mkdir()
    script.write_bytes((ROOT / "docs" / "walk_roads.py").read_bytes())
    ran = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, check=True
    )
    roads = re.findall(r"^\| (a \w+) \| (\d+) \|", ran.stdout, re.MULTILINE)
    assert [road for road, _ in roads] == ["a diagnosis", "a write"], ran.stdout
    assert all(int(functions) > 20 for _, functions in roads), ran.stdout
