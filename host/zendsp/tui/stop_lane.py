"""STOP as the terminal application does it itself, and the last word on how one ended.

It has threads to itself, which never stand behind what the user asked before. Keys and clicks are
seen by a process of their own, see :mod:`zendsp.tui.stopper`; this here is for where it is gone.
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
    """How the last STOP ended, shown on every screen until it is acknowledged or no longer so."""

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

    def guard_keys(self, target: str, here: bool) -> None:
        """From now on a process of its own reads the keys first and does STOP, of this target."""
        self.stopper = Stopper(self.tell)
        self.aim(target, here)

    def release_keys(self) -> None:
        """End the process that reads the keys."""
        if self.stopper is not None:
            self.stopper.close()

    def place(self, field: Field) -> None:
        """Say where the red field of STOP is."""
        if self.stopper is not None:
            self.stopper.place(field)

    def aim(self, target: str, here: bool) -> None:
        """STOP is for this target from now on; ``here``: on this computer, for it was started
        here.
        """
        if target != self._target:  # the word of how STOP ended was another target's
            self._target, self.verdict = target, None
        if self.stopper is not None:
            self.stopper.want(target, here)

    def stop(self) -> Future[str]:
        """STOP: at once, from any thread, past everything that waits; the verdict tells how it
        ended.
        """
        future: Future[str] = Future()
        self._asked.put(future)
        return future

    def end(self) -> None:
        """Have the threads end."""
        for _ in self.threads:
            self._asked.put(None)

    def acknowledged(self) -> None:
        """Take the word about the last STOP away."""
        self.verdict = None

    def unseen(self, typed: float) -> bool:
        """Whether what was typed at a time was typed before anybody saw the latest STOP or trip: a
        slow screen handles it later.
        """
        return typed < max(self.heard, self.tripped) + REACTION_S

    def judge(self, new: Snapshot, begin: float) -> None:
        """Correct the verdict by a snapshot that was asked for at ``begin``."""
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
        """Show how far a STOP is."""
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
