"""Long lines of prose, broken between words at the width of the terminal that shows them."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import TextIO

HEAD = re.compile(r"\s*(?:\w+: |\d+\. |- )?")  # "note: ", "1. ": further lines begin below


def fitted(text: str, stream: TextIO) -> str:
    """Return text for a stream: broken where that is a terminal, else as it is, so that a line of a
    pipe or a log stays one line. Columns, which have two blanks between them, are left alone.
    """
    if not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    return "\n".join(_broken(line, width) for line in text.split("\n"))


def _broken(line: str, width: int) -> str:
    if len(line) <= width or "  " in line.strip():
        return line
    head = HEAD.match(line)
    return textwrap.fill(
        line,
        width,
        subsequent_indent=" " * min(head.end() if head else 0, width // 4),
        break_long_words=False,
        break_on_hyphens=False,
    )
