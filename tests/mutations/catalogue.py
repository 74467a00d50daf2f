"""The mutations, read from the TOML files beside this module, and the copy of the tree that they
are applied to.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FIELDS = ("name", "lost", "file", "old", "new", "tests")


class Stale(Exception):
    """The code or the tests have moved on: the entry has to be written again."""


@dataclass(frozen=True)
class Mutation:
    """One promise, and the change that breaks it.

    Attributes
    ----------
    name, topic : str
        The topic is the stem of the file that it stands in.
    lost : str
        The promise.
    file : str
        Path within the tree.
    old, new : str
        Text that stands in the file exactly once, and what takes its place.
    tests : tuple of str
        Node ids of pytest; a function, or one case of it in brackets.
    """

    name: str
    topic: str
    lost: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def mutated(self, root: Path) -> str:
        """Return the file as it is with the change.

        Raises
        ------
        Stale
            The old text is not there, or there more than once.
        """
        path = root / self.file
        if not path.is_file():
            raise Stale(f"{self.name}: there is no {self.file}")
        text = path.read_text()
        found = text.count(self.old)
        if found != 1:
            raise Stale(
                f"{self.name}: stands {found} times in {self.file}, expected once: {self.old!r}"
            )
        return text.replace(self.old, self.new)

    def check_tests(self, root: Path) -> None:
        """Raise `Stale` where a test that is named does not exist."""
        if not self.tests:
            raise Stale(f"{self.name}: names no test")
        for test in self.tests:
            file, _, function = test.partition("::")
            path = root / file
            names = _functions(path) if path.is_file() else set()
            if function.partition("[")[0] not in names:
                raise Stale(f"{self.name}: there is no test {test}")

    @contextmanager
    def applied(self, root: Path) -> Iterator[None]:
        """Apply the change to a copy of the tree, and take it back."""
        path = root / self.file
        before, after = path.read_text(), self.mutated(root)
        path.write_text(after)
        try:
            yield
        finally:
            path.write_text(before)


def _functions(path: Path) -> set[str]:
    nodes = ast.walk(ast.parse(path.read_text()))
    return {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}


def catalogue(folder: Path = HERE) -> list[Mutation]:
    """Return all mutations, by topic.

    Raises
    ------
    Stale
        An entry lacks a field, has one too many, or a name stands twice.
    """
    found: list[Mutation] = []
    for path in sorted(folder.glob("*.toml")):
        for entry in tomllib.loads(path.read_text())["mutation"]:
            if set(entry) != set(FIELDS):
                raise Stale(
                    f"{path.name}: {entry.get('name', '?')} needs the fields {', '.join(FIELDS)}"
                )
            if any(entry["name"] == other.name for other in found):
                raise Stale(f"{path.name}: {entry['name']} stands twice")
            found.append(Mutation(topic=path.stem, **{**entry, "tests": tuple(entry["tests"])}))
    return found


def chosen(mutations: Sequence[Mutation], words: Sequence[str]) -> list[Mutation]:
    """Return those that have one of the words in their name or topic; all, without words."""
    return [m for m in mutations if not words or any(w in m.name or w == m.topic for w in words)]


def copy_tree(root: Path, to: Path) -> Path:
    """Copy what git knows of the tree, and new files that it does not ignore, as they are now."""
    listing = [
        "git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard",
    ]
    names = subprocess.run(listing, capture_output=True, check=True).stdout.decode().split("\0")
    for name in filter(None, names):
        source, place = root / name, to / name
        if source.is_file():
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, place)
    return to
