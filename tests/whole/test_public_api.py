"""Every public name is documented: what it is, each parameter, what comes back; and one role has
one name everywhere.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from waiting import PATIENCE_S

ROOT = Path(__file__).parents[2]
ROOMS = (
    "zendsp", "zendsp.link", "zendsp.recording", "zendsp.reference", "zendsp.physics",
    "zendsp.physics.effects", "zendsp.diagnosis", "zendsp.experiment", "zendsp.demo",
    "zendsp.bridge",
)
# what a role must not be called, and what it is called instead
OTHER_NAMES = {
    "dt": "sample_time",
    "ts": "sample_time",
    "fs": "rate",
    "freq": "rate",
    "filename": "path",
    "file_name": "path",
    "timeout_s": "timeout",
    "verbose": "progress",
    "random_state": "seed",
    "n_jobs": "jobs",
    "duration_s": "duration",
}


def public() -> dict[str, Any]:
    """Public objects by their full names, each once."""
    found: dict[int, tuple[str, Any]] = {}
    for room in ROOMS:
        module = importlib.import_module(room)
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isclass(value) or inspect.isfunction(value):
                found[id(value)] = (f"{value.__module__}.{value.__qualname__}", value)
    return dict(sorted(found.values(), key=lambda pair: pair[0]))


def callables() -> dict[str, Any]:
    """Public functions, and the public methods of public classes, by full name."""
    found: dict[str, Any] = {}
    for name, value in PUBLIC.items():
        if inspect.isfunction(value):
            found[name] = value
        else:
            found |= {f"{name}.{method}": function for method, function in methods(value)}
    return found


def methods(cls: type) -> Iterator[tuple[str, Any]]:
    """Public methods of a class and of its bases in zendsp."""
    for name, _ in inspect.getmembers(cls):
        raw = inspect.getattr_static(cls, name)
        function = (
            raw.__func__
            if isinstance(raw, staticmethod | classmethod)
            else raw.fget if isinstance(raw, property) else raw
        )
        if (
            not name.startswith("_")
            and inspect.isfunction(function)
            and function.__module__.startswith("zendsp")
        ):
            yield name, function


def parameters(function: Any) -> list[str]:
    """Names of the parameters that a caller gives."""
    given = inspect.signature(function).parameters.values()
    return [p.name for p in given if p.name not in ("self", "cls") and not p.name.startswith("_")]


def undocumented(function: Any) -> list[str]:
    """Parameters that the docstring does not name, neither in its list nor in its words."""
    text = inspect.getdoc(function) or ""
    return [
        p
        for p in parameters(function)
        if not re.search(rf"^\*{{0,2}}[\w, *]*\b{p}\b[\w, *]*( :|$)|``{p}``", text, re.MULTILINE)
    ]


PUBLIC = public()
CALLABLES = callables()


def test_the_walk_over_the_public_api_finds_it() -> None:
    assert len(PUBLIC) > 60
    assert len(CALLABLES) > 120
    assert "zendsp.link.connect.connect" in CALLABLES


def test_everything_public_has_a_summary() -> None:
    odd = {}
    for name, value in {**CALLABLES, **PUBLIC}.items():
        summary = (inspect.getdoc(value) or "").partition("\n\n")[0].rstrip()
        generated = dataclasses.is_dataclass(value) and summary.startswith(f"{value.__name__}(")
        if not summary or generated or summary[-1] not in ".:…)":
            odd[name] = summary
    assert odd == {}


# methods that a framework calls, and those that answer a verb: the table of verbs says what they do
CALLED = re.compile(
    r"(on|do|action)_\w+|compose|render(_lines?)?|body|ready|get_content_height"
    r"|(list|get|format)_commands?"
)


def unexplained(body: list[ast.stmt], said: dict[str, set[str]]) -> Iterator[ast.stmt]:
    """Public classes, functions and methods without a docstring; what a base of the same module
    says, by ``said``, or a protocol's line, needs none.
    """
    for node in body:
        kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if not isinstance(node, kinds) or node.name.startswith("_"):
            continue
        if not ast.get_docstring(node) and ast.unparse(node.body[-1]) != "...":
            yield node
        if isinstance(node, ast.ClassDef):
            known = set().union(*(said.get(ast.unparse(base), set()) for base in node.bases))
            for method in unexplained(node.body, said):
                name = getattr(method, "name", "")
                if name not in known and not CALLED.fullmatch(name):
                    yield method


def test_every_public_name_says_what_it_is() -> None:
    silent = []
    for package in ("host", "target", "protocol", "c_isr"):
        for path in sorted((ROOT / package).rglob("*.py")):
            body = ast.parse(path.read_text("utf-8")).body
            said = {
                node.name: {m.name for m in node.body if isinstance(m, ast.FunctionDef)}
                for node in body
                if isinstance(node, ast.ClassDef)
            }
            silent += [f"{path.relative_to(ROOT)}:{n.lineno}" for n in unexplained(body, said)]
    assert silent == []


def test_every_parameter_of_a_public_function_is_documented() -> None:
    missing = {
        name: undocumented(value)
        for name, value in PUBLIC.items()
        if inspect.isfunction(value) and undocumented(value)
    }
    assert missing == {}


def test_one_role_has_one_name() -> None:
    odd = {
        name: [p for p in parameters(value) if p in OTHER_NAMES]
        for name, value in CALLABLES.items()
    }
    assert {
        name: [f"{p} for {OTHER_NAMES[p]}" for p in found] for name, found in odd.items() if found
    } == {}


def test_a_name_imported_on_first_use_is_not_hidden_by_a_module() -> None:
    # whoever imports such a module first would find it in the place of the function
    for package in ("zendsp", "zendsp.physics", "zendsp.diagnosis"):
        room = importlib.import_module(package)
        modules = {name for _, name, _ in pkgutil.iter_modules(room.__path__)}
        assert modules & set(room._LAZY) == set(), package


def test_packages_of_zendsp_need_no_import_of_their_own() -> None:
    code = "import zendsp, sys; assert 'numpy' not in sys.modules; print(*zendsp._ROOMS)\n"
    code += "zendsp.physics.load_effects, zendsp.bridge.foxglove, zendsp.matdsp.MatDSPstart"
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    for name in done.stdout.split():
        assert importlib.util.find_spec(f"zendsp.{name}"), name


def test_a_traceback_names_an_error_as_a_user_imports_it() -> None:
    import zendsp

    with pytest.raises(zendsp.errors.ZendspError) as refused:
        zendsp.connect("nobody")
    kind = type(refused.value)
    assert getattr(importlib.import_module(kind.__module__), kind.__name__) is kind
    assert kind.__module__ == "zendsp.errors"


@pytest.mark.parametrize("room", [name for name in ROOMS if name != "zendsp.demo"])
def test_tab_completes_every_public_name(room: str) -> None:
    """Names that are imported on first use were not offered, so `zendsp.physics.` had none."""
    code = f"import {room} as room; print(*sorted(set(room.__all__) - set(dir(room))))"
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=PATIENCE_S
    )
    assert said.stdout.strip() == ""


def test_the_page_of_the_api_has_every_step_of_a_recording() -> None:
    """The one that waits for its rows was missing; the one that does not was all that stood there.
    """
    page = (ROOT / "docs" / "api.md").read_text()
    listed = re.search(r"::: zendsp\.link\.acquire\.Recorder\n.*\n +members: \[(.*?)\]", page)
    recorder = importlib.import_module("zendsp.link.acquire").Recorder
    assert listed and set(listed[1].split(", ")) == {n for n in vars(recorder) if n[0] != "_"}
