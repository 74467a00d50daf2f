"""Journeys: what users do, from an empty folder, with the installed wheel and real processes;
nothing is mocked.

A journey is named after the promise that the user relies on. It starts `zendsp` and scripts through
the fixture `installed`, never by importing zendsp in the test's own process.
"""

from __future__ import annotations

import json
import os
import shutil
import site
import subprocess
import sys
import venv
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from journey import Installed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def environment_of_the_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment with the built wheel; the libraries are those of the tests' own
    environment.
    """
    folder = tmp_path_factory.mktemp("journeys")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "dist")]
    _checked(build, ROOT)
    (wheel,) = (folder / "dist").glob("*.whl")
    home = folder / "venv"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    shared = [path for path in sys.path if path.endswith("site-packages")] or site.getsitepackages()
    (packages,) = home.glob("lib/python*/site-packages")
    (packages / "shared.pth").write_text("\n".join(shared) + "\n")
    _checked(
        [
            sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps",
            "--no-index", "--ignore-installed", str(wheel),
        ],
        folder,
    )
    return home


# The kernel of the library: half a minute, of which other tests need the same.
KERNEL = """
from zendsp.physics.effects import library
from zendsp.physics.kernel.native import build, source_text
print(build(source_text(library())))
"""


@pytest.fixture(scope="session")
def cache_of_the_journeys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the journeys compile, and what libraries keep, is made once: it is named by its content.

    tests/whole/test_wheel.py compiles the kernel of the wheel into an empty cache.
    """
    cache = tmp_path_factory.mktemp("cache")
    (cache / "zendsp").mkdir()
    shutil.copy(_checked([sys.executable, "-c", KERNEL], cache).strip(), cache / "zendsp")
    return cache


def _checked(command: Sequence[str], cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def installed(
    environment_of_the_wheel: Path, cache_of_the_journeys: Path, tmp_path: Path
) -> Iterator[Installed]:
    """The installed wheel and an empty folder."""
    home = environment_of_the_wheel
    folder, runtime = tmp_path / "home", tmp_path / "run"
    folder.mkdir()
    runtime.mkdir(mode=0o700)
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("ZENDSP_", "PYTHON", "VIRTUAL"))
    }
    env = {
        **kept,
        "PATH": f"{home / 'bin'}:{os.environ['PATH']}",
        "HOME": str(folder),
        "XDG_CACHE_HOME": str(cache_of_the_journeys),
        "ZENDSP_RUNTIME_DIR": str(runtime),
        "TERM": "xterm-256color",
        "PYTHONUNBUFFERED": "1",
    }
    user = Installed(home / "bin" / "python", home / "bin" / "zendsp", folder, env)
    yield user
    user.end()


@pytest.fixture
def kernels(installed: Installed) -> Installed:
    """A user who has notebooks."""
    pytest.importorskip("nbclient")
    spec = installed.folder / ".local/share/jupyter/kernels/python3"
    spec.mkdir(parents=True)
    command = [str(installed.python), "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    (spec / "kernel.json").write_text(
        json.dumps({"argv": command, "display_name": "p", "language": "python"})
    )
    return installed
