"""zendsp watch, and commands that end by Ctrl-C."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Iterator

import pyte
import pytest
from helpers import running
from waiting import PATIENCE_S

import zendsp
from zendsp.link import Target


@pytest.fixture
def target(fast: Target) -> Iterator[Target]:
    yield fast


def test_ctrl_c_ends_watch_cleanly(target: Target) -> None:
    target.download("pd.c")
    target.start()
    command = [
        sys.executable,
        "-c",
        # whoever runs the tests in a shell's background has told every child to ignore Ctrl-C
        (
            "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from"
            " zendsp.cli import main; main()"
        ),
        "watch",
        "q",
        "--interval",
        "0.05",
    ]
    watch = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert watch.stdout is not None
    line = watch.stdout.readline()
    assert re.fullmatch(r"t +[\d.]+ s  q\[0\] .* rad  q\[1\] .* rad\n", line), line
    watch.send_signal(signal.SIGINT)
    _, said = watch.communicate(timeout=PATIENCE_S)
    assert watch.returncode == 130 and said.strip() == "interrupted"
    assert target.status().state == "running"


def test_a_command_whose_output_nobody_reads_on_ends_as_others_do(target: Target) -> None:
    """`zendsp watch q | head` ended with 1, as if the answer were no."""
    target.download("pd.c")
    target.start()
    command = [sys.executable, "-m", "zendsp", "watch", "q", "--interval", "0.05"]
    watch = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert watch.stdout is not None and watch.stderr is not None
    watch.stdout.readline()
    watch.stdout.close()
    assert watch.wait(PATIENCE_S) == 128 + signal.SIGPIPE and watch.stderr.read() == ""
    watch.stderr.close()
    assert target.status().state == "running"


def test_watch_ends_with_an_error_when_its_target_is_killed(target: Target) -> None:
    target.download("pd.c")
    target.start()
    command = [sys.executable, "-c", "from zendsp.cli import main; main()"]
    with subprocess.Popen(
        [*command, "watch", "q", "-t", target.name], stdout=-1, stderr=-1, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert "q[0]" in process.stdout.readline()
        os.kill(target.info.pid, signal.SIGKILL)
        _, wrong = process.communicate(timeout=PATIENCE_S)
        assert process.returncode != 0 and "zendsp: " in wrong, wrong


def test_watch_in_a_pipe_repeats_no_row_of_a_program_that_is_paused(target: Target) -> None:
    target.download("pd.c")
    target.start()
    command = [sys.executable, "-u", "-c", "from zendsp.cli import main; main()"]
    words = [*command, "watch", "q", "-t", target.name, "--interval", "0.02", "--json"]
    with subprocess.Popen(words, stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        target.pause()
        assert "waiting for samples: the program is paused" in process.stderr.readline()
        process.kill()
        times = [json.loads(line)["t"] for line in process.stdout.read().splitlines()]
    assert times == sorted(set(times)), "each row once"


def test_watch_says_at_once_what_stopped_the_program(target: Target) -> None:
    """It had gone on with zeros, or waited for ever, and given the reason only when it was ended.
    """
    target.download("pd.c")
    command = [sys.executable, "-u", "-c", "from zendsp.cli import main; main()"]
    words = [*command, "watch", "q", "-t", target.name]
    with subprocess.Popen(words, stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert "the program is loaded" in process.stderr.readline()
        target.start()
        assert "q[0]" in process.stdout.readline()
        target.stop()
        assert f"{target.name}: stopped: STOP was requested" in process.stderr.readline()
        process.kill()
    with subprocess.Popen(words, stdout=-1, stderr=-1, text=True) as process:
        assert process.stderr is not None
        assert "stopped: STOP was requested" in process.stderr.readline()
        process.kill()


def test_watch_goes_on_with_a_longer_array_and_says_which_variable_is_gone(target: Target) -> None:
    """It ended with a traceback, or waited for ever: "the program runs"."""

    def run(array: str, length: int) -> None:
        target.download(
            {
                "p.c": f"""#include "isr.h"
static double {array}[{length}];
void UserInit(void) {{ SIGNAL({array}, "rad", "x"); }}
void UserISR_INT2(void) {{ {array}[{length - 1}] = {length}; }}"""
            }
        )
        target.start()

    run("past", 2)
    command = [sys.executable, "-u", "-c", "from zendsp.cli import main; main()"]
    words = [*command, "watch", "past", "-t", target.name, "--interval", "0.02"]
    with subprocess.Popen(words, stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert "past[1]" in process.stdout.readline()
        run("past", 3)
        while "past[2]" not in (line := process.stdout.readline()):
            assert line, process.stderr.read()
        assert line.split()[-3:] == ["past[2]", "3", "rad"]
        run("hist", 3)
        while "has no past now" not in (line := process.stderr.readline()):
            assert line
        process.kill()


@pytest.mark.long("the tests beside it watch; lost: a narrow terminal")
def test_watch_in_a_narrow_terminal_changes_in_place(target: Target) -> None:
    target.download("pd.c")
    target.start()
    watch = "from zendsp.cli import main; main()"
    columns, lines = 50, 12
    shown = pyte.HistoryScreen(columns, lines)
    stream = pyte.ByteStream(shown)
    pid, fd = pty.fork()
    if pid == 0:
        code = [sys.executable, "-c", watch, "watch", "q", "tau", "--interval", "0.01"]
        os.execve(code[0], [*code, "--count", "40"], {**os.environ, "COLUMNS": str(columns)})
    with contextlib.suppress(OSError):  # the end of the terminal
        while data := os.read(fd, 1 << 16):
            stream.feed(data)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    text = [row for row in shown.display if row.strip() and not row.startswith("waiting for")]
    assert not shown.history.top, "nothing scrolled away"
    assert re.sub(r"[-+.e\d]+ ", "", " ".join(" ".join(text).split())) == (
        "t s q[0] rad q[1] rad tau[0] N m tau[1] N m"
    ), text


def test_target_runs_in_the_foreground_until_ctrl_c() -> None:
    command = [
        sys.executable, "-c", "from zendsp.cli import main; main()", "target", "--name", "bench",
        "--clock", "fast",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert (
        process.stdout is not None
        and "target bench listens on unixsock-stream/" in process.stdout.readline()
    )
    with zendsp.connect("bench") as bench:
        assert bench.info.clock == "fast"
        bench.download("pd.c")
        bench.start()
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 0
    said = process.stdout.read()
    assert said == "target bench has ended; its machine is in its safe state\n"
    assert not running(process.pid) and zendsp.discover() == []
    assert os.listdir(os.environ["ZENDSP_RUNTIME_DIR"]) == []
    process.stdout.close()
