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


@pytest.mark.parametrize("words", [HOST, TARGET], ids=["host", "target"])
def test_too_few_files_for_a_link_are_told_in_a_sentence(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path))
    few = f"ulimit -n 16; exec {sys.executable} {words}"
    done = subprocess.run(["sh", "-c", few], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode in (1, 2), done.stderr
    assert "ulimit -n 1024" in done.stderr and "panic" not in done.stderr


@pytest.mark.parametrize("kilobytes", [131072, 524288])
def test_too_little_memory_for_a_target_is_told_in_a_sentence(
    kilobytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path))
    little = f"ulimit -v {kilobytes}; exec {sys.executable} {TARGET}"
    done = subprocess.run(["sh", "-c", little], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 2, done.stderr
    assert "no more memory" in done.stderr and "Traceback" not in done.stderr
