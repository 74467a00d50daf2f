"""The wheel that a user installs holds everything that the repository's packages hold, and works
away from it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("host/zendsp", "target/zendsp_target", "protocol/zendsp_protocol", "c_isr/zendsp_isr")

# Run from the unpacked wheel: the code's own data files are reached and used.
USE = """
import sys
from pathlib import Path
import zendsp, zendsp_isr, zendsp_protocol, zendsp_target
home = Path(sys.argv[1])
for package in (zendsp, zendsp_isr, zendsp_protocol, zendsp_target):
    assert Path(package.__file__).is_relative_to(home), package.__file__
from zendsp_isr.parts import build_machine, machine_names
for name in machine_names():
    assert build_machine(name).exists()
from zendsp.physics.effects import library
from zendsp.physics.kernel.native import FLAGS, build, source_text
assert build(source_text(library()), (*FLAGS, "-O0")).exists()  # half a minute with what FLAGS say
from zendsp.reference import MACHINES, load_machine
for name in MACHINES:
    load_machine(name)
from zendsp.physics import load_model
from zendsp.proof.real import model_folder
assert model_folder().is_relative_to(home)
for path in model_folder().glob("*.toml"):
    load_model(path)
from zendsp_target.runtime import Runtime
from zendsp_isr.build import source_root
runtime = Runtime("imi_planar", clock="fast")
result = runtime.compile({"pd.c": (source_root() / "programs" / "pd.c").read_text()})
assert result.ok, result.diagnostics
runtime.load(result.key)
runtime.close()
print("used")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


def source_files() -> set[str]:
    """Every file of the packages, as the wheel should name it."""
    files = set()
    for package in PACKAGES:
        base = ROOT / package
        for path in base.rglob("*"):
            if (
                path.is_file()
                and "__pycache__" not in path.parts
                and path.suffix not in (".pyc", ".so", ".o")
            ):
                files.add(str(path.relative_to(base.parent)))
    return files


def test_the_wheel_holds_every_file_of_the_four_packages(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    held = {name for name in names if ".dist-info/" not in name and ".data/" not in name}
    assert [name for name in names if ".data/scripts/" in name] == [
        "zendsp-0.1.0.data/scripts/zendsp"
    ]
    wanted = source_files()
    assert {Path(name).suffix for name in wanted} >= {".py", ".c", ".h", ".typed"}
    assert wanted - held == set()
    assert {name.partition("/")[0] for name in held} == {Path(package).name for package in PACKAGES}


@pytest.mark.long("it holds every file, journeys use it; lost: its kernel in an empty cache")
def test_the_wheel_works_away_from_the_repository(wheel: Path, tmp_path: Path) -> None:
    home = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(home)
    environment = {
        **os.environ,
        "PYTHONPATH": str(home),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "ZENDSP_CACHE": str(tmp_path / "cache"),
    }
    done = subprocess.run(
        [sys.executable, "-c", USE, str(home)], cwd=tmp_path, env=environment, capture_output=True,
        text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "used"


def test_versions_agree() -> None:
    import zendsp

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == zendsp.__version__
    assert f"## [{zendsp.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.long("the wheel is looked at above; lost: that the sdist makes it")
def test_the_sdist_makes_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path)]
    done = subprocess.run(
        [*build, "-t", "sdist"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (packed,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(packed) as archive:
        archive.extractall(tmp_path, filter="data")
    (tree,) = (p for p in tmp_path.iterdir() if p.is_dir())
    assert {"LICENSE", "README.md", "pyproject.toml"} <= {p.name for p in tree.iterdir()}
    done = subprocess.run(
        [*build, "-t", "wheel"], cwd=tree, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (again,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as first, zipfile.ZipFile(again) as second:
        assert set(first.namelist()) == set(second.namelist())
        assert any(name.endswith("licenses/LICENSE") for name in second.namelist())
