"""Talks to the target from its own threads and keeps the newest snapshot, which is all that screens
read.

There are three threads, so that nothing waits for something slower: the poller takes snapshots and
reconnects, the worker does what the user asked for, in order, and STOP
(:mod:`zendsp.tui.stop_lane`) waits for neither.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any, TypeVar

from zendsp.errors import LinkError, Refused, ZendspError
from zendsp.link.background import background
from zendsp.tui.events import EventLog
from zendsp.tui.port import Port
from zendsp.tui.scope import Channel, History
from zendsp.tui.scope.formula import Computed
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp.tui.stop_lane import StopLane
from zendsp_protocol.states import LATCHED, ProgramState

T = TypeVar("T")
POLL_S = 0.1  # between snapshots
RETRY_S = 0.4  # between attempts to reconnect
A_MOMENT_S = 0.5  # longer, and it is told what others wait for
END_S = 3.0  # for all threads to end
SILENCE_S = 3.0  # of curves while the program runs, after which they are asked for again


class NoLink(LinkError):
    """No target is connected at the moment."""


class Session:
    """The link of one terminal to one target.

    Parameters
    ----------
    open_port : callable
        ``open_port(name) -> Port``; raises :class:`LinkError` where nothing answers.
    """

    def __init__(self, open_port: Callable[[str], Port]) -> None:
        self.events = EventLog()
        self.snapshot = Snapshot()
        self.channels: tuple[Channel, ...] = ()
        self.history = History(0)
        self._open = open_port
        self._port: Port | None = None
        self._left: Port | None = None  # whose link was lost
        self._name = ""
        self._wake = threading.Event()
        self._closing = threading.Event()
        self._jobs: queue.Queue[tuple[Future[Any], str, Callable[[Port], Any], float] | None] = (
            queue.Queue()
        )
        self._doing: tuple[str, float] | None = None  # what the worker does, and since when
        # before when, s, what was asked is not done any more, and since what happened
        self._void = (0.0, "")
        self._live: Callable[[], None] | None = None
        self._live_wanted = False
        self._heard = (0, 0, 0.0)  # rows of the history, tick and time when a row last came
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self.stops = StopLane(self.events, lambda: self._port, self._wake.set)

    # -- life

    def start(self) -> None:
        """Start the threads."""
        self._threads = [background("tui-poller", self._poll), background("tui-worker", self._work)]

    def close(self) -> None:
        """Leave the target as it is and end the threads."""
        self._closing.set()
        self._wake.set()
        self._jobs.put(None)
        self.stops.end()
        deadline = time.monotonic() + END_S
        for thread in (*self._threads, *self.stops.threads):
            thread.join(max(0.0, deadline - time.monotonic()))
        self._drop()

    def connect(self, name: str) -> None:
        """Talk to another target from now on. Returns at once; the snapshot tells whether it
        succeeded.
        """
        self._drop()
        with self._lock:
            self._name = name
        self.snapshot = Snapshot(link=LinkState.CONNECTING, target=name)
        self.stops.aim(name, here=False)
        self._wake.set()

    def tell_found(self, names: Sequence[str]) -> None:
        """Show which targets answer, while none is connected."""
        if self.snapshot.link == LinkState.NONE:
            self.snapshot = replace(self.snapshot, here=tuple(names))

    def await_start(self, machine: str) -> None:
        """Show that a machine is being started here; "": that none is."""
        if self._port is None:
            link = LinkState.STARTING if machine else LinkState.NONE
            self.snapshot = Snapshot(link=link, target=machine)

    def adopt(self, port: Port, name: str) -> None:
        """Talk to a target that is already open, for example one that was started here."""
        self._drop()
        with self._lock:
            self._name, self._port = name, port
        self.stops.aim(name, port.here)
        self._live_wanted = bool(self.channels)
        self._wake.set()

    # -- what the user asks

    def do(self, label: str, job: Callable[[Port], T]) -> Future[T]:
        """Run a job against the target on the worker's thread, after those asked for before.

        A failure becomes an event and the error of the future. So does a cancellation before its
        turn: by a STOP, by a pause, or because a job that it waited for has failed.
        """
        future: Future[T] = Future()
        if busy := self.busy:
            self.events.add(f"{label}: waits until {busy} is done; Pause or STOP ends both", "info")
        self._jobs.put((future, label, job, time.monotonic()))
        return future

    @property
    def busy(self) -> str:
        """What the worker is doing, once it takes longer than a moment."""
        doing = self._doing
        return doing[0] if doing and time.monotonic() - doing[1] > A_MOMENT_S else ""

    def do_first(self, label: str, job: Callable[[Port], T]) -> Future[T]:
        """Run a job at once and drop those that wait: a pause, for example, ends a homing."""
        self._void = (time.monotonic(), f"{label} came")
        return self.do_beside(label, job)

    def do_beside(self, label: str, job: Callable[[Port], T]) -> Future[T]:
        """Run a long job on a thread of its own; the worker goes on with others."""
        future: Future[T] = Future()
        background(f"tui-{label}", self._run, future, label, job, time.monotonic())
        return future

    @property
    def port(self) -> Port | None:
        """The open port, None where there is none."""
        return self._port

    def require(self) -> Port:
        """The open port; raises LinkError where there is none."""
        port = self._port
        if port is None:
            lost = self.snapshot.link == LinkState.LOST
            which = f"the link to {self.snapshot.target} is lost, and not back yet" if lost else ""
            raise NoLink(f"{which or 'there is no link to a target'}: Ctrl+O connects")
        return port

    def told(self, error: Exception, more: Callable[[], str] = str) -> Exception:
        """The error of a job as it is shown. If the link was lost meanwhile, the status bar shows
        that already, so an error about the closed connection is replaced, and ``more`` is said.
        """
        if not isinstance(error, LinkError) or isinstance(error, NoLink):
            return error
        deadline = time.monotonic() + A_MOMENT_S  # the poller may not have seen it yet
        while self.snapshot.link == LinkState.UP and time.monotonic() < deadline:
            self._wake.set()
            time.sleep(POLL_S / 5)
        if self.snapshot.link in (LinkState.LOST, LinkState.ENDED):
            return LinkError(f"the link was lost before it was done{more()}")
        return error

    def watch(self, channels: Sequence[Channel], history: History | None = None) -> History:
        """Follow these signals live and no others; return the history that they fill, a new one
        unless given.
        """
        with self._lock:
            self.channels = tuple(channels)
            self.history = History(len(self.channels)) if history is None else history
            self._live_wanted = True
        self._wake.set()
        return self.history

    # -- the poller

    def _poll(self) -> None:
        while not self._closing.is_set():
            port, name = self._port, self._name
            pause = POLL_S
            if port is not None:
                try:
                    begin = time.monotonic()
                    snapshot = port.snapshot()
                    if self._live_wanted and snapshot.state != ProgramState.EMPTY:
                        self._follow(port)
                    if self._port is port:
                        if self.snapshot.link == LinkState.LOST:
                            self.events.add(f"link to {name} is back", "good")
                        self.stops.judge(snapshot, begin)
                        known = snapshot.target or name
                        self._take(replace(snapshot, link=LinkState.UP, target=known))
                        self._listen(snapshot)
                except LinkError as error:
                    self._lost(port, str(error))
                    pause = RETRY_S
                except ZendspError as error:
                    self.events.add(f"status: {error}", "error")
                    pause = 5 * POLL_S
                except Exception as error:
                    # a screen that stays alive beats a thread that died unseen
                    self.events.add(f"status: {type(error).__name__}: {error}", "error")
                    pause = 10 * POLL_S
            elif name:
                pause = RETRY_S
                self._connect(name)
            self._wake.wait(pause)
            self._wake.clear()

    def _take(self, new: Snapshot) -> None:
        """Keep a snapshot and put its changes of state into the event log."""
        old, self.snapshot = self.snapshot, new
        if new.trip is not None and (new.trip != old.trip or old.link != LinkState.UP):
            self.stops.tripped = time.monotonic()
            self.events.add(f"trip at sample {new.trip.tick}: {new.trip.text}", "error")
        if old.link != LinkState.UP:
            return
        if new.state != old.state:
            self.events.add(
                f"program {old.state or '—'} → {new.state}",
                "good" if new.state == ProgramState.RUNNING else "info",
            )
        if new.drive != old.drive:
            bad = new.drive in LATCHED
            self.events.add(
                f"drives {old.drive or '—'} → {new.drive}", "warning" if bad else "info"
            )
        if new.crash != old.crash and new.crash:
            self.events.add(f"crash: {new.crash}", "error")
        for sentence in set(new.own) - set(old.own):
            self.events.add(sentence, "warning")
        if new.commander != old.commander:
            self.events.add(f"command right: {'you' if new.mine else new.commander or 'nobody'}")
        if new.program != old.program:
            self._live_wanted = bool(self.channels)

    def _listen(self, snapshot: Snapshot) -> None:
        """Subscribe again to curves for which no rows arrive though they should."""
        count, tick, since = self._heard
        now = time.monotonic()
        if (
            self.history.count != count
            or snapshot.state != ProgramState.RUNNING
            or snapshot.tick == tick
            or not self.channels
        ):
            self._heard = (self.history.count, snapshot.tick, now)
        elif now - since > SILENCE_S:
            self._heard = (count, tick, now)
            self._live_wanted = True

    def _connect(self, name: str) -> None:
        lost = self.snapshot.link == LinkState.LOST
        try:
            port = self._open(name)
        except ZendspError as error:
            if not lost and self.snapshot.link != LinkState.CONNECTING:
                self.snapshot = Snapshot(link=LinkState.CONNECTING, target=name)
            gone = self._left is not None and self._left.over
            self.snapshot = replace(self.snapshot, complaint=str(error), gone=gone)
            self._complain(str(error))
            return
        with self._lock:
            if name != self._name:
                port.close()
                return
            self._port = port
        self._complaint = ""
        self.stops.aim(name, here=False)
        self._live_wanted = bool(self.channels)
        if not lost:  # else its first snapshot says so
            self.events.add(f"link to {name} is up", "good")
        self._wake.set()

    _complaint = ""

    def _complain(self, text: str) -> None:
        """Log a failure to connect once, not at each attempt."""
        if text != self._complaint:
            self._complaint = text
            self.events.add(text, "warning")

    def _lost(self, port: Port, why: str) -> None:
        """Show the loss. The port of a target that was started here is kept, since the target would
        end with it; its link comes back by itself, unless its process has ended.
        """
        ended = port.here and port.over
        with self._lock:
            if self._port is not port:
                return
            if ended or not port.here:
                self._port, self._live, self._left = None, None, port
            if ended:
                self._name = ""
        if self.snapshot.link != LinkState.LOST:
            self.events.add(f"link lost: {why}", "error")
        self.snapshot = replace(
            self.snapshot,
            link=LinkState.ENDED if ended else LinkState.LOST,
            latency_s=float("nan"),
            recording=False, gone=port.over, safe=None,
        )
        if ended or not port.here:
            background("tui-close", self._part, port)

    def _part(self, port: Port) -> None:
        """Show what a target that ends says of its machine, and close the link to it."""
        safe = port.farewell()
        shown = self._left is port and self.snapshot.link in (LinkState.LOST, LinkState.ENDED)
        if safe is not None and shown:
            self.snapshot = replace(self.snapshot, gone=True, safe=safe)
            words = "is in its safe state" if safe else "is NOT in its safe state"
            said = f"{self.snapshot.target} has ended; as it said, its machine {words}"
            self.events.add(said, "info" if safe else "error")
        _close_quietly(port)

    def _drop(self) -> None:
        with self._lock:
            port, self._port, self._name = self._port, None, ""
        self._live = None
        if port is not None:
            _close_quietly(port)

    def _follow(self, port: Port) -> None:
        """Subscribe to the wanted channels. Signals that the program lacks are left out and logged.
        """
        with self._lock:
            self._live_wanted = False
            channels, history = self.channels, self.history
        if self._live is not None:
            self._live()
            self._live = None
        if not channels:
            return
        try:
            if any(c.formula for c in channels):
                computed = Computed(channels, history.append)
                self._live = port.live(computed.sources, computed)
            else:
                self._live = port.live([c.name for c in channels], history.append)
        except LinkError:
            raise
        except ZendspError as error:
            self.events.add(f"scope: {error}", "warning")

    # -- the worker

    def _work(self) -> None:
        while True:
            item = self._jobs.get()
            if item is None or self._closing.is_set():
                return
            future, label, _job, asked = item
            before, why = self._void
            if self.stops.heard <= asked < before:
                self._refuse(future, label, why)
                continue
            self._doing = (label, time.monotonic())
            self._run(*item)
            self._doing = None
            if future.exception() is not None:
                self._void = (time.monotonic(), f"{label} failed")

    def _refuse(self, future: Future[T], label: str, why: str) -> None:
        error = Refused(f"not done, since {why} after it was asked: ask again")
        self.events.add(f"{label}: {error}", "error")
        future.set_exception(error)

    def _run(
        self, future: Future[T], label: str, job: Callable[[Port], T], asked: float
    ) -> None:
        try:
            port = self.require()
            if asked < self.stops.heard:
                self._refuse(future, label, "STOP came")
                return
            future.set_result(job(port))
        except ZendspError as error:
            self.events.add(f"{label}: {self.told(error)}", "error")
            future.set_exception(self.told(error))
        except Exception as error:
            self.events.add(f"{label}: {type(error).__name__}: {error}", "error")
            future.set_exception(error)
        self._wake.set()


def _close_quietly(port: Port) -> None:
    try:
        port.close()
    except Exception:  # the link is gone anyway; nothing is left to be told
        return
