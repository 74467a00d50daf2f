"""What the command line says to somebody who types wrong things: one style, and what to do next."""

from __future__ import annotations

import errno
import io
import os
import pty
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from waiting import PATIENCE_S, status_of

from zendsp.cli import COMMANDS, LazyGroup, cli, main
from zendsp.cli.lines import fitted, write_anywhere
from zendsp.cli.stats import bars


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Exit status of ``zendsp words``, and what it wrote on standard error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["zendsp", *words])
        with pytest.raises(SystemExit) as ended:
            main()
    return int(str(ended.value.code)), capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["set"], "missing argument 'NAME=VALUE...'; 'zendsp set --help' says more"),
        (["set", "Kp1"], "'Kp1': expected NAME=VALUE; 'zendsp set --help'"),
        (["set", "Kp1=abc"], "'abc' is not a value; write 3"),
        (["set", "Kp1=420N"], "'420N' is not a value: values are written without their unit (420)"),
        (["set", "Kp1=1", "Kp1=2"], "'Kp1=2': Kp1 has a value already"),
        (["model", "new"], "missing argument 'RECORDING'; 'zendsp model new --help' says more"),
        (["diagnose"], "which recording? For example: zendsp diagnose run.mat --model arm.toml"),
        (["diagnose", "a.csv"], "tx40.toml, wam7.toml); to begin one: zendsp model new a.csv;"),
        (["diagnose", "run 1.csv"], "to begin one: zendsp model new 'run 1.csv';"),
        (
            ["diagnose", "a.csv", "--modle", "m.toml"],
            "no such option '--modle'; did you mean '--model'? 'zendsp diagnose --help'",
        ),
        (["completion", "tcsh"], "'tcsh' is not one of"),
        (  # dashes make no two names alike
            ["reference", "multisine", "--duration", "5"],
            "no such option '--duration'; 'zendsp reference multisine --help' says more",
        ),
        (
            ["bridge", "foxglove", "--port", "99999"],
            "--port 99999: expected a whole number from 0 to 65535; 'zendsp bridge foxglove",
        ),
        (["set", "Kp1=1", "--fade", "5"], "--fade 5: expected a number from 0 to 2, in s;"),
        (["run", "--seconds", "-1"], "--seconds -1: expected a number of more than 0, in s;"),
        (["run", "--seconds", "inf"], "--seconds: inf is no time in which a program could end"),
        (["watch", "q", "--interval", "0"], "--interval 0: expected a number of 0.001 or more"),
        (["demo", "--seed", "x"], "--seed x: expected a whole number of 0 or more;"),
        (["drive", "enable", "--mode", "x"], "--mode: 'x' is not one of 'torque', 'velocity'"),
        (["gett"], "no command 'gett'; did you mean get? 'zendsp --help' lists them"),
        (["params", "sav"], "no command 'sav'; did you mean save? 'zendsp params --help'"),
        (["tui", "--machine", "imi_plaanr"], "imi_planar"),
        (["params", "diff", "no-such.json", "b.json"], "no-such.json: no such file"),
    ],
)
def test_every_wrong_use_is_one_line_that_says_what_to_do(
    capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    status, text = said(capsys, *words)
    assert status == 2
    assert expected in text
    assert text.startswith("zendsp: ") and len(text.splitlines()) == 1, text


UNLOADABLE = ImportError("cannot load it", path="libx.so")
OF_NUMPY = ImportError("numpy's advice on how to install it")
OF_NUMPY.__cause__ = UNLOADABLE


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (MemoryError("Unable to allocate 20.6 MiB"), "Unable to allocate 20.6 MiB"),
        (MemoryError(), "none is left"),
        (UNLOADABLE, "cannot load it"),
        (OF_NUMPY, "cannot load it"),
    ],
)
def test_too_little_memory_is_told_in_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: Exception, why: str
) -> None:
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr("zendsp.cli.entry.cli", fail)
    monkeypatch.setattr("resource.getrlimit", lambda _: (2**30, 2**30))
    status, text = said(capsys, "diagnose")
    assert status == 2 and len(text.splitlines()) == 1
    assert text.startswith(f"zendsp: too little memory ({why})")


def test_numpy_is_not_begun_with_where_it_would_look_for_memory_without_end() -> None:
    words = f"ulimit -v 100000; exec {sys.executable} -m zendsp reference circle"
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("zendsp: too little memory (it needs 512 MB")


def test_the_terminal_is_refused_where_there_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = said(capsys, "tui")  # pytest's standard output is a file
    assert status == 2 and "--web" in text and len(text.splitlines()) == 1


def test_ls_says_how_to_start_a_target_where_there_is_none(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)
    monkeypatch.setattr(sys, "argv", ["zendsp", "ls"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    assert "zendsp target" in capsys.readouterr().out
    status, text = said(capsys, "get")
    assert status == 2 and "ZENDSP_CONNECT=" in text and "connect=" not in text


def test_a_group_without_a_word_shows_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = said(capsys, "params")
    assert status == 2 and "Commands:" in text and "restore" in text


def test_the_last_line_of_help_says_how_to_begin(capsys: pytest.CaptureFixture[str]) -> None:
    """A terminal of 24 rows shows the end of it."""
    _, text = said(capsys)
    assert text.rstrip().splitlines()[-1].strip().startswith("To begin:  zendsp demo")


def test_the_names_of_commands_are_those_of_the_table() -> None:
    assert isinstance(cli, LazyGroup) and "get" in COMMANDS


def test_the_timing_is_shown_in_a_screenful() -> None:
    """The target counts in quarter octaves, from 1 ns to seconds; nobody reads a hundred lines."""
    edges = np.concatenate([[0.0], 0.001 * 2.0 ** (np.arange(120) / 4)])
    counts = np.arange(120)
    lines = bars(counts, edges)
    assert len(lines) <= 18
    shown = [int(line.split("…")[1].split()[1]) for line in lines]
    assert sum(shown) == counts.sum()
    few = bars(np.array([0, 3, 4, 0]), np.array([0.0, 1.0, 1.25, 1.5, 2.0]))
    assert len(few) == 1 and "7" in few[0]


# as sitecustomize: of every interpreter, also of the one that a command turns into
INTERRUPTS = """
import os, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["WHEN"]:
            os.kill(os.getpid(), int(os.environ.get("SIGNAL", "2")))

sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize(
    ("command", "when"),
    [
        ("ls", "signal"),  # of zendsp's own lines among the first
        ("ls", "zendsp.errors"),
        ("target", "zendsp.cli.target"),
        ("target", "runpy"),  # of the interpreter that takes its place
        ("target", "argparse"),
        ("", "zendsp_isr.compiler"),  # python -m zendsp_target
        ("", "zenoh"),
        ("", "zendsp_target.serving.server"),
    ],
)
def test_ctrl_c_while_a_command_begins_ends_it_without_a_traceback(
    command: str, when: str, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTS)
    code = "from zendsp.__main__ import main; main()"
    words = ["-c", code, command] if command else ["-m", "zendsp_target"]
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "WHEN": when},
        timeout=PATIENCE_S,
    )
    assert status_of(done.returncode) == 130, done.stderr
    assert "Traceback" not in done.stderr and not done.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("when", ["zendsp", "zendsp.cli", "zendsp.cli.ls"])
def test_a_signal_from_the_first_line_of_the_installed_command_on_ends_it_in_one_line(
    when: str, number: signal.Signals, tmp_path: Path
) -> None:
    """What pip writes for an entry point imports before anything can catch a Ctrl-C."""
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTS)
    root = Path(__file__).parents[2]
    scripts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    (script,) = scripts["targets"]["wheel"]["shared-scripts"]
    assert os.access(root / script, os.X_OK), "pip would install it as it is"
    done = subprocess.run(
        [sys.executable, root / script, "ls"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "WHEN": when, "SIGNAL": str(int(number))},
        timeout=PATIENCE_S,
    )
    words = "interrupted" if number == signal.SIGINT else f"ended by {number.name}"
    assert (status_of(done.returncode), done.stderr.strip()) == (128 + number, words)


def test_where_zenoh_has_threads_the_interpreter_is_not_taken_apart(tmp_path: Path) -> None:
    """One that comes back from compiled code meanwhile aborts the process: `zendsp watch` did."""
    code = """
import atexit, sys, types
from zendsp import cli
from zendsp.__main__ import main

class Thing:
    def __del__(self):
        print("taken apart", file=sys.__stderr__)

def command():
    sys.modules["zenoh"] = types.ModuleType("zenoh")
    sys.modules["zenoh"].thing = Thing()
    atexit.register(print, "handlers ran")
    sys.exit(3)

cli.main = command
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "handlers ran\n", "")


def test_ctrl_c_while_an_object_is_taken_apart_is_not_lost() -> None:
    code = """
import os, signal, sys, time
import click
from zendsp import cli
from zendsp.__main__ import main

class Thing:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        len("here it comes")

@cli.cli.command("long")
def long():
    Thing()
    time.sleep(3600)

cli.COMMANDS.clear()
cli.LazyGroup.get_command = lambda *_: long
sys.argv = ["zendsp", "long"]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == -signal.SIGINT, "or a loop of a shell goes on"
    assert done.stderr.strip() == "interrupted"


def test_a_command_whose_terminal_was_closed_keeps_what_it_has(tmp_path: Path) -> None:
    """Writing there failed, and a recording was lost with it."""
    code = f"""
import time
from pathlib import Path
from zendsp.here.ending import end_softly

end_softly()
try:
    print("ready", flush=True)
    time.sleep(3600)
except KeyboardInterrupt:
    print("saving", flush=True)
    Path({str(tmp_path / "kept")!r}).touch()
"""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", code])
    assert b"ready" in os.read(terminal, 1 << 16)
    os.close(terminal)
    os.waitpid(pid, 0)
    assert (tmp_path / "kept").exists()


def test_a_diagnosis_that_does_not_begin_leaves_no_folder(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    asked = ("gone.csv", "--model", "imi_planar.toml", "--out", str(tmp_path / "a" / "report"))
    status, text = said(capsys, "diagnose", *asked)
    assert status == 2 and "gone.csv" in text
    assert list(tmp_path.iterdir()) == []


def test_prose_is_broken_between_words_where_a_terminal_shows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", "30")
    table = "q    1.0   2.0   3.0   4.0   5.0"
    prose = "note: a sentence that is longer than the terminal is wide"
    named = "loop  1000 Hz, real clock; SCHED_RR 80"
    text = f"{prose}\n{named}\n{table}"
    assert fitted(text, io.StringIO()) == text, "a line of a pipe stays one line"
    *lines, columns = fitted(text, Terminal()).split("\n")
    assert len(lines) == 5 and all(len(line) <= 30 for line in lines)
    assert lines[1].startswith("      ") and columns == table
    assert lines[3:] == ["loop  1000 Hz, real clock;", "      SCHED_RR 80"]


def test_the_line_of_help_names_every_viewer_of_the_bridge() -> None:
    from zendsp.cli.bridge import command

    said = COMMANDS["bridge"][1].lower()
    assert set(command.commands) == {"foxglove", "rerun"}
    assert all(viewer in said for viewer in (*command.commands, "plotjuggler"))


def options(command: click.Command, path: str) -> Iterator[tuple[str, click.Parameter]]:
    """Every option of a command and of those below it, with the words that lead there."""
    for parameter in command.params:
        yield path, parameter
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from options(below, f"{path} {name}".strip())


def test_what_is_written_is_named_by_the_same_letter_everywhere() -> None:
    named = {path: p.opts for path, p in options(cli, "") if "--out" in p.opts}
    assert "reference circle" in named and "diagnose" in named and len(named) > 10
    assert [path for path, opts in named.items() if "-o" not in opts] == []


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("latin-1", "  + power, - homed: 3 µs ± 1 ..."),
        ("ascii", "  + power, - homed: 3 us +- 1 ..."),
        ("utf-8", "  ✔ power, ✖ homed: 3 µs ± 1 …"),
    ],
)
def test_a_stream_that_lacks_a_character_writes_another(encoding: str, expected: str) -> None:
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding=encoding)
    write_anywhere(stream)
    print("  ✔ power, ✖ homed: 3 µs ± 1 …", end="", file=stream, flush=True)
    assert written.getvalue().decode(encoding) == expected


def test_a_command_whose_output_is_not_utf_8_ends_well() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "zendsp", "drive", "--help"],
        env={**os.environ, "PYTHONIOENCODING": "latin-1"}, capture_output=True, check=False,
        timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0 and not done.stderr and b"->" in done.stdout, done.stderr


def test_a_demo_on_a_full_disk_names_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a write raises names no file."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("zendsp.demo.run_demo", full)
    status, text = said(capsys, "demo", "-o", str(tmp_path / "d"))
    assert status == 2
    assert text == f"zendsp: --out {tmp_path / 'd'}: cannot be written (No space left on device)\n"


def test_a_model_in_c_says_what_could_not_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / "model.c"
    status, text = said(capsys, "model2c", "imi_planar.toml", "-o", str(out))
    assert status == 2 and text.startswith(f"zendsp: {out}: cannot be written ("), text
