"""Print files and lines of each package, imports between packages, circles of modules, and lines by
what they are for.

``python docs/measure_structure.py [REVISION]``
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import PurePosixPath

SOURCES = ("host", "target", "protocol", "c_isr")
SUFFIXES = (".py", ".c", ".h", ".toml", ".tcss", ".md")
# what lines are for, by how the path begins
PARTS = {
    "source": tuple(f"{source}/" for source in SOURCES),
    "tests": ("tests/",),
    "benchmarks": ("benchmarks/",),
    "docs, README, CONTRIBUTING": ("docs/", "README.md", "CONTRIBUTING.md"),
    "changelog": ("CHANGELOG.md",),
}


def files(revision: str) -> dict[str, str]:
    """Every text of a revision, by its path."""
    listed = subprocess.run(
        ["git", "ls-tree", "-r", "--name-only", revision],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    paths = [path for path in listed if path.endswith(SUFFIXES)]
    asked = "".join(f"{revision}:{path}\n" for path in paths)
    answer = subprocess.run(
        ["git", "cat-file", "--batch"], input=asked.encode(), capture_output=True, check=True
    ).stdout
    found = {}
    for path in paths:
        head, answer = answer.split(b"\n", 1)
        size = int(head.split()[2])
        found[path] = answer[:size].decode()
        answer = answer[size + 1 :]
    return found


def modules(texts: dict[str, str]) -> dict[str, str]:
    """Every module: its dotted name, without the file where it is a package."""
    found = {}
    for path, text in texts.items():
        if path.startswith(PARTS["source"]) and path.endswith(".py"):
            parts = PurePosixPath(path).with_suffix("").parts[1:]
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = text
    return found


def room(name: str, known: dict[str, str]) -> str:
    """The package that a module stands in."""
    package = any(other.startswith(name + ".") for other in known)
    return name if package else name.rpartition(".")[0]


def imports(name: str, known: dict[str, str]) -> set[str]:
    """Modules that a module imports, anywhere in it."""
    targets = set()
    for node in ast.walk(ast.parse(known[name])):
        if isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                targets.add(inner if inner in known else node.module)
    return targets - {name}


def circle(graph: dict[str, set[str]]) -> str:
    """A circle of modules that import one another; "none" where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return " → ".join(reversed(error.args[1]))
    return "none"


def main() -> None:
    """Print the tables."""
    texts = files(sys.argv[1] if len(sys.argv) > 1 else "HEAD")
    known = modules(texts)
    graph = {name: imports(name, known) for name in known}
    between = {
        (room(name, known), room(target, known)) for name in graph for target in graph[name]
    }
    between = {(source, target) for source, target in between if source != target}
    rooms: Counter[str] = Counter(room(name, known) for name in known)
    lines: Counter[str] = Counter()
    for name, text in known.items():
        lines[room(name, known)] += text.count("\n")
    print("| package | files | lines | packages it imports |\n|---|---|---|---|")
    for here in sorted(rooms):
        out = sum(source == here for source, _ in between)
        print(f"| `{here}` | {rooms[here]} | {lines[here]} | {out} |")
    large = sum(count > 12 for count in rooms.values())
    print(
        f"| **all {len(rooms)}** | {len(known)} | {sum(lines.values())} | {len(between)} arrows;"
        f" {large} packages of more than 12 files |"
    )
    print(f"\ncircles of modules: {circle(graph)}\n\n| | lines |\n|---|---|")
    for part, begins in PARTS.items():
        count = sum(text.count("\n") for path, text in texts.items() if path.startswith(begins))
        print(f"| {part} | {count} |")


if __name__ == "__main__":
    main()
