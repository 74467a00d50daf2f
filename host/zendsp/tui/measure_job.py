"""A measurement of the running machine, on a thread of its own: a frequency response, a sweep."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

from zendsp.errors import ZendspError
from zendsp.link.background import background
from zendsp.tui.play_job import Progress
from zendsp.tui.port import Port, Tell

T = TypeVar("T")


class Aborted(Exception):
    """The user ended it; the machine is as the measurement leaves it when it is interrupted."""


class MeasureJob(Generic[T]):
    """Does ``measure(port, tell)``, then ``keep(result)`` on the same thread.

    The result is that of ``keep``; None where it was aborted.
    """

    def __init__(
        self, session: Any, label: str, measure: Callable[[Port, Tell], T], keep: Callable[[T], Any]
    ) -> None:
        self.label = label
        self.progress = Progress("starting", 0.0)
        self.result: Future[Any] = Future()
        self._session, self._measure, self._keep = session, measure, keep
        self._abort = threading.Event()

    def start(self) -> None:
        """Begin."""
        background(f"tui-{self.label}", self._run)

    def abort(self) -> None:
        """End it at the next sign of progress."""
        self._abort.set()

    @property
    def busy(self) -> bool:
        """Whether it still goes on."""
        return not self.result.done()

    # -- on the thread

    def _tell(self, share: float) -> None:
        if self._abort.is_set():
            raise Aborted
        self.progress = Progress(self.label, share)

    def _run(self) -> None:
        try:
            found = self._keep(self._measure(self._session.require(), self._tell))
        except Aborted:
            self.progress = Progress("aborted", self.progress.share)
            self.result.set_result(None)
        except Exception as error:
            expected = isinstance(error, ZendspError)
            word = str(error) if expected else f"{type(error).__name__}: {error}"
            self._session.events.add(f"{self.label}: {word}", "error")
            self.progress = Progress("failed", self.progress.share)
            self.result.set_exception(error)
        else:
            self.progress = Progress("complete", 1.0)
            self.result.set_result(found)
