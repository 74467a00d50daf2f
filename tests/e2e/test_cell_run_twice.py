"""What a prompt says of the targets that it started before."""

from __future__ import annotations

import subprocess
import sys

from waiting import PATIENCE_S

CELLS = """
import sys, zendsp
sys.ps1 = ">>> "
shown = target = zendsp.local("pendulum", clock="fast")
target = zendsp.local("pendulum", clock="fast")
shown.close()
target = zendsp.local("pendulum", clock="fast", name="third")
"""


def test_a_cell_that_is_run_again_says_that_its_first_target_still_runs() -> None:
    """A notebook refers to what it has shown: the first target moved on, unmentioned."""
    done = subprocess.run(
        [sys.executable, "-c", CELLS], capture_output=True, text=True, timeout=PATIENCE_S
    )
    said = [line for line in done.stderr.splitlines() if "still runs" in line]
    first, second = (line.split(",")[0].removeprefix("zendsp: ") for line in said)
    assert first.startswith("pendulum-") and second.startswith("pendulum-") and first != second
    assert said[0].endswith(f"its close() ends it, and 'zendsp stop -t {first}' stops its machine")
