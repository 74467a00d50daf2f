"""What an import costs and pulls in: a target is a small machine, and ``--help`` must not make
anyone wait.
"""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

HOST_ONLY = {
    "casadi", "click", "h5py", "matplotlib", "pandas", "pinocchio", "pyarrow", "rich", "scipy",
    "textual", "tomli_w", "xarray", "zendsp",
}
HEAVY = HOST_ONLY - {"click", "zendsp"} | {"numpy", "zenoh", "cffi", "msgpack", "msgspec"}

# Refuses what a bare target machine has not got, as if it were not installed.
BARE = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HOST_ONLY!r}:
            raise ModuleNotFoundError(f"{{name}} is not installed on a bare target machine", name=name)
sys.meta_path.insert(0, Refuse())
"""  # noqa: E501


def python(code: str, *arguments: str) -> str:
    """Standard output of a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def loaded_by(statement: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded after a statement."""
    return set(
        python(
            f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
        ).split()
    )


def test_a_diagnosis_begins_without_what_few_machines_need() -> None:
    found = python("import zendsp.diagnosis.engine, sys\nprint(*sys.modules)").split()
    assert "zendsp.diagnosis.engine" in found
    slow = {"scipy", "matplotlib", "pandas"}  # some tenths of a second each, in every process
    assert not slow & set(found)


@pytest.mark.parametrize(
    "module",
    ["zendsp_target", "zendsp_target.monitor", "zendsp_target.runtime", "zendsp_target.__main__"],
)
def test_the_target_loads_nothing_of_the_host(module: str) -> None:
    found = loaded_by(f"import {module}")
    assert module.partition(".")[0] in found
    assert found & HOST_ONLY == set()


def test_import_zendsp_loads_nothing_heavy() -> None:
    found = loaded_by("import zendsp")
    assert "zendsp" in found
    assert found & HEAVY == set()


def test_help_loads_nothing_heavy() -> None:
    said = python(
        "import sys\n"
        "from zendsp.cli import cli\n"
        "sys.argv = ['zendsp', '--help']\n"
        "cli(standalone_mode=False)\n"
        "print('LOADED', *{name.partition('.')[0] for name in sys.modules})"
    )
    shown, _, names = said.partition("LOADED")
    assert "Usage: zendsp" in shown and "diagnose" in shown
    assert set(names.split()) & HEAVY == set()


def test_help_of_every_command_shows_an_example_and_loads_no_terminal_and_no_plots() -> None:
    said = python(
        "import json, sys, click\n"
        "from zendsp.cli import COMMANDS, cli\n"
        "out = {}\n"
        "parent = click.Context(cli, info_name='zendsp')\n"
        "for name in COMMANDS:\n"
        "    command = cli.get_command(parent, name)\n"
        "    context = click.Context(command, info_name=name, parent=parent)\n"
        "    out[name] = command.get_help(context)\n"
        "print(json.dumps([out, sorted({name.partition('.')[0] for name in sys.modules})]))"
    )
    helps, modules = json.loads(said)
    shown = {name: text.partition("Example")[2] for name, text in helps.items()}
    assert {name for name, text in shown.items() if f"zendsp {name}" not in text} == set()
    assert set(modules) & {"matplotlib", "textual", "casadi", "pinocchio"} == set()


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--json", "--no-realtime", "--clock", "fast"]], ids=["help", "start"]
)
def test_a_target_runs_with_zenoh_numpy_msgpack_msgspec_cffi_and_a_compiler_alone(
    arguments: list[str], tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(BARE)
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "ZENDSP_RUNTIME_DIR": str(tmp_path / "registry"),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "zendsp_target", *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        if "--help" in arguments:
            assert first.startswith("usage: python -m zendsp_target")
        else:
            assert first, process.communicate(timeout=30)[1]
            assert json.loads(first)["endpoints"]
            process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 0, said
    finally:
        process.kill()
        process.communicate()


def test_the_command_on_a_bare_target_says_how_to_start_it() -> None:
    code = 'import sys; sys.modules["click"] = None; import zendsp.cli'
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "python -m zendsp_target" in done.stderr and "pip install zendsp" in done.stderr


def modules() -> dict[str, Path]:
    """Every module of the four packages, by its dotted name."""
    root = Path(__file__).parents[2]
    found = {}
    for source in ("host", "target", "protocol", "c_isr"):
        for path in (root / source).rglob("*.py"):
            parts = path.relative_to(root / source).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> Iterator[str]:
    """What a module imports, anywhere in it: also within a function, also for its types only."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def test_no_module_imports_itself_by_way_of_others() -> None:
    known = modules()
    assert len(known) > 300
    graph = {name: set(imported(path, known)) - {name} for name, path in known.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" → ".join(reversed(error.args[1])))
