"""What the pages tell a reader to type: their blocks and commands, in order."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
_COMMAND = re.compile(r"(?:[A-Z][A-Z_]*=\S+ )*(?:zendsp|python3?|pip|\.venv/bin/\S+)(?: |$)")
_INLINE = re.compile(r"`([^`\n]+)`")
_PYTHON = re.compile(r"(?:import|from) \w+")


@dataclass(frozen=True)
class Block:
    """A block of a page.

    Attributes
    ----------
    page : str
        Path within the repository.
    line : int
        Of its first line.
    kind : str
        ``"command"``: one command of a shell. ``"python"``. Otherwise the language of its fence, or
        ``"text"``.
    text : str
    """

    page: str
    line: int
    kind: str
    text: str

    @property
    def first(self) -> str:
        """Its first line that is not empty."""
        return next(line.strip() for line in self.text.splitlines() if line.strip())


def blocks(page: Path) -> list[Block]:
    """Return commands and blocks of a page in its order; a chain of `&&` is several commands.

    A command in running text counts when it says more than a subcommand's name, which is a mention
    (tests/whole/test_readme.py).
    """
    name = str(page.relative_to(ROOT))
    found: list[Block] = []
    for line, kind, text in _pieces(page.read_text().splitlines()):
        if kind == "prose":
            for match in _INLINE.finditer(text):
                words = match[1].split()
                if (
                    _COMMAND.match(match[1])
                    and len([w for w in words if "=" not in w or not w[0].isupper()]) > 2
                ):
                    found.append(Block(name, line, "command", match[1]))
        elif kind in ("text", "sh", "console") and all(
            _COMMAND.match(row) for row in text.splitlines()
        ):
            for number, row in enumerate(text.splitlines()):
                for part in re.split(r" && ", re.sub(r"\s+#.*", "", row)):
                    found.append(Block(name, line + number, "command", part.strip()))
        else:
            found.append(
                Block(
                    name, line, "python" if kind == "text" and _PYTHON.match(text) else kind, text
                )
            )
    return found


def _pieces(lines: list[str]) -> Iterator[tuple[int, str, str]]:
    """Line number, kind and text: ``prose`` line by line, fenced blocks by their language, indented
    ones as ``text``.
    """
    at = 0
    while at < len(lines):
        line = lines[at]
        fence = re.match(r"^```(\w*)", line)
        begin = at
        if fence:
            at += 1
            while at < len(lines) and not lines[at].startswith("```"):
                at += 1
            yield begin + 2, fence[1] or "text", "\n".join(lines[begin + 1 : at])
            at += 1
        elif line.startswith("    ") and (at == 0 or not lines[at - 1].strip()):
            while at < len(lines) and (lines[at].startswith("    ") or not lines[at].strip()):
                at += 1
            yield begin + 1, "text", "\n".join(row[4:] for row in lines[begin:at]).strip("\n")
        else:
            yield at + 1, "prose", line
            at += 1
