"""Progress for commands of more than a second: one live line on a terminal, nothing in a pipe.

``ZENDSP_PROGRESS=lines`` asks for a line on stderr at each stage instead: for a log, or a window
that shows what a process says.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def stages(*, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """A function that shows what is being done.

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
        yield lambda text: status.update(text)


@contextmanager
def drawing(path: object, quiet: bool) -> Iterator[None]:
    """Say that a picture is drawn: the first of a process takes seconds."""
    with stages(quiet=quiet) as tell:
        tell(f"drawing {path}")
        yield
