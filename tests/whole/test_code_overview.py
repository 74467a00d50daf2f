"""The pages name source files and functions that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("host", "target", "protocol", "c_isr", "benchmarks", "docs", "tests", "examples")
PAGE = (ROOT / "docs" / "code_overview.md").read_text(encoding="utf-8")
FILES = {
    path.relative_to(ROOT).as_posix(): path
    for folder in FOLDERS
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".c", ".h")
}


def called(name: str) -> list[Path]:
    """The files that a name on the page may mean: its path, or the end of it."""
    return [path for whole, path in FILES.items() if f"/{whole}".endswith(f"/{name}")]


def test_every_file_of_the_map_is_there() -> None:
    names = set(re.findall(r"`([\w./]+\.(?:py|c|h))`", PAGE))
    assert len(names) > 50
    assert [name for name in sorted(names) if not called(name)] == []


def test_every_source_file_that_a_page_names_is_there() -> None:
    lost = []
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text("utf-8")
        written = {"compensation.c", "report/compensation.c"}  # by a diagnosis
        written |= set(re.findall(r"\bas\s`([\w.]+)`", text))  # "save it as `play.py`"
        named = set(re.findall(r"`(?:\.\./)?([\w./]+\.(?:py|c|h))`", text))
        lost += [f"{page.name}: {name}" for name in named - written if not called(name)]
    assert lost == []


def test_every_function_of_the_map_stands_in_the_file_beside_it() -> None:
    beside = re.findall(r"`([\w.]+)`(?: \([^)]*\))?\s(?:in|of)\s`([\w./]+\.(?:py|c|h))`", PAGE)
    beside += [(b, a) for a, b in re.findall(r"`([\w./]+\.(?:py|c|h))`, `([\w.]+)`", PAGE)]
    beside = [(name, file) for name, file in beside if not name.endswith((".py", ".c", ".h"))]
    assert len(beside) > 15
    lost = [
        f"{name} in {file}"
        for name, file in beside
        if not any(
            all(re.search(rf"\b{part}\b", path.read_text()) for part in name.split("."))
            for path in called(file)
        )
    ]
    assert lost == []


def test_every_method_of_the_map_is_one_of_its_class() -> None:
    methods = re.findall(r"`([A-Z]\w+)\.(\w+)`", PAGE)
    assert len(methods) > 3
    texts = [path.read_text() for path in FILES.values() if path.suffix == ".py"]
    assert [
        f"{kind}.{name}"
        for kind, name in methods
        if not any(re.search(rf"class {kind}\b[\s\S]*def {name}\(", text) for text in texts)
    ] == []
