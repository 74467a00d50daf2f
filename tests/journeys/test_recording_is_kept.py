"""A recording is not lost by Ctrl-C or by a full disk."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed, until

RECORDING = """
import time, zendsp
with zendsp.connect('imi') as t:
    end = time.monotonic() + 100
    while time.monotonic() < end:
        status = t.acquire_status()
        if status.state == 'running' and status.count > 50:
            print("rows come in")
            break
        time.sleep(0.02)
"""
STATE = "import zendsp\nwith zendsp.connect('imi') as t: print(t.status().state)\n"


def _interrupted(installed: Installed, *options: str) -> subprocess.Popen[str]:
    process = installed.start(
        "zendsp", "acquire", "q", "tau", "-t", "imi", "-s", "600", "-o", "run.csv", *options
    )
    assert "rows come in" in installed.script(RECORDING).stdout
    os.kill(process.pid, signal.SIGINT)
    process.wait(PATIENCE_S)
    return process


def test_ctrl_c_keeps_what_was_recorded(installed: Installed) -> None:
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    process = _interrupted(installed)
    assert process.stdout is not None
    assert process.returncode == -signal.SIGINT
    assert "rows of 4 signals to run.csv" in process.stdout.read()
    rows = (installed.folder / "run.csv").read_text().splitlines()
    assert len(rows) > 50
    assert "running" in installed.script(STATE).stdout, "the program is not the recording's"


def test_ctrl_c_pauses_a_run_of_some_seconds(installed: Installed) -> None:
    installed.target("imi")
    process = installed.start("zendsp", "run", "pd.c", "-t", "imi", "--seconds", "600")
    until(lambda: "running" in installed.script(STATE).stdout, "it runs", alive=process)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(PATIENCE_S) == -signal.SIGINT
    assert "paused" in installed.script(STATE).stdout


def test_ctrl_c_pauses_what_the_recording_started(installed: Installed) -> None:
    installed.target("imi")
    assert installed.run("load", "pd.c", "-t", "imi").returncode == 0
    assert _interrupted(installed, "--start").returncode == -signal.SIGINT
    assert "paused" in installed.script(STATE).stdout


@pytest.mark.long("test_full_disk.py has the harder; lost: a file where a folder is meant")
def test_a_recording_that_cannot_be_written_there_is_written_elsewhere(
    installed: Installed,
) -> None:
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    installed.write("file", "not a folder")
    done = installed.run("acquire", "q", "-t", "imi", "-s", "0.1", "-o", "file/run.csv")
    assert done.returncode == 1 and "cannot be written" in done.stderr, done.stderr
    kept = Path(done.stderr.split("it is in ", 1)[1].split()[0])
    assert kept.name == "run.csv" and len(kept.read_text().splitlines()) > 100
    for words in (("experiment", "friction-curve", "--out"), ("demo", "-o")):  # before the work
        done = installed.run(*words, "file/folder")
        said = "zendsp: --out file/folder: cannot be made a folder (Not a directory): choose"
        assert done.returncode == 2 and done.stderr.startswith(said), done


def test_a_picture_that_cannot_be_drawn_hides_no_recording(installed: Installed) -> None:
    """A file stands where the folder should be, since root may write everywhere else."""
    installed.target("imi")
    assert installed.run("run", "pd.c", "-t", "imi").returncode == 0
    installed.write("file", "not a folder")
    words = ("acquire", "q", "-t", "imi", "-s", "0.1", "-o", "q.csv", "--plot", "file/q.png")
    done = installed.run(*words)
    assert done.returncode == 1
    assert "100 rows of 2 signals to q.csv" in done.stdout
    assert done.stderr.startswith("zendsp: file/q.png: cannot be written (File exists)")
