"""A process that may open few files, or have little memory, is told so: Zenoh would end it with a
panic, NumPy's library would look for memory without end.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

HOST = """-c '
from zendsp.link.session import open_session
from zendsp.link.settings import Credentials
open_session(["unixsock-stream//nowhere.sock"], Credentials(), 1.0)'"""
TARGET = "-m zendsp_target --machine pendulum --name few --no-realtime"


@pytest.mark.parametrize(
    ("limit", "words", "says"),
    [
        ("-n 16", HOST, "ulimit -n 1024"),
        ("-n 16", TARGET, "ulimit -n 1024"),
        ("-v 131072", TARGET, "no more memory"),
        ("-v 524288", TARGET, "no more memory"),
    ],
    ids=["files of a host", "files of a target", "128 MB", "512 MB"],
)
def test_too_few_files_or_too_little_memory_is_reported_in_a_sentence(
    limit: str, words: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path))
    limited = f"ulimit {limit}; exec {sys.executable} {words}"
    done = subprocess.run(["sh", "-c", limited], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == (1 if words == HOST else 2), done.stderr
    assert says in done.stderr
    assert "panic" not in done.stderr
    assert words == HOST or "Traceback" not in done.stderr
