"""Work that a screen has begun, on a thread of its own; the screen reads its ``progress``."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from zendsp.errors import ZendspError
from zendsp.link.background import background
from zendsp.tui.port import Port

T = TypeVar("T")


@dataclass(frozen=True)
class Progress:
    """How far a job is."""

    phase: str
    share: float  # 0 … 1
    t: float = 0.0  # s since the first row
    duration: float = 0.0  # s
    why: str = ""  # it failed


class Job(Generic[T]):
    """Runs ``_do(port)`` on a thread; ``result`` is what that returns, or its error."""

    def __init__(self, session: Any, label: str) -> None:
        self.label = label
        self.progress = Progress("starting", 0.0)
        self.result: Future[T] = Future()
        self._session = session
        self._abort = threading.Event()

    def start(self) -> None:
        """Start the thread."""
        background(f"tui-{self.label}", self._run)

    def abort(self) -> None:
        """Ask it to end; it does so at its next report of progress."""
        self._abort.set()

    @property
    def busy(self) -> bool:
        """Whether it still runs."""
        return not self.result.done()

    def saved(self) -> str:
        """What a job has kept although its link was lost, as the end of a sentence."""
        return ""

    # -- on the thread

    def _do(self, port: Port) -> T:
        raise NotImplementedError

    def _run(self) -> None:
        try:
            made = self._do(self._session.require())
        except Exception as error:
            share = self.progress.share
            failure: Exception = self._session.told(
                error, lambda: f", at {100.0 * share:.0f} %{self.saved()}"
            )
            expected = isinstance(failure, ZendspError)
            word = str(failure) if expected else f"{type(failure).__name__}: {failure}"
            self._session.events.add(f"{self.label}: {word}", "error")
            self.progress = replace(self.progress, phase="failed", why=word)
            self.result.set_exception(failure)
        else:
            self.result.set_result(made)
