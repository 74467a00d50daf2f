"""A homing that fails drops the commands that were typed meanwhile."""

from __future__ import annotations

import json

import pytest
from journey import Installed
from screen import Screen


@pytest.mark.long("tests/tui/test_session.py has what waits; lost: by keys, in a terminal")
def test_commands_typed_during_a_homing_that_fails_are_not_carried_out(
    installed: Installed
) -> None:
    """Enable and start were typed while the arm went home; then somebody paused it."""
    installed.target("imi", "imi_planar", "--machine-option", "q2=2.0")  # seconds from home
    assert installed.run("load", "pd.c", "-t", "imi").returncode == 0
    screen = Screen(installed, (120, 36), "imi")
    try:
        screen.until("○ loaded")
        screen.keys(b"h")
        screen.until("… home")
        screen.keys(b"es")
        screen.until("enable: waits until home is done")
        screen.keys(b"p")
        screen.until("since home failed after it was asked")
        screen.until("homing ended")
        said = installed.run("drive", "-t", "imi", "--json")
        assert json.loads(said.stdout)["state"] not in ("enabled", "running"), said.stdout
        screen.keys(b"h")  # asked again, it is done
        screen.until("◉ homed")
    finally:
        screen.end()
