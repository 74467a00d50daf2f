"""The target that `zendsp tui` connects to."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from click.testing import CliRunner

from zendsp.cli.tui import command


@pytest.mark.parametrize(
    ("options", "environment", "target"),
    [
        (["imi"], {}, "imi"),
        (["-t", "imi"], {}, "imi"),
        (["--target", "imi"], {"ZENDSP_TARGET": "other"}, "imi"),
        ([], {"ZENDSP_TARGET": "other"}, "other"),
        (["imi"], {"ZENDSP_TARGET": "other"}, "imi"),
        (["--local", "imi_planar"], {"ZENDSP_TARGET": "other"}, ""),
        (["--machine", "imi_planar"], {"ZENDSP_TARGET": "other"}, ""),
        ([], {}, ""),
    ],
)
def test_the_target_is_named_as_of_any_command(
    options: list[str],
    environment: Mapping[str, str],
    target: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("ZENDSP_TARGET", raising=False)
    asked: list[tuple[str, str | None]] = []
    monkeypatch.setattr(
        "zendsp.cli.tui._serve", lambda name, machine, *_: asked.append((name, machine))
    )
    done = CliRunner().invoke(command, ["--web", *options], env=environment)
    assert done.exit_code == 0, done.output
    assert asked == [(target, None if target or not options else "imi_planar")]


def test_screens_that_an_error_ended_have_an_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zendsp.cli.tui._need_terminal", lambda: None)
    monkeypatch.setattr("zendsp.tui.app.ZendspApp.run", lambda app: app._fatal_error())
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert CliRunner().invoke(command, []).exit_code == 1
