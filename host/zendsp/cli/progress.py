"""Progress of commands that take more than a second: one line that changes on a terminal, nothing
in a pipe.

With ``ZENDSP_PROGRESS=lines`` each stage is a line on stderr instead, for a log or for a window
that shows a process's output.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def stages(*, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the present stage of the work.

    Parameters
    ----------
    quiet : bool
        Show nothing.

    Yields
    ------
    callable
        Takes the sentence of the stage that begins.
    """
    if not quiet and os.environ.get("ZENDSP_PROGRESS") == "lines":
        yield lambda text: print(text, file=sys.stderr, flush=True)
        return
    if quiet or not sys.stderr.isatty():
        yield lambda _text: None
        return
    from rich.console import Console

    console = Console(stderr=True)
    with console.status("starting") as status:
        yield lambda text: status.update(Timed(text))


class Timed:
    """A stage with the seconds that it has taken so far, anew in each picture."""

    def __init__(self, text: str) -> None:
        self._text, self._began = text, time.monotonic()

    def __rich__(self) -> str:
        seconds = int(time.monotonic() - self._began)
        return f"{self._text}  {seconds} s" if seconds else self._text


@contextmanager
def drawing(path: object, quiet: bool) -> Iterator[None]:
    """Say that a picture is being drawn; the first one of a process takes seconds."""
    with stages(quiet=quiet) as tell:
        tell(f"drawing {path}")
        yield
