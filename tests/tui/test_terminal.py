"""The program in a terminal of its own: what it does when that goes away."""

from __future__ import annotations

import os
import pty
import signal
import sys
import time
from pathlib import Path

from waiting import PATIENCE_S

CALL = "from zendsp.cli import main; main()"


def test_a_terminal_that_goes_away_ends_the_program_whoever_ignored_its_signal(
    tmp_path: Path,
) -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
        os.environ["TERM"] = "xterm-256color"
        os.execv(
            sys.executable,
            [sys.executable, "-c", CALL, "tui", "--folder", str(tmp_path), "--screen", "reference"],
        )
    deadline, seen = time.monotonic() + PATIENCE_S, b""
    while b"Reference" not in seen and time.monotonic() < deadline:
        seen += os.read(terminal, 1 << 16)
    os.close(terminal)
    try:
        while os.waitpid(pid, os.WNOHANG) == (0, 0):
            assert time.monotonic() < deadline, "it lives on without a terminal"
            time.sleep(0.05)
    except BaseException:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise
