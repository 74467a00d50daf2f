"""The proof as a lab runs it: cases are made, judged where they lie, and nothing goes on when it is
ended.
"""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from journey import Installed, until

pytest.importorskip("mujoco")


@pytest.mark.long(".ci/run makes and judges four; tests/proof/test_prove.py each of the two alone")
def test_cases_are_made_once_and_judged_where_they_lie(installed: Installed) -> None:
    made = installed.run(
        "prove", "--make", "cases", "--quick", "--reality", "mujoco", "--sample", "1", "--seed", "7"
    )
    assert made.returncode == 0, made.stdout + made.stderr
    assert "1 cases in cases/cases; truth sealed in cases/truth" in made.stdout
    stamp = made.stdout.split()[-1]
    judged = installed.run("prove", "--judge", "cases", "--jobs", "1", "--limit", "100")
    assert f"truth sealed before, opened after: {stamp}" in judged.stdout, (
        judged.stdout + judged.stderr
    )
    assert "zendsp: 1 cases" in judged.stdout and "FROLS: 1 cases" in judged.stdout
    results = json.loads((installed.folder / "cases" / "results.json").read_text())
    assert [c["reality"] for c in results["cases"]] == ["mujoco"]
    assert results["cases"][0]["cpu"] > 0


def test_missing_cases_are_reported_with_what_to_do(installed: Installed) -> None:
    absent = installed.run("prove", "--judge", "nowhere")
    assert absent.returncode != 0 and "make them with zendsp prove --make nowhere" in absent.stderr
    other = installed.run("prove", "--reality", "gazebo")
    assert (
        other.returncode == 2
        and "no reality 'gazebo'; known are own, machines, mujoco" in other.stderr
    )


@pytest.mark.long("tests/proof/test_children.py ends and kills makers; lost: by the command")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_making_cases_ends_when_its_command_is_killed(
    installed: Installed, how: signal.Signals
) -> None:
    making = installed.start(
        "zendsp", "prove", "--make", "many", "--reality", "mujoco", "--sample", "40", "--jobs", "2"
    )
    until(lambda: len(children_of(making.pid)) >= 2, "two cases in the making", alive=making)
    children = children_of(making.pid)
    making.send_signal(how)
    until(lambda: making.poll() is not None and not any(map(alive, children)), "all of it ended")


def children_of(pid: int) -> list[int]:
    """Process ids of the children of a process."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            if int(stat.read_text().rsplit(")", 1)[1].split()[1]) == pid:
                found.append(int(stat.parent.name))
        except (OSError, ProcessLookupError):
            continue
    return found


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (OSError, ProcessLookupError):
        return False
