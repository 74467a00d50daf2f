"""Wraps long lines of text at the width of the terminal."""

from __future__ import annotations

import codecs
import io
import re
import shutil
import textwrap
from typing import TextIO

HEAD = re.compile(r"\s*(?:\w+: |\d+\. |- )?")  # "note: ", "1. ": further lines begin below
COLUMNS = re.compile(r".*\S\s{2,}(?=\S)")  # what stands before the last one
LEAST = 16  # characters, for a last column
BELOW = "    "  # a last column for which there are fewer
# for what a stream that is not UTF-8 may lack
STAND_INS = {
    "✔": "+", "✓": "+", "✖": "-", "✗": "-", "–": "-", "−": "-", "…": "...", "·": "-", "→": "->",
    "█": "#", "±": "+-", "µ": "u", "²": "^2", "³": "^3", "°": "deg",
}  # fmt: skip


def write_anywhere(stream: TextIO) -> None:
    """Have a stream replace a character that its encoding lacks, such as ✔ in Latin-1, instead of
    failing.
    """
    codecs.register_error("zendsp", _stood_in)
    if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
        stream.reconfigure(errors="zendsp")


def _stood_in(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(STAND_INS.get(character, "?") for character in lacking), error.end


def fitted(text: str, stream: TextIO) -> str:
    """The text for a stream: wrapped for a terminal; unchanged for a pipe or a log. Of columns,
    which are separated by two blanks, only the last is wrapped; words that have no room beside the
    others stand below them.
    """
    if not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    return "\n".join(_broken(line, width) for line in text.split("\n"))


def _broken(line: str, width: int) -> str:
    if len(line) <= width:
        return line
    if columns := COLUMNS.match(line):
        below = columns.end()
        if below > width - LEAST:  # words stand on a line of their own; a number stays in its row
            if " " not in line[below:]:
                return line
            return f"{line[:below].rstrip()}\n{_broken(BELOW + line[below:], width)}"
    else:
        head = HEAD.match(line)
        below = min(head.end() if head else 0, width // 4)
    return textwrap.fill(
        line,
        width,
        subsequent_indent=" " * below,
        break_long_words=False,
        break_on_hyphens=False,
    )
