"""The first commands of a new user."""

from __future__ import annotations

from journey import Installed


def test_a_target_is_started_found_and_named(installed: Installed) -> None:
    installed.target("imi")
    said = installed.run("info", "-t", "imi")
    assert said.returncode == 0, said.stderr
    assert "imi_planar" in said.stdout
    assert "loop       1000 Hz, real clock\n" in said.stdout, "of a loop that is not there no more"
