"""Every action of the table is carried out by a test."""

from __future__ import annotations

import pytest
from steps import COLLECTED

from zendsp.tui.actions import ACTIONS


def test_every_action_is_carried_out_by_some_test(request: pytest.FixtureRequest) -> None:
    items = request.config.stash[COLLECTED]  # long ones too
    modules = {item.nodeid.split("::")[0].rsplit("/", 1)[-1] for item in items}
    needed = {
        "test_console.py", "test_console_scope.py", "test_diagnose_screen.py", "test_execute.py",
        "test_execute_measure.py", "test_reference_screen.py", "test_stop_and_loss.py",
    }
    if not needed <= modules:
        pytest.skip("only part of the terminal's tests was collected")
    covered = {name for item in items for mark in item.iter_markers("covers") for name in mark.args}
    assert {f"{a.scope}.{a.name}" for a in ACTIONS} == covered
