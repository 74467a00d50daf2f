"""Ctrl-C keeps what was done, and says how the machine is left or that this is not known."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import relay_to
from waiting import PATIENCE_S, freeze, status_of, until

from zendsp.link import Target
from zendsp.recording import Recording

# started in the background of a shell, Python would leave Ctrl-C to be ignored
COMMAND = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from"
    " zendsp.__main__ import main; main()"
)


def _interrupted(
    *words: object, when: Callable[[], object], what: str, status: int | None = None,
    by: int = signal.SIGINT, again_s: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Type a command, and Ctrl-C (or another signal) as soon as ``when`` holds; and once more."""
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *map(str, words)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )
    until(when, what)
    process.send_signal(by)
    if again_s is not None:
        time.sleep(again_s)
        process.send_signal(by)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert status_of(process.returncode) == (128 + by if status is None else status), err
    return subprocess.CompletedProcess(words, process.returncode, out, err)


def test_ctrl_c_keeps_the_runs_of_a_sweep_that_are_done(real: Target, tmp_path: Path) -> None:
    kept, table = tmp_path / "kept", tmp_path / "sweep.csv"
    done = _interrupted(
        "sweep", "Kp1=1500:2500:3", "-c", "e1", "-s", 0.3, "--settle", 0, "--fade", 0.2,
        "--keep", kept, "-o", table, when=(kept / "002.mat").exists, what="two runs are done",
    )  # fmt: skip
    assert len(table.read_text().splitlines()) == 3 and "2500" not in done.stdout
    assert "Sweep of 2 of 3 runs: rms e1 is least" in done.stdout
    assert f"{real.name}: running at sample" in done.stderr and "'zendsp pause'" in done.stderr
    assert real.status().state == "running" and real["Kp1"] == 2000.0


def test_ctrl_c_says_that_the_trigger_never_came(real: Target, tmp_path: Path) -> None:
    if real.status().state != "running":
        real.start()
    done = _interrupted(
        "acquire", "e1", "-s", 0.5, "-o", tmp_path / "never.npz", "--trigger", "e1", "--level", 99,
        when=lambda: real.acquire_status().state == "armed", what="it waits for its trigger",
    )  # fmt: skip
    assert "the trigger never came: e1 did not cross 99 (rising)" in done.stdout


@pytest.mark.parametrize("again_s", [0.01, 0.03])
def test_ctrl_c_pressed_again_does_not_lose_what_was_recorded(
    again_s: float, real: Target, tmp_path: Path
) -> None:
    if real.status().state != "running":
        real.start()
    out = tmp_path / "run.npz"
    _interrupted(
        "acquire", "e1", "-s", 30, "-o", out, again_s=again_s,
        when=lambda: real.acquire_status().state == "running", what="it records",
    )  # fmt: skip
    assert out.exists()


def test_ctrl_c_says_how_the_machine_is_left(real: Target, tmp_path: Path) -> None:
    done = _interrupted(
        "bode", "--f-min", 2, "--f-max", 10, "--no-rehearsal",
        when=lambda: real.drive_status().moved_by and real.status().state == "running",
        what="it moves",
    )  # fmt: skip
    assert real.status().state == "paused" and "outputs are safe, drives off" in done.stderr
    done = _interrupted(
        "experiment", "friction", "-t", real.name, "--out", tmp_path,
        when=lambda: real.status().state == "running", what="it moves",
    )  # fmt: skip
    assert real.status().trip is not None and f"{real.name}: stopped: STOP" in done.stderr
    assert "pd.c is not loaded any more" in done.stderr
    assert "then load a program and start it" in done.stderr


def test_ctrl_c_says_loudly_where_it_is_not_known_how_the_machine_is_left(real: Target) -> None:
    real.pause()
    process = int(real.info.pid)

    def silent() -> bool:
        if real.status().state != "running":
            return False
        freeze(process)
        return True

    try:
        done = _interrupted("run", "--seconds", 100, when=silent, what="it runs", status=2)
    finally:
        os.kill(process, signal.SIGCONT)
    assert "NOT KNOWN whether the machine still moves" in done.stderr


def test_ctrl_c_of_a_stop_that_waits_says_that_nothing_is_known(real: Target) -> None:
    process = int(real.info.pid)
    with relay_to(real.link.endpoints[0]) as relay:
        freeze(process)
        try:
            done = _interrupted(
                "stop", real.name, "--connect", relay.endpoint, when=lambda: relay.passed,
                what="it is asked",
            )  # fmt: skip
        finally:
            os.kill(process, signal.SIGCONT)
    assert "NOT STOPPED: use the machine's emergency stop" in done.stderr


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_zendsp_cut_leaves_whole_files_and_names_them(
    tmp_path: Path, by: int
) -> None:
    t = np.arange(400_000) / 1000.0
    t[1000:] += 100.0  # a gap: the first part is short, the second one takes its time
    Recording.from_columns({"q": np.sin(t), "u": np.cos(t)}, t=t).save(tmp_path / "run.npz")
    out = tmp_path / "cut"
    done = _interrupted(
        "cut", tmp_path / "run.npz", "-o", out / "a.csv", by=by,
        when=lambda: any(out.glob(".a-2.csv.*.part")), what="the second part is being written",
    )  # fmt: skip
    assert [file.name for file in out.iterdir()] == ["a-1.csv"]
    assert len(Recording.load(out / "a-1.csv")) == 1000
    assert f"1 of 2 parts are written and whole: {out / 'a-1.csv'}" in done.stderr


def test_a_recording_that_fits_nowhere_is_said_to_be_on_the_target(
    real: Target, tmp_path: Path
) -> None:
    words = ["acquire", "q", "tau", "-s", "0.5", "-t", real.name, "-o"]
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, *words, tmp_path / "run.csv"], capture_output=True,
        text=True, timeout=PATIENCE_S, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )  # fmt: skip
    again = f"zendsp acquire --last -t {real.name} -o FILE"
    assert done.returncode == 2 and f"the target has it: {again}" in done.stderr, done.stderr
    last = [sys.executable, "-c", COMMAND, *again.split()[1:-1], tmp_path / "run.npz"]
    subprocess.run(last, timeout=PATIENCE_S, check=True)
    assert len(Recording.load(tmp_path / "run.npz")) == 500
