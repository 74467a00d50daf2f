"""STOP from where another runtime folder holds: a service, cron, su, a connection of no session."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from zendsp.cli import cli
from zendsp.errors import Refused
from zendsp.here.registered import local_entries
from zendsp.link import connect
from zendsp_protocol import registry
from zendsp_target.access.registration import check_free
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime


def test_a_target_of_a_session_is_found_and_stopped_from_outside_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standard error said NOT STOPPED, no target runs on this machine; the target ran on."""
    session, none = tmp_path / "session", tmp_path / "none"
    standard = (str(session / "zendsp"), str(none))
    monkeypatch.setattr(registry, "STANDARD", standard)
    monkeypatch.delenv("ZENDSP_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)
    for of_target, of_host in ((session, None), (None, session)):
        _runtime_folder(monkeypatch, of_target)
        with Runtime("imi_planar", clock="real", realtime=False) as runtime:
            monitor = Monitor(runtime, Options("lone", "imi_planar"))
            try:
                _runtime_folder(monkeypatch, of_host)
                assert [entry.name for entry in local_entries()] == ["lone"]
                with monkeypatch.context() as other:
                    other.setattr("os.getpid", lambda: 1)  # as another process
                    with pytest.raises(Refused, match="'lone' runs here already"):
                        check_free("lone")
                with connect("lone") as target:
                    target.download("pd.c")
                    target.start()
                    done = CliRunner().invoke(cli, ["stop"])
                    assert done.exit_code == 0 and "stopped, at sample" in done.output
                    assert target.status().state == "stopped"
            finally:
                monitor.close()


def _runtime_folder(monkeypatch: pytest.MonkeyPatch, folder: Path | None) -> None:
    if folder is None:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    else:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


def test_a_folder_of_another_user_is_not_looked_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_to_all = tmp_path / "open"
    open_to_all.mkdir(mode=0o777)
    open_to_all.chmod(0o777)
    pid = 1
    (open_to_all / "x.json").write_text(
        f'{{"name": "x", "pid": {pid}, "born": "{registry.born(pid)}", "endpoints": [],'
        ' "machine": "m", "protocol": 1}'
    )
    monkeypatch.delenv("ZENDSP_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(registry, "STANDARD", (str(open_to_all), str(tmp_path / "none")))
    assert local_entries() == []
    open_to_all.chmod(0o700)
    assert [entry.name for entry in local_entries()] == ["x"]
