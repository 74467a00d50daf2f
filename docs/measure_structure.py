"""Print files and lines of each package, and imports between packages.

``python docs/measure_structure.py [REVISION]``
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from pathlib import PurePosixPath

SOURCES = ("host", "target", "protocol", "c_isr")


def texts(revision: str) -> dict[str, str]:
    """Every module of a revision: its dotted name, without the file where it is a package."""
    listed = subprocess.run(
        ["git", "ls-tree", "-r", "--name-only", revision, *SOURCES],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    paths = [path for path in listed if path.endswith(".py")]
    asked = "".join(f"{revision}:{path}\n" for path in paths)
    answer = subprocess.run(
        ["git", "cat-file", "--batch"], input=asked.encode(), capture_output=True, check=True
    ).stdout
    found = {}
    for path in paths:
        head, answer = answer.split(b"\n", 1)
        size = int(head.split()[2])
        parts = PurePosixPath(path).with_suffix("").parts[1:]
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = answer[:size].decode()
        answer = answer[size + 1 :]
    return found


def room(name: str, known: dict[str, str]) -> str:
    """The package that a module stands in."""
    package = any(other.startswith(name + ".") for other in known)
    return name if package else name.rpartition(".")[0]


def arrows(known: dict[str, str]) -> Counter[tuple[str, str]]:
    """Imports from room to room, each module that imports another counted once."""
    found: Counter[tuple[str, str]] = Counter()
    for name, text in known.items():
        targets = set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module in known:
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    targets.add(inner if inner in known else node.module)
        for target in targets - {name}:
            if room(target, known) != room(name, known):
                found[room(name, known), room(target, known)] += 1
    return found


def main() -> None:
    """Print the table."""
    known = texts(sys.argv[1] if len(sys.argv) > 1 else "HEAD")
    files: Counter[str] = Counter()
    lines: Counter[str] = Counter()
    for name, text in known.items():
        files[room(name, known)] += 1
        lines[room(name, known)] += text.count("\n")
    between = arrows(known)
    print("| package | files | lines | packages it imports |\n|---|---|---|---|")
    for here in sorted(files):
        out = sum(1 for (source, _) in between if source == here)
        print(f"| `{here}` | {files[here]} | {lines[here]} | {out} |")
    large = sum(count > 12 for count in files.values())
    print(
        f"| **all** | {len(known)} | {sum(lines.values())} | {len(between)} arrows;"
        f" {large} packages of more than 12 files |"
    )


if __name__ == "__main__":
    main()
