"""The first commands of a new user."""

from __future__ import annotations

import pytest
from journey import Installed
from screen import Screen


def test_a_target_is_started_found_and_named(installed: Installed) -> None:
    installed.target("imi")
    assert "imi" in installed.run("ls").stdout
    said = installed.run("info", "-t", "imi")
    assert said.returncode == 0, said.stderr
    assert "imi_planar" in said.stdout
    assert "loop       1000 Hz, real clock\n" in said.stdout, "of a loop that is not there no more"


@pytest.mark.long("test_slim_install.py starts one, test_leave.py of tui leaves; lost: both")
def test_the_terminal_brings_its_own_machine_and_takes_it_along(installed: Installed) -> None:
    screen = Screen(installed, (80, 24), "--machine", "imi_planar", "--source", "pd.c")
    try:
        screen.until("○ empty")
        screen.keys(b"b")
        screen.until("○ loaded")
        screen.keys(b"s")
        screen.until("● running")
        assert "imi_planar" in installed.run("ls").stdout
        screen.keys(b"\x11")  # Ctrl+Q
        screen.until("The machine moves")
        screen.keys(b"\x1b[B\x1b[B\r")  # stay, STOP and quit, quit
        assert screen.ended() == 0
    finally:
        screen.end()
    assert "no target answers" in installed.run("ls").stdout


def test_files_of_the_user_do_not_stand_for_the_standard_library(installed: Installed) -> None:
    for name in ("cmd", "json", "queue", "random", "signal", "threading"):
        installed.write(f"{name}.py", "raise SystemExit('taken for the library')\n")
    installed.target("imi")
    assert installed.run("info", "-t", "imi").returncode == 0
    screen = Screen(installed, (80, 24), "--local", "imi_planar")
    try:
        screen.until("○ empty")
    finally:
        screen.end()
