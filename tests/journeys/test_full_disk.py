"""A disk that is full and a reader that went away: nothing that was recorded is lost, and one
sentence says what is the matter.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from journey import PATIENCE_S, Installed

FULL = """
mount -t tmpfs -o size=1m tmpfs "$1" || exit 77
cd "$1"
head -c 2000000 /dev/zero > filler 2>/dev/null
truncate -s -4096 filler
shift
exec "$@"
"""
PREPARE = """
import zendsp
with zendsp.connect('imi') as t:
    t.download('pd.c'); t.start()
"""
Full = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def full(installed: Installed, tmp_path: Path) -> Full:
    """Run a command in a folder of 1 MB, of which 4 kB are free: `full("zendsp", …)`."""
    place = tmp_path / "full"
    place.mkdir()
    script = installed.write("full.sh", FULL)

    def run(
        *command: str, seen: Sequence[str] = (), **env: str
    ) -> subprocess.CompletedProcess[str]:
        program = {"zendsp": installed.zendsp, "python": installed.python}[command[0]]
        done = subprocess.run(
            ["unshare", "-rm", "bash", script, place, program, *command[1:]],
            env={**installed.env, **{name: str(place / value) for name, value in env.items()}},
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
        if done.returncode == 77 or "unshare" in done.stderr:
            pytest.skip(f"this computer gives no small disk to try: {done.stderr.strip()}")
        return done

    return run


def one_sentence(text: str, *words: str) -> str:
    """What a command said about it, after checking that it is no traceback."""
    assert "Traceback" not in text and "Exception ignored" not in text, text
    said = [line for line in text.splitlines() if line.startswith("zendsp")]
    assert said and all(word in " ".join(said) for word in words), text
    return " ".join(said)


def kept(text: str) -> Path:
    """Where a recording is that could not be written where it was meant."""
    return Path(text.split("it is in ", 1)[1].split()[0].rstrip("."))


LOADS = "import sys; from zendsp import Recording; print(len(Recording.load(sys.argv[1])))"


def rows(installed: Installed, path: Path) -> int:
    done = installed.script(LOADS, str(path))
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def test_a_recording_is_kept_elsewhere(installed: Installed, full: Full) -> None:
    installed.target("imi", "imi_planar", "--clock", "fast", "--speed", "20")
    assert installed.script(PREPARE).returncode == 0
    done = full("zendsp", "acquire", "q", "tau", "-t", "imi", "-s", "2", "-o", "run.mat")
    assert done.returncode == 1
    said = one_sentence(done.stderr, "run.mat: cannot be written", "No space left")
    assert rows(installed, kept(said)) == 2000


def test_an_experiment_keeps_its_recording_elsewhere_and_ends_with_one_sentence(
    installed: Installed, full: Full
) -> None:
    done = full("zendsp", "experiment", "breakaway", "--out", ".")
    assert done.returncode == 2, done.stdout + done.stderr
    said = one_sentence(done.stderr, "cannot be written", "No space left")
    assert rows(installed, kept(said)) > 100


def test_a_run_of_the_terminal_keeps_its_recording_elsewhere(
    installed: Installed, full: Full
) -> None:
    store = """
import sys
from pathlib import Path
from zendsp.errors import RecordingError
from zendsp.recording import Recording
from zendsp.tui.runs import list_runs, store_run
rec = Recording.load(sys.argv[1])
try:
    store_run(Path("runs"), "shot", rec, sources={"pd.c": "x" * int(sys.argv[2])})
except RecordingError as error:
    print("zendsp:", error)
print(list_runs(Path("runs")), [p.name for p in Path("runs").iterdir()])
"""
    path = installed.write("store.py", store)
    for count, source in ((20_000, 10), (20, 200_000)):  # its data, or what goes with them
        lines = [f"{k * 1e-3},{math.sin(k * k)}" for k in range(count)]
        data = installed.write("data.csv", "t [s],q [rad]\n" + "\n".join(lines) + "\n")
        done = full("python", str(path), str(data), str(source))
        assert done.returncode == 0, done.stderr
        said = one_sentence(done.stdout, "No space left")
        begins = "zendsp: run 'shot' is in "  # a narrow screen cuts what follows
        assert said.startswith(begins), said
        assert rows(installed, Path(said.removeprefix(begins).split(";")[0])) == count
        assert done.stdout.splitlines()[-1] == "[] []", "no part of a run is left"


def test_salvaged_rows_stay_until_they_are_written(installed: Installed, full: Full) -> None:
    process = installed.target("imi", "imi_planar", "--clock", "fast", "--speed", "20")
    assert installed.script(PREPARE).returncode == 0
    done = installed.run("acquire", "q", "-t", "imi", "-s", "1", "-o", "first.npz")
    assert done.returncode == 0, done.stderr
    process.kill()
    process.wait()
    done = full("zendsp", "salvage", "-t", "imi", "-o", "shot.npz")
    assert done.returncode == 2
    one_sentence(done.stderr, "shot.npz: cannot be written", "No space left")
    assert installed.run("salvage", "-t", "imi", "-o", "shot.npz").returncode == 0
    assert rows(installed, installed.folder / "shot.npz") == 1000


def test_a_target_that_cannot_compile_says_so_and_goes_on(installed: Installed, full: Full) -> None:
    """Before it starts, where not even its own parts can be built; then, for a program."""
    done = full("zendsp", "target", "--name", "imi", XDG_CACHE_HOME="cache")
    assert done.returncode == 2
    one_sentence(done.stderr, "No space left")


SAME = pytest.mark.long("they print as watch does; lost: one that goes round zendsp/cli/lines.py")


@pytest.mark.parametrize(
    "command",
    [
        ["watch", "q", "--interval", "0.01"],
        *(pytest.param(words, marks=SAME) for words in (["get"], ["stats"], ["info", "--json"])),
    ],
    ids=lambda command: command[0],
)
def test_a_closed_output_pipe_is_no_traceback(installed: Installed, command: list[str]) -> None:
    installed.target("imi", "imi_planar", "--clock", "fast", "--speed", "20")
    assert installed.script(PREPARE).returncode == 0
    with open("/dev/full", "w") as disk:
        done = subprocess.run(
            [installed.zendsp, *command, "-t", "imi"], env=installed.env, cwd=installed.folder,
            stdout=disk, stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S, check=False,
        )
    assert done.returncode == 2
    one_sentence(done.stderr, "No space left")
    piped = f"set -o pipefail; {installed.zendsp} {' '.join(command)} -t imi | true"
    done = subprocess.run(
        ["bash", "-c", piped], env=installed.env, cwd=installed.folder, capture_output=True,
        text=True, timeout=PATIENCE_S, check=False,
    )
    # on a busy computer they come late
    said = done.stderr.replace("waiting for samples: the program runs\n", "")
    assert said == "", "who closes a pipe wants no more, not even a complaint"
