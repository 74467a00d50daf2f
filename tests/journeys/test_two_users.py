"""Two users of one target: each sees what the other does, one commands, both may stop."""

from __future__ import annotations

import subprocess

import pytest
from journey import PATIENCE_S, Installed, until

ANNA = r"""
import sys, zendsp
t = zendsp.connect('imi')
t.download('pd.c'); t.start()
for line in sys.stdin:
    try:
        print(repr(eval(line)), flush=True)
    except Exception as error:
        print(f"{type(error).__name__}: {error}", flush=True)
"""


class Anna:
    """A user in an interactive Python that stays open."""

    def __init__(self, installed: Installed) -> None:
        self._process = subprocess.Popen(
            [str(installed.python), "-c", ANNA], cwd=installed.folder, env=installed.env, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def types(self, line: str) -> str:
        """Evaluate an expression in which `t` is the target; what it shows."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return self._process.stdout.readline().strip()

    def leaves(self) -> None:
        """End Python."""
        self._process.communicate(timeout=PATIENCE_S)


@pytest.fixture
def anna(installed: Installed) -> Anna:
    installed.target("imi")
    user = Anna(installed)
    assert user.types("t.status().state") == "'running'"
    return user


def test_the_commander_moves_the_machine_and_the_other_user_watches(
    installed: Installed, anna: Anna
) -> None:
    anna.types("t.take_command()")
    name = anna.types("t.drive_status().commander").strip("'")
    assert name
    for command in (
        ("set", "Kp1=90"),
        ("pause",),
        ("run", "pd.c"),
        ("drive", "off"),
        ("drive", "take"),
    ):
        said = installed.run(*command)
        assert said.returncode != 0 and name in said.stderr, (command, said.stdout, said.stderr)
    assert anna.types("t['Kp1']") != "90.0" and anna.types("t.status().state") == "'running'"
    looked = (
        ("get", "Kp1"),
        ("info",),
        ("drive",),
        ("acquire", "q", "--seconds", "0.1", "--out", "b.csv"),
    )
    for command in looked:
        said = installed.run(*command)
        assert said.returncode == 0, (command, said.stderr)
    assert name in installed.run("drive").stdout
    anna.types("t.release_command()")
    assert installed.run("set", "Kp1=90").returncode == 0
    assert anna.types("t['Kp1']") == "90.0"
    anna.leaves()


def test_both_may_stop_and_both_are_told(installed: Installed, anna: Anna) -> None:
    anna.types("t.take_command()")
    said = installed.run("stop")
    assert said.returncode == 0 and "stopped, at sample" in said.stdout
    assert anna.types("t.status().trip.reason") == "'stop'"
    assert anna.types("t.start()").startswith("Refused: ")
    anna.types("t.acknowledge()")
    assert anna.types("t.start()") == "None"
    anna.leaves()


def test_the_log_tells_them_apart_and_a_recorder_in_use_is_refused(
    installed: Installed, anna: Anna
) -> None:
    anna.types("t.update(Kp1=91.0)")
    assert installed.run("set", "Kp1=92").returncode == 0
    changes = anna.types("[(c.new, c.author) for c in t.log() if c.name == 'Kp1']")
    (first, hers), (second, his) = eval(changes)
    assert (first, second) == (91.0, 92.0) and hers != his, changes
    anna.types("t.acquire_configure(['q'], seconds=60.0)")
    anna.types("t.acquire_start()")
    said = installed.run("acquire", "q", "--seconds", "0.1", "--out", "c.csv")
    assert said.returncode != 0 and hers in said.stderr, said.stderr
    assert anna.types("t.acquire_status().state") == "'running'"
    anna.leaves()


def test_a_user_who_leaves_while_commanding_leaves_a_machine_that_stands(
    installed: Installed, anna: Anna
) -> None:
    anna.types("t.take_command()")
    anna.leaves()
    gone = "the host that commanded the motion is gone"
    until(lambda: gone in installed.run("get", "Kp1").stderr, "others are told that she is gone")
    assert installed.run("drive", "acknowledge").returncode == 0
    assert installed.run("run", "pd.c").returncode == 0, "and another goes on"


def test_a_run_that_is_refused_stops_nothing_of_who_commands(
    installed: Installed, anna: Anna
) -> None:
    anna.types("t.take_command()")
    name = anna.types("t.drive_status().commander").strip("'")
    anna.types("t.acquire_configure(['q'], 60.0)")
    anna.types("t.acquire_start()")
    for command in (
        ("experiment", "friction", "-t", "imi"),
        ("bode",),
        ("sweep", "Kp1=90,100", "-c", "q", "-s", "1"),
    ):
        said = installed.run(*command)
        assert said.returncode == 2 and name in said.stderr, (command, said.stdout, said.stderr)
        assert "not put back" not in said.stdout + said.stderr, (command, said)
        assert anna.types("t.status().trip") == "None", command
        assert anna.types("t.status().state") == "'running'", command
        assert anna.types("t.acquire_status().state") == "'running'", command
    run = installed.script(
        "import zendsp\n"
        "from zendsp.link.put_back import Before\n"
        "Before(zendsp.connect('imi'), ['Kp1'], moves=True)\n"
    )
    assert name in run.stderr and anna.types("t.drive_status().moved_by") == "''", run.stderr
    anna.leaves()
