"""A script that ends, however, says what becomes of the machine that it set in motion."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest
from waiting import PATIENCE_S, until

import zendsp
from zendsp.link import Target

GOES_ON = "the machine moves on: 'zendsp pause' pauses it, 'zendsp stop' stops it"


@pytest.fixture
def arm() -> Iterator[Target]:
    with zendsp.local("imi_planar") as target:
        target.download("pd.c")
        yield target


def ended(arm: Target, script: str) -> str:
    """What a script that connects to the arm as `t` leaves on standard error."""
    words = f"import sys, zendsp\nt = zendsp.connect({arm.name!r})\n{script}"
    done = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, timeout=PATIENCE_S
    )
    return done.stderr


@pytest.mark.parametrize(
    "end", ["", "sys.exit(3)", "1 / 0", "raise KeyboardInterrupt", "with t: 1 / 0"]
)
def test_a_script_says_that_the_machine_moves_on(arm: Target, end: str) -> None:
    said = ended(arm, f"t.start()\n{end}")
    assert said.count(f"zendsp: {arm.name}: {GOES_ON}") == 1, said
    assert arm.status().state == "running"


@pytest.mark.parametrize(
    ("taken", "says"),
    [
        ("t.take_command(); t.start()", "it stops now"),
        ("t.start(attended=True)", "it stops now"),
        ("t.take_command(); t.set_host_lost('hold'); t.start()", "it comes to rest now and holds"),
    ],
)
def test_a_script_that_commanded_says_what_its_end_does(
    arm: Target, taken: str, says: str
) -> None:
    said = ended(arm, f"{taken}\n1 / 0")
    assert f"the machine was this script's to command: {says}" in said, said


@pytest.mark.parametrize("end", ["with t: t.take_command(); t.start()", "COMMANDS; t.close()"])
def test_a_connection_that_commanded_and_is_closed_on_purpose_says_what_that_does(
    arm: Target, end: str
) -> None:
    said = ended(arm, end.replace("COMMANDS", "t.take_command(); t.start()"))
    assert said.count("the machine was this script's to command: it stops now") == 1, said


def test_a_script_that_took_command_of_a_machine_in_motion_says_what_its_end_does(
    arm: Target,
) -> None:
    """Its orderly end latched a trip, in silence."""
    arm.start()
    said = ended(arm, "with t: t.take_command(); t.release_command()")
    assert said == "" and arm.status().state == "running"
    said = ended(arm, "with t: t.take_command()")
    assert said.count("the machine was this script's to command: it stops now") == 1, said
    until(lambda: arm.status().trip, "it has stopped")


@pytest.mark.parametrize(
    "end",
    [
        "t.start(); t.pause(); 1 / 0", "t.start(); t.stop(); 1 / 0", "t.start(); t.close()",
        "t.status()", "u = zendsp.local('pendulum'); u.download('template.c'); u.start()",
    ],
)
def test_nothing_is_said_where_nothing_of_the_script_moves_on(arm: Target, end: str) -> None:
    assert "the machine" not in ended(arm, end)
