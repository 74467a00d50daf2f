"""One process at a time writes into a folder."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from waiting import until

from zendsp.errors import ZendspError
from zendsp.one_writer import LOCK, one_writer

WRITES = """
import sys, time
from pathlib import Path
from zendsp.one_writer import one_writer
with one_writer(Path(sys.argv[1]), "zendsp diagnose"):
    print("writes", flush=True)
    sys.stdin.read()
"""


def _writer(folder: Path) -> subprocess.Popen[str]:
    """Another process that writes there until its input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES, str(folder)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "writes\n"
    return process


def test_a_second_diagnosis_into_a_folder_is_refused_and_told_who_writes_there(
    tmp_path: Path, typed: Callable[..., tuple[object, str, str]]
) -> None:
    (tmp_path / "arm.toml").write_text("")
    (tmp_path / "run.csv").write_text("")
    out = tmp_path / "report"
    words = ["diagnose", tmp_path / "run.csv", "--model", tmp_path / "arm.toml", "--out", out]
    other = _writer(out)
    for more in ([], ["--each"]):
        status, _, said = typed(*words, *more)
        assert status == 2
        assert re.search(
            rf"--out \S+report: zendsp diagnose \(process \S+:{other.pid}\) writes there since"
            r" \d\d:\d\d:\d\d on .*: wait until it has ended, or choose another folder",
            " ".join(said.split()),
        ), said
    other.communicate()
    assert not out.exists(), "nothing was written, so it leaves no folder"
    status, _, said = typed(*words)
    assert status == 2 and "writes there" not in said, "of the empty model"


def test_a_writer_that_was_killed_keeps_nobody(tmp_path: Path) -> None:
    other = _writer(tmp_path)
    other.send_signal(signal.SIGKILL)
    other.communicate()
    assert (tmp_path / LOCK).exists()
    with one_writer(tmp_path, "a test"):
        assert str(os.getpid()) in (tmp_path / LOCK).read_text()
        with pytest.raises(ZendspError, match="a test"), one_writer(tmp_path, "of this process"):
            pass
    assert list(tmp_path.iterdir()) == []


def test_writers_by_turns_never_write_at_once(tmp_path: Path) -> None:
    """Also where the file is taken away between the opening of it and the lock."""
    code = f"""
import os, sys, time
from contextlib import suppress
from pathlib import Path
from zendsp.errors import ZendspError
from zendsp.one_writer import one_writer
folder, done = Path({str(tmp_path / "out")!r}), 0
while done < 50:
    with suppress(ZendspError), one_writer(folder, "a test"):
        os.close(os.open(folder / "alone", os.O_CREAT | os.O_EXCL))
        os.unlink(folder / "alone")
        done += 1
"""
    both = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(2)]
    until(lambda: all(one.poll() is not None for one in both), "both are done")
    assert [one.returncode for one in both] == [0, 0]
