"""Benchmarks run, and say to somebody who has not installed what they need what that is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from waiting import PATIENCE_S

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
FORMS = BENCHMARKS / "forms.py"
LACKING = """
import sys

class Lacking:
    def find_spec(self, name, path=None, target=None):
        if name in ("pinocchio", "fmpy", "mujoco"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Lacking())
"""


def test_the_arms_of_a_benchmark_name_the_package_they_lack_and_help_needs_none(
    tmp_path: Path,
) -> None:
    (tmp_path / "sitecustomize.py").write_text(LACKING)
    lacking = os.environ | {"PYTHONPATH": str(tmp_path)}
    told = [
        subprocess.run(
            [sys.executable, str(FORMS), word], env=lacking, capture_output=True, text=True,
            timeout=PATIENCE_S, check=False,
        )
        for word in ("--help", str(tmp_path))
    ]  # fmt: skip
    assert told[0].returncode == 0 and "--group" in told[0].stdout
    assert told[1].returncode == 1
    assert told[1].stderr == "pinocchio is missing: pip install 'zendsp[mujoco,fmpy]' pin\n"


def test_copies_of_an_experiment_are_counted(tmp_path: Path) -> None:
    """Its bench had no longer taken what an experiment gives one, and no test knew."""
    page = tmp_path / "counted.md"
    asked = ["--seeds", "2", "--only", "mechanical", "--page", str(page)]
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "experiments.py"), *asked], capture_output=True,
        text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "2 repetitions" in page.read_text() and "| theta1 |" in page.read_text()
