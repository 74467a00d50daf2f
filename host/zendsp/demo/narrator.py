"""Shows the story: steps with a spinner and times on a terminal, plain lines in a pipe, nothing
where only JSON is wanted.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status


class Narrator:
    """Tells a story step by step.

    Parameters
    ----------
    quiet : bool
        Keep what is said, show nothing.

    Attributes
    ----------
    said : list of str
        Every line.

    Examples
    --------
    >>> narrator = Narrator(quiet=True)
    >>> with narrator.step("compiling"):
    ...     narrator.say("compiled in 0.2 s")
    >>> narrator.said
    ['compiled in 0.2 s']
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.said: list[str] = []
        self.begun = time.monotonic()
        self._console: Console | None = None
        self._status: Status | None = None
        if not quiet:
            from rich.console import Console

            # In a pipe rich would break lines at 80 columns; whoever reads a pipe wants them whole.
            self._console = Console(highlight=False)
            if not self._console.is_terminal:
                self._console = Console(highlight=False, soft_wrap=True)

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return time.monotonic() - self.begun

    def chapter(self, title: str) -> None:
        """Begin a part of the story."""
        if self._console is not None:
            self._console.print(
                f"\n[bold cyan]{title}[/]" if self._console.is_terminal else f"\n{title}"
            )

    def say(self, text: str, *, good: bool | None = None) -> None:
        """Say one line; ``good`` marks an outcome."""
        self.said.append(text)
        if self._console is None:
            return
        from rich.text import Text

        mark, style = {None: ("·", "dim"), True: ("✓", "bold green"), False: ("✗", "bold red")}[
            good
        ]
        line = Text(f"  {mark} ", style=style)
        line.append(text, style="" if good is None else style)
        self._console.print(line)

    @contextmanager
    def step(self, doing: str) -> Iterator[None]:
        """Show what is being done until the block ends."""
        if self._console is None or not self._console.is_terminal:
            yield
            return
        from rich.markup import escape

        with self._console.status(escape(doing)) as self._status:
            yield
        self._status = None

    def progress(self, text: str) -> None:
        """Change what the running step shows."""
        if self._status is not None:
            from rich.markup import escape

            self._status.update(escape(text))
