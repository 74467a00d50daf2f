"""STOP as the application itself does it, and the banner on how a STOP ended.

It has its own threads, which never wait for what the user asked for before. Usually another process
sees keys and clicks first, see :mod:`zendsp.tui.stopper`; this module is for the case that it is
gone.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from zendsp.errors import NotStopped
from zendsp.link.background import background
from zendsp.tui.events import EventLog
from zendsp.tui.port import Port
from zendsp.tui.snapshot import Snapshot
from zendsp.tui.stop_process import EMERGENCY, STOPPERS, Field, StopState
from zendsp.tui.stopper import Stopper

SHOWN_S = 5.0  # at the least, of the word that the machine stopped
REACTION_S = 0.3  # nobody sees that it stopped, and types, within less


@dataclass(frozen=True)
class Verdict:
    """How the last STOP ended. It is shown on every screen until it is acknowledged or no longer
    true.
    """

    state: StopState
    text: str
    time: float  # of the monotonic clock


class StopLane:
    """STOP of one terminal.

    Parameters
    ----------
    port : callable
        The open port, None where there is none.
    wake : callable
        Called when there is a new verdict.
    """

    def __init__(
        self, events: EventLog, port: Callable[[], Port | None], wake: Callable[[], object]
    ) -> None:
        self.verdict: Verdict | None = None
        self.heard = float("-inf")  # of the latest STOP, by the monotonic clock
        self.tripped = float("-inf")  # when the latest trip was told, by the same
        self.stopper: Stopper | None = None
        self._events, self._port, self._wake = events, port, wake
        self._target = ""
        self._asked: queue.SimpleQueue[Future[str] | None] = queue.SimpleQueue()
        self.threads = [background(f"tui-stop-{number}", self._run) for number in range(STOPPERS)]

    def guard_keys(self, stopper: Stopper, target: str) -> None:
        """Leave STOP to the process that reads the keys first, which does it for this target."""
        self.stopper, self._target = stopper, target
        stopper.listen(self.tell)

    def place(self, field: Field) -> None:
        """Tell where the red field of STOP is."""
        if self.stopper is not None:
            self.stopper.place(field)

    def aim(self, target: str, here: bool) -> None:
        """Make this target the one that STOP stops. ``here``: it was started here and runs on this
        computer.
        """
        if target != self._target:  # the word of how STOP ended was another target's
            self._target, self.verdict = target, None
        if self.stopper is not None:
            self.stopper.want(target, here)

    def stop(self) -> Future[str]:
        """STOP at once, from any thread, before everything that waits; the verdict tells how it
        ended.
        """
        future: Future[str] = Future()
        self._asked.put(future)
        return future

    def end(self) -> None:
        """End the threads."""
        for _ in self.threads:
            self._asked.put(None)

    def acknowledged(self) -> None:
        """Remove the banner of the last STOP."""
        self.verdict = None

    def unseen(self, typed: float) -> bool:
        """Whether a key that was typed at this time came before the latest STOP or trip was
        visible; a slow screen handles such a key later.
        """
        return typed < max(self.heard, self.tripped) + REACTION_S

    def judge(self, new: Snapshot, begin: float) -> None:
        """Correct the verdict by a snapshot that was requested at time ``begin``."""
        verdict = self.verdict
        if verdict is None or verdict.state == StopState.ASKED or begin < verdict.time:
            return
        if verdict.state == StopState.NOT_STOPPED and new.trip is not None and not new.unsafe:
            self.verdict = Verdict(StopState.STOPPED, f"stopped, at sample {new.trip.tick}", begin)
        elif (
            verdict.state == StopState.STOPPED
            and new.trip is None
            and begin > verdict.time + SHOWN_S
        ):
            self.verdict = None

    def tell(self, state: StopState, text: str, detail: str = "") -> None:
        """Show the progress of a STOP."""
        now = time.monotonic()
        self.heard = now if state == StopState.ASKED else self.heard
        self.verdict = Verdict(state, text, now)
        if state == StopState.STOPPED:
            self._events.add(f"STOP: {text}", "warning")
        elif state == StopState.NOT_STOPPED:
            self._events.add(detail, "error")
        self._wake()

    def _run(self) -> None:
        while (future := self._asked.get()) is not None:
            self.tell(StopState.ASKED, "STOP asked: no word yet that it stopped")
            port = self._port()
            try:
                if port is None:
                    raise NotStopped(f"{EMERGENCY} (there is no link to a target)")
                text = port.stop()
            except Exception as error:
                detail = str(error) if isinstance(error, NotStopped) else f"{EMERGENCY} ({error})"
                self.tell(StopState.NOT_STOPPED, EMERGENCY, detail)
                future.set_exception(error)
            else:
                self.tell(StopState.STOPPED, text)
                future.set_result(text)
