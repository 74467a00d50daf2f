"""A round or two of each hardship of `benchmarks/endurance.py`, and what its command promises."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed, until

ENDURANCE = Path(__file__).parents[2] / "benchmarks" / "endurance.py"
ROUNDS = {"messages": 2, "links": 1, "kills": 1, "signals": 2, "bombs": 2, "views": 1, "starts": 2}
BROKEN = """
import sys
sys.path.insert(0, {folder!r})
import endurance

class Untrue:
    PROMISE = "what is promised"
    def rounds(place, tally):
        while True:
            tally.count("rounds")
            tally.expect({holds}, "one and one is three")
            yield

sys.exit(endurance.main(["--rounds", "2", "--json", "found.json"], {{"untrue": Untrue}}))
"""


@pytest.mark.long("tests/e2e and tests/target have each hardship; lost: one after the other")
@pytest.mark.parametrize("part", ROUNDS)
def test_each_hardship_of_the_endurance_run_holds(installed: Installed, part: str) -> None:
    process = installed.start(
        "python", ENDURANCE, "--only", part, "--rounds", str(ROUNDS[part]), "--json", "found.json"
    )
    said, _ = process.communicate(timeout=2 * PATIENCE_S)
    assert process.returncode == 0, said
    (found,) = json.loads((installed.folder / "found.json").read_text())["parts"]
    assert found["rounds"] == ROUNDS[part] and found["violations"] == 0 and found["found"], said


def test_every_part_of_the_endurance_run_is_listed(installed: Installed) -> None:
    said, _ = installed.start("python", ENDURANCE, "--list").communicate(timeout=PATIENCE_S)
    assert [line.split()[0] for line in said.splitlines()] == list(ROUNDS)


@pytest.mark.parametrize(("holds", "status"), [("1 + 1 == 2", 0), ("1 + 1 == 3", 1), ("1 / 0", 1)])
def test_a_violated_promise_is_told_and_counted(
    installed: Installed, holds: str, status: int
) -> None:
    done = installed.script(BROKEN.format(folder=str(ENDURANCE.parent), holds=holds))
    assert done.returncode == status, done.stdout + done.stderr
    (part,) = json.loads((installed.folder / "found.json").read_text())["parts"]
    assert bool(part["violations"]) == bool(status)
    assert ("VIOLATED" in done.stdout) == bool(status)


def test_ctrl_c_ends_it_with_all_that_it_started(installed: Installed) -> None:
    process = installed.start("python", ENDURANCE, "--only", "views", "--minutes", "5")
    started: set[int] = set()

    def below(pid: int) -> set[int]:
        paths = Path(f"/proc/{pid}/task").glob("*/children")
        own = {int(word) for path in paths for word in path.read_text().split()}
        return own | {pid for child in own for pid in below(child)}

    def a_runner_runs() -> bool:
        started.update(below(process.pid))
        return any("/runner/" in _command(pid) for pid in started)

    until(a_runner_runs, "a target with its runner", alive=process)
    os.kill(process.pid, signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, said
    assert re.search(r"ended by Ctrl-C after 0 of 1", said), said
    until(lambda: not any(_command(pid) for pid in started), "all that it started has ended")


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""
