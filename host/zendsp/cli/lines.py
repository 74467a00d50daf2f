"""Long lines of prose, broken between words at the width of the terminal that shows them."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import TextIO

HEAD = re.compile(r"\s*(?:\w+: |\d+\. |- )?")  # "note: ", "1. ": further lines begin below
COLUMNS = re.compile(r".*\S\s{2,}(?=\S)")  # what stands before the last one
LEAST = 16  # characters, for a last column


def fitted(text: str, stream: TextIO) -> str:
    """Return text for a stream: broken where that is a terminal, else as it is, so that a line of a
    pipe or a log stays one line. Of columns, which have two blanks between them, only the last is
    broken.
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
        if below > width - LEAST:
            return line
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
