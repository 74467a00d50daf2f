"""One connection to one target. Every request ends in an answer or an error that says why not."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import zenoh

from zendsp.errors import LinkError, NoAnswer, Refused, ZendspError
from zendsp.here.registered import local_entries
from zendsp.link.background import END_S, Listener, background, open_links
from zendsp.link.repeated_requests import RepeatedRequests
from zendsp.link.session import new_author, not_there, open_session
from zendsp.link.settings import Credentials
from zendsp.link.unlike import explained
from zendsp_protocol import codec, kept, keys
from zendsp_protocol.once import AGAIN, FIRST, SETTLE, stamp
from zendsp_protocol.verbs import VERBS, Verb

_Ready = tuple[Verb, zenoh.Querier | None]
SETTLE_S = 1.0  # for the answer to how a request ended that was not answered in time
STEP_S = 0.2  # for the news of a death to arrive
AGAIN_S = 0.002  # before a request that was dropped is sent again
STOP_S = 0.7  # for the answer to STOP; after that the user must reach for another switch
FAREWELL_S = 3.0  # for a target that ends to end its program: a machine that brakes takes 1 to 2
CLOSED = "the connection to {name!r} is closed"
FORKED = "the connection to {name!r} belongs to the process that this one was forked from"
WAITING = 1024  # parts that may wait to be taken: many times what one request brings


class Link:
    """A Zenoh session with one target.

    Parameters
    ----------
    target : str
        Its name.
    endpoints : sequence of str
        Where to reach it.
    timeout : float, s
        For connecting.
    shown : bool
        Stand among the hosts of the target; a second link of the same program need not.

    Raises
    ------
    LinkError
        Nothing answers there, or no target of that name.
    """

    def __init__(
        self,
        target: str,
        endpoints: Sequence[str],
        credentials: Credentials,
        timeout: float = 3.0,
        shown: bool = True,
    ) -> None:
        self.target = target
        self.endpoints = tuple(endpoints)
        self.identity = credentials.identity
        self.own = credentials.own  # of the same user on the same computer, by the target's entry
        self.author = new_author(self.identity)
        self._repeats = RepeatedRequests()
        self._alive = threading.Event()
        self._lost = threading.Event()
        self._returned: list[Callable[[], None]] = []
        self._ready: dict[str, _Ready] = {}
        self._waiting: set[zenoh.CancellationToken] = set()
        self.closed = self._forked = False
        self.ended = False  # by itself, as it said
        self._given_up = False
        self._safe: bool | None = None  # its machine, as it said at its end
        self._farewell = threading.Event()
        self.instance = bytes(8)  # of the target that is known
        self._name = os.urandom(8)
        self._requests = itertools.count(1)
        self._session = open_session(endpoints, credentials, timeout)
        try:
            tokens = self._session.liveliness().declare_subscriber(
                keys.life(target), zenoh.handlers.FifoChannel(WAITING), history=True
            )
            self._watch = Listener(tokens, self._liveliness, "alive")
            if not self._alive.wait(timeout):
                raise LinkError(not_there(self._session, target, endpoints))
            liveliness = self._session.liveliness()
            self._token = (
                liveliness.declare_token(keys.host(target, self.author)) if shown else None
            )
            self._queriers = {lane: self._querier(lane) for lane in ("quick", "sync", "stop")}
        except BaseException:
            self._session.close()  # type: ignore[no-untyped-call]
            raise
        open_links.add(self)

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session, for subscriptions."""
        return self._session

    @property
    def alive(self) -> bool:
        """Whether the target is reachable, by its liveliness token."""
        return self._alive.is_set() and not self.closed

    def wait_alive(self, timeout: float) -> bool:
        """Wait until the target is reachable. Returns False after ``timeout`` s, or as soon as its
        process is known to have ended, or nobody waits for it any more.
        """
        deadline = time.monotonic() + timeout
        while not self._alive.wait(min(STEP_S, max(0.0, deadline - time.monotonic()))):
            if time.monotonic() >= deadline or self._given_up or self.over:
                return False
        return True

    def farewell(self, timeout: float = FAREWELL_S) -> bool | None:
        """Whether the machine of a target that has ended is in its safe state, as the target said
        at its end; None where it said nothing. One that ends is waited for, at most ``timeout`` s.
        """
        if self.ended:
            self._farewell.wait(timeout)
        return self._safe

    def give_up(self) -> None:
        """Have requests no longer wait for a lost target to come back, until it does."""
        self._given_up = not self._alive.is_set()

    @property
    def given_up(self) -> bool:
        """Whether the target is lost, and nobody waits for it any more."""
        return self._given_up

    @property
    def over(self) -> bool:
        """Whether the process of the target is known to have ended."""
        return self.ended or (
            self.own and self.target not in {entry.name for entry in local_entries()}
        )

    def on_return(self, callback: Callable[[], None]) -> None:
        """Call ``callback``, in a thread of its own, whenever the target comes back after an
        outage.
        """
        self._returned.append(callback)

    def forget(self, callback: Callable[[], None]) -> None:
        """Undo `on_return`, so that the owner of the callback can be freed."""
        with contextlib.suppress(ValueError):  # asked of another link, or forgotten already
            self._returned.remove(callback)

    def take_over(self, old: Link) -> None:
        """Take the callbacks of the link ``old``, and call them."""
        for callback in list(old._returned):
            self.on_return(callback)
            callback()

    def request(self, verb: str, arguments: Any, timeout: float | None = None) -> Any:
        """Send one request and return its result.

        Raises
        ------
        LinkError, NoAnswer
            The target is gone, or did not answer in time.
        NotApplied
            The request would have changed something, and did not.
        ZendspError
            Whatever the target says.
        """
        row, querier = self._ready.get(verb) or self._make_ready(verb)
        payload = self._repeats.encode(verb, arguments, self.author)
        number, instance = next(self._requests) if row.once else 0, self.instance
        first = stamp(self._name, number, instance, FIRST) if row.once else None
        limit = timeout or (STOP_S if row.lane == "stop" else row.timeout)
        if timeout is not None:
            querier = None  # which has a timeout of its own
        begin = time.monotonic()
        try:
            if querier is not None:
                # `_ask`, inlined: each function on the way is cold in the caches and costs several
                # times what it does in a loop
                sample = querier.get(payload=payload, attachment=first).recv().ok
            else:
                sample = self._patient(row, payload, limit, first)
        except (zenoh.ZError, LinkError):
            sample = None
        except RuntimeError:  # the querier is being undeclared: "Already mutably borrowed"
            if querier is None:
                raise
            sample = None
        again = sample is None
        if sample is None:
            sample = (
                self._again(row, payload, limit, begin, number, instance)
                if row.once
                else self._until_answered(row, querier, payload, limit, begin)
            )
        reply = sample.payload.to_bytes()
        try:
            return self._repeats.decode(reply, row.result, arguments)
        except LinkError as error:
            if again and row.once:  # a target that was started again says so in these words
                raise
            raise explained(error, self.target, row, payload, reply) from None

    def _until_answered(
        self,
        row: Verb,
        querier: zenoh.Querier | None,
        payload: bytes,
        limit: float,
        begin: float,
    ) -> zenoh.Sample:
        """The answer to a request, which is sent again until it comes: a flooded target drops some
        requests.
        """
        while not self.closed and self._alive.is_set() and time.monotonic() <= begin + limit:
            time.sleep(AGAIN_S)
            with contextlib.suppress(zenoh.ZError, LinkError):
                if querier is not None:
                    return _ask(querier, payload)
                return self._patient(row, payload, limit)
        raise self.silence(row.name, limit)

    def _again(
        self, row: Verb, payload: bytes, timeout: float, begin: float, number: int, instance: bytes
    ) -> zenoh.Sample:
        """The answer to a change that must be carried out only once. After an outage it is sent
        again, and the target recognises it by its stamp.
        """
        deadline, again = begin + timeout, stamp(self._name, number, instance, AGAIN)
        while (
            not self.closed and (left := deadline - time.monotonic()) > 0 and self.wait_alive(left)
        ):
            # news of a death, or of the lanes of a returned target, may come a moment later
            with contextlib.suppress(LinkError):
                return self._patient(row, payload, max(left, STEP_S), again)
        if not self.closed and self._alive.is_set():
            with contextlib.suppress(LinkError):
                return self._patient(
                    row, payload, SETTLE_S, stamp(self._name, number, instance, SETTLE)
                )
        error = self.silence(row.name, timeout)
        raise type(error)(
            f"{error}. Whether it was applied cannot be known from here: look at the target when it"
            " is back"
        )

    def stream(self, verb: str, arguments: Any, on_part: Callable[[bytes, bytes], None]) -> None:
        """Send a request that is answered by many parts, each with an attachment, and at the end by
        a reply without one; return that reply.

        Parameters
        ----------
        on_part : callable
            Called with ``(attachment, payload)`` of each part, in this thread.

        Raises
        ------
        LinkError, NoAnswer
            The stream broke off; the parts that came are whole.
        """
        row = self._row(verb)
        payload = codec.encode_request(verb, arguments, self.author)
        with self._replies(row, payload, row.timeout, zenoh.Priority.DATA_LOW) as replies:
            for reply in replies:
                sample = reply.ok
                if sample is None:  # its time is up
                    break
                if sample.attachment is None:
                    reply_bytes = sample.payload.to_bytes()
                    try:
                        codec.decode_reply(reply_bytes, row.result)
                    except LinkError as error:
                        raise explained(error, self.target, row, payload, reply_bytes) from None
                    return
                on_part(sample.attachment.to_bytes(), sample.payload.to_bytes())
        raise self.silence(verb, row.timeout)

    def silence(self, verb: str, timeout: float) -> LinkError:
        """The error for an answer that did not come: the target is gone, or does not answer."""
        where = ", ".join(self.endpoints)
        if self.closed:
            return LinkError(CLOSED.format(name=self.target))
        if not self._alive.is_set() or not self._still_there():
            how, why, rows = "has ended", "", ""  # by itself it leaves no rows
            if not self.ended:
                how, why, rows = "is gone", " It was killed or is cut off.", self._kept()
            return LinkError(
                f"target {self.target!r} at {where} {how}: {verb!r} was not answered.{why}"
                f" The connection comes back by itself if the target does{rows}"
            )
        return NoAnswer(
            f"target {self.target!r} at {where} did not answer {verb!r} within {timeout:g} s"
        )

    def _kept(self) -> str:
        """A sentence on where the rows are that a killed target of this computer had recorded."""
        with kept.abandoned() as folders:
            notes = [kept.read(folder) for folder in folders] if self.own else []
        if not any(note is not None and note.about.target == self.target for note in notes):
            return ""
        return (
            "; what it had recorded is kept: zendsp salvage -t"
            f" {self.target} -o FILE, or find_salvage()"
        )

    def close(self) -> None:
        """End the session; the target goes on."""
        if not self.closed:
            self.closed = True
            self._ready.clear()
            open_links.discard(self)
            if self.own and self._token is not None:
                # the target would otherwise wait for a process that still runs
                left = keys.left(self.target, self.author)
                with contextlib.suppress(zenoh.ZError):
                    self._token = self._session.liveliness().declare_token(left)
            for querier in self._queriers.values():
                # Zenoh keeps 16 kB of a session that closes with one declared.
                with contextlib.suppress(zenoh.ZError):
                    _undeclare(querier)
            self._session.close()  # type: ignore[no-untyped-call]

    def disown(self) -> None:
        """Forget the session in a child of fork(): it belongs to the parent, and its threads do not
        exist here.

        It is never freed, since freeing it would wait for these threads for ever.
        """
        import ctypes

        self.closed = self._forked = True
        for held in (self._session, self._watch, self._token, self._queriers, self._ready):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
        self._ready = {}  # a request of this process would wait for ever for these threads

    def _row(self, verb: str) -> Verb:
        if self.closed:
            raise LinkError((FORKED if self._forked else CLOSED).format(name=self.target))
        row = VERBS.get(verb)
        if row is None:
            raise Refused(f"no such request {verb!r}; there are {', '.join(VERBS)}")
        return row

    def _make_ready(self, verb: str) -> _Ready:
        """Prepare for requests of a verb: look up its row of the table and declare a querier for
        its lane.
        """
        row = self._row(verb)
        ready = row, self._queriers.get(row.lane)
        self._ready[verb] = ready
        return ready

    def _querier(self, lane: str) -> zenoh.Querier:
        stop = lane == "stop"
        return self._session.declare_querier(
            keys.rpc(self.target, lane, self.identity),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=STOP_S if stop else VERBS["status"].timeout,
            priority=zenoh.Priority.REAL_TIME if stop else zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def _patient(
        self, row: Verb, payload: bytes, timeout: float, attachment: bytes | None = None
    ) -> zenoh.Sample:
        """Wait for the reply to a request such that Ctrl-C works and the loss of the target is
        noticed; return the reply.
        """
        with self._replies(row, payload, timeout, zenoh.Priority.DATA, attachment) as replies:
            for reply in replies:
                if reply.ok is not None:  # else its time is up
                    return reply.ok
        raise self.silence(row.name, timeout)

    @contextlib.contextmanager
    def _replies(
        self,
        row: Verb,
        payload: bytes,
        timeout: float,
        priority: zenoh.Priority,
        attachment: bytes | None = None,
    ) -> Iterator[Iterable[zenoh.Reply]]:
        """Hand over replies as they come, until the last, or until the target is gone.

        This is no generator: leaving one early can make Python lose a Ctrl-C.
        """
        giving_up = zenoh.CancellationToken()
        self._waiting.add(giving_up)
        try:
            replies = self._session.get(
                keys.rpc(self.target, row.lane, self.identity),
                zenoh.handlers.FifoChannel(WAITING),
                payload=payload,
                attachment=attachment,
                # otherwise parts on the same key would replace one another
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
                priority=priority,
                cancellation_token=giving_up,
            )
            yield replies
        except zenoh.ZError as error:
            raise self.silence(row.name, timeout) from error
        finally:
            self._waiting.discard(giving_up)

    def _still_there(self) -> bool:
        """Whether the target is still there. News of its death may come a moment after its last
        answer, so this waits for it.
        """
        self._lost.wait(STEP_S)
        return self._alive.is_set()

    def _meet(self) -> None:
        """Ask which run of the target has come back. The request has a timeout, so that it is over
        when the link is closed.
        """
        with contextlib.suppress(ZendspError):
            self.instance = (
                bytes.fromhex(self.request("info", {}, VERBS["info"].timeout).instance)
                or self.instance
            )

    def _liveliness(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if key != keys.alive(self.target):  # what a target says that ends by itself
            if sample.kind == zenoh.SampleKind.PUT:
                self.ended = True
                for safe in (True, False):
                    if key == keys.farewell(self.target, safe):
                        self._safe = safe
                        self._farewell.set()
            return
        if sample.kind == zenoh.SampleKind.DELETE:
            self._alive.clear()
            self._lost.set()
            for request in list(
                self._waiting
            ):  # a router between us would leave them waiting until their time is up
                request.cancel()  # type: ignore[no-untyped-call]
            return
        again = self._lost.is_set()
        self.ended = self._given_up = False
        self._safe = None
        self._farewell.clear()
        self._lost.clear()
        self._alive.set()
        if again:
            background("returned", self._meet)
            for callback in list(self._returned):
                background("returned", callback)


def _ask(querier: zenoh.Querier, payload: bytes) -> zenoh.Sample:
    """Send a request and return its reply.

    Raises
    ------
    zenoh.ZError
        There is none, its time is up, or another thread closes the link now.
    """
    try:
        reply = querier.get(payload=payload).recv()
    except RuntimeError as error:  # it is being undeclared: "Already mutably borrowed"
        raise zenoh.ZError(str(error)) from error
    sample = reply.ok  # each look makes one
    if sample is None:
        raise zenoh.ZError("its time is up")
    return sample


def _undeclare(querier: zenoh.Querier) -> None:
    """Undeclare a querier once no other thread is sending a request with it."""
    end = time.monotonic() + END_S
    while True:
        try:
            querier.undeclare()  # type: ignore[no-untyped-call]
            return
        except RuntimeError:  # "Already borrowed"
            if time.monotonic() > end:
                return
            time.sleep(AGAIN_S)
