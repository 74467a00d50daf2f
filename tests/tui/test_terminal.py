"""The program in a terminal of its own: what it does when that goes away."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
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


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_screens_and_leaves_the_terminal_as_it_was(
    number: signal.Signals, tmp_path: Path
) -> None:
    """The shell was left in the screens' own buffer, with the mouse reported and nothing echoed."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["TERM"] = "xterm-256color"
        words = ["tui", "--folder", str(tmp_path), "--screen", "reference"]
        call = "from zendsp.__main__ import main; main()"
        os.execv(sys.executable, [sys.executable, "-c", call, *words])
    deadline, seen, asked = time.monotonic() + PATIENCE_S, b"", False
    with contextlib.suppress(OSError):  # it has closed the terminal
        while piece := os.read(terminal, 1 << 16):
            seen += piece
            assert time.monotonic() < deadline, seen[-2000:]
            if b"goal" in seen and not asked:
                os.kill(pid, number)
                asked = True
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 128 + number
    os.close(terminal)
    assert b"\x1b[?1049l" in seen and seen.rstrip().endswith(f"ended by {number.name}".encode())


def test_standard_error_may_go_to_a_file_while_the_screens_are_in_the_terminal(
    tmp_path: Path,
) -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["TERM"] = "xterm-256color"
        os.dup2(os.open(tmp_path / "errors", os.O_CREAT | os.O_WRONLY), 2)
        os.execv(
            sys.executable,
            [sys.executable, "-c", CALL, "tui", "--folder", str(tmp_path), "--screen", "reference"],
        )
    deadline, seen = time.monotonic() + PATIENCE_S, b""
    try:
        while b"goal" not in seen:
            assert time.monotonic() < deadline, seen[-2000:]
            if select.select([terminal], [], [], 0.1)[0]:
                seen += os.read(terminal, 1 << 16)
        assert b"goal" not in (tmp_path / "errors").read_bytes()
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(terminal)


@pytest.mark.parametrize(("stream", "said"), [(0, "keys come from"), (1, "output goes")])
def test_without_a_terminal_for_keys_and_pictures_it_is_refused(stream: int, said: str) -> None:
    ours, theirs = pty.openpty()
    streams = [theirs, theirs, subprocess.PIPE]
    streams[stream] = subprocess.DEVNULL
    ended = subprocess.run(
        [sys.executable, "-c", CALL, "tui"],
        stdin=streams[0], stdout=streams[1], stderr=streams[2], timeout=PATIENCE_S,
    )  # fmt: skip
    os.close(ours), os.close(theirs)
    assert ended.returncode == 2 and said in ended.stderr.decode()


SLOW = """
import asyncio, pathlib, sys
from zendsp.tui.app import ZendspApp

at_once = ZendspApp.on_mount

async def slowly(app):
    while not pathlib.Path(sys.argv[-1], "typed").exists():
        await asyncio.sleep(0.02)
    await at_once(app)

ZendspApp.on_mount = slowly
"""


def test_what_is_typed_before_the_first_picture_is_no_command(tmp_path: Path) -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["TERM"] = "xterm-256color"
        os.execv(
            sys.executable,
            [sys.executable, "-c", SLOW + CALL, "tui", "--folder", str(tmp_path)],
        )
    deadline, seen = time.monotonic() + PATIENCE_S, b""

    def until(text: bytes, keys: bytes = b"") -> None:
        """Read until there is a text; press keys once a second meanwhile."""
        nonlocal seen
        asked = time.monotonic()
        while text not in seen:
            assert time.monotonic() < deadline, seen[-2000:]
            if keys and time.monotonic() > asked:
                os.write(terminal, keys)
                asked += 1.0
            if select.select([terminal], [], [], 0.1)[0]:
                seen += os.read(terminal, 1 << 16)

    try:
        until(b"[?1049h")  # it reads keys from here on, and has shown nothing
        os.write(terminal, b"?")
        (tmp_path / "typed").touch()
        until(b"no target")
        until(b"goal", b"\x1bOS")  # F4, which a dialog of the keys would not let through
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(terminal)


def test_what_a_library_writes_on_standard_error_waits_until_the_screens_are_gone() -> None:
    program = (
        "import os\nfrom zendsp.cli.tui import errors_kept\n"
        "with errors_kept():\n    os.write(2, b'torn'); os.write(1, b'picture ')\n"
    )
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", program])
    seen = b""
    with contextlib.suppress(OSError):  # its end
        while data := os.read(terminal, 1 << 16):
            seen += data
    os.waitpid(pid, 0)
    os.close(terminal)
    assert seen == b"picture torn"
