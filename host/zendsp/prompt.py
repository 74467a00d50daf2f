"""Progress at a prompt and in a notebook, of what takes more than a second."""

from __future__ import annotations

import functools
import sys
import threading
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, ParamSpec, TypeVar

    P = ParamSpec("P")
    R = TypeVar("R")

WIDTH = 79  # columns
BAR = 30  # columns of it
SHORT_S = 1.0  # what takes no longer shows nothing
EVERY_S = 0.1


def shows_progress(work: Callable[P, R]) -> Callable[P, R]:
    """Let ``work``, where nobody gave it a ``progress``, show a line of it where a person types.

    That is at a prompt and in a notebook, in the main thread; a script sees nothing. What is told
    is a fraction from 0 to 1, or a sentence.
    """

    @functools.wraps(work)
    def shown(*args: P.args, **kwargs: P.kwargs) -> R:
        if not hasattr(sys, "ps1") or threading.current_thread() is not threading.main_thread():
            return work(*args, **kwargs)
        import inspect

        asked = inspect.signature(work).bind_partial(*args, **kwargs)
        if asked.arguments.get("progress") is not None:
            return work(*args, **kwargs)
        line = _Line()
        asked.arguments["progress"] = line.tell
        try:
            return work(*asked.args, **asked.kwargs)
        finally:
            line.end()

    return shown


class _Line:
    """One line that is written over, and taken away at the end."""

    def __init__(self) -> None:
        self._begun = self._drawn = time.monotonic()
        self._there = False
        self._handle: Any = None  # of a notebook's output

    def tell(self, done: float | str) -> None:
        """Show a sentence; a fraction not at once, and not too often."""
        now = time.monotonic()
        if not isinstance(done, str):
            if now - self._begun < SHORT_S or now - self._drawn < EVERY_S:
                return
            full = round(BAR * min(1.0, max(0.0, done)))
            done = f"{'█' * full}{'░' * (BAR - full)} {100 * done:3.0f} %"
        self._drawn, self._there = now, True
        self._write(f"{done[:WIDTH]:{WIDTH}}")

    def end(self) -> None:
        """Take the line away."""
        if self._there:
            self._write("")

    def _write(self, text: str) -> None:
        shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
        if not hasattr(shell, "kernel"):
            print(f"\r{text}" if text else f"\r{'':{WIDTH}}\r", end="", flush=True)
        elif self._handle is None:
            from IPython.display import display

            data = {"text/plain": text}
            self._handle = display(data, raw=True, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._handle.update({"text/plain": text}, raw=True)
