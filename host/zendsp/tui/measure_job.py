"""A measurement of the running machine, on a thread of its own: a frequency response or a sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from zendsp.tui.job import Job, Progress
from zendsp.tui.port import Port, Tell


class Aborted(Exception):
    """The user ended it; the machine is in the state in which an interrupted measurement leaves it.
    """


class MeasureJob(Job[Any]):
    """Runs ``measure(port, tell)``, then ``keep(result)`` on the same thread.

    The result is what ``keep`` returns. An aborted measurement has none, unless it has put what was
    measured so far into ``reached``. Where it failed, ``left`` is what ``keep`` returned for that
    part.
    """

    def __init__(
        self,
        session: Any,
        label: str,
        measure: Callable[[Port, Tell], Any],
        keep: Callable[[Any], Any],
    ) -> None:
        super().__init__(session, label)
        self._measure, self._keep = measure, keep
        self.reached: Any = None
        self.left: Any = None

    def saved(self) -> str:
        """A sentence on what was measured before a failure; empty where that is nothing."""
        return "" if self.left is None else "; what was measured until then is kept"

    def _tell(self, share: float) -> None:
        if self._abort.is_set():
            raise Aborted
        self.progress = Progress(self.label, share)

    def _do(self, port: Port) -> Any:
        try:
            kept = self._keep(self._measure(port, self._tell))
        except Aborted:
            self.progress = replace(self.progress, phase="aborted")
            return None if self.reached is None else self._keep(self.reached)
        except Exception:
            self.left = None if self.reached is None else self._keep(self.reached)
            raise
        self.progress = Progress("complete", 1.0)
        return kept
