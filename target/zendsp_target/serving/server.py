"""The Zenoh side of the target: the keys that it answers, what it publishes, and the tokens that
show that it is alive.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec
import zenoh

from zendsp_protocol import codec, keys, verbs
from zendsp_protocol.errors import LinkError
from zendsp_protocol.version import PROTOCOL
from zendsp_target.access.admission import Doors, check_role, may
from zendsp_target.access.hosts import Hosts
from zendsp_target.access.lingering import close_at_once
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.lanes import THREADS, Lane, Requests
from zendsp_target.serving.live_streams import LiveStreams
from zendsp_target.serving.service import Identity, Service
from zendsp_target.serving.turns import WAITING, Turns
from zendsp_target.threads import start_thread

log = logging.getLogger(__name__)

JOIN_S = 1.0  # a thread that is busy with a compile is not waited for any longer
PULSE_S = 0.5
PULSE_POLL_S = 0.1


class Server:
    """Serves one runtime under one name on an open session, until closed."""

    def __init__(
        self,
        runtime: RuntimeApi,
        identity: Identity,
        session: zenoh.Session,
        managed: bool = False,
        doors: Doors | None = None,
    ) -> None:
        self.name = identity.name
        self._doors = doors or Doors(())
        self._session = session
        self._end = threading.Event()
        self._publishers: dict[tuple[int, str], zenoh.Publisher] = {}
        self.live = LiveStreams(runtime, self._send_live, self._live_watched)
        self.service = Service(runtime, identity, self.live, managed)
        self._requests = Requests(self.service, self._doors)
        self._hosts = Hosts(session, self.name, self._host_gone)
        self.service.claim.present = self._hosts.names
        self.service.guard.sees = self._hosts.__contains__
        self.service.guard.lost = self._host_gone
        self._threads: list[threading.Thread] = []
        self._queryables: list[Any] = []
        for lane, count in THREADS.items():
            key = keys.rpc(self.name, lane)
            # declared: hosts know it by a number, and Zenoh looks up once who may hear of it
            told = session.declare_keyexpr(key)
            lanes = [Lane(self._requests, lane, told) for _ in range(count)]
            self._serve(key, [each.answer for each in lanes])
            # STOP of each waits in a queue of its own, behind nobody else's requests
            for user in self._doors.named if lane == "stop" else ("*",):
                named = Lane(self._requests, lane, None)
                self._serve(keys.rpc(self.name, lane, user), [named.answer])
        self._serve(keys.info(self.name), [self._info])
        for user in ("", "*"):
            self._serve(keys.variable(self.name, user=user), [self._variable])
        self._threads.append(start_thread("pulse", self._pulse))
        if self._doors.routed:
            ask = partial(self._hosts.ask_routers, self._end)
            self._threads.append(start_thread("routers", ask))
        # Last, so that whoever sees the token finds everything in place.
        self._token = session.liveliness().declare_token(keys.alive(self.name))

    def close(self) -> None:
        """Withdraw all keys and tokens; the session stays open for its owner to close."""
        self._end.set()
        # hosts elsewhere cannot look for the process: this tells them not to wait for it
        self._ended = self._session.liveliness().declare_token(keys.ended(self.name))
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self.live.close()
        for queryable in self._queryables:
            queryable.undeclare()
        self._requests.close()
        for thread in self._threads:
            thread.join(JOIN_S)

    def say_farewell(self, safe: bool) -> None:
        """Say, after `close` and last of all, whether the machine is in its safe state."""
        token = keys.farewell(self.name, safe)
        self._farewell = self._session.liveliness().declare_token(token)

    # requests

    def _serve(self, key: str, answers: Sequence[Callable[[zenoh.Query], None]]) -> None:
        """Answer the requests for a key, with one thread for each of ``answers``."""
        queryable = self._session.declare_queryable(
            key, zenoh.handlers.RingChannel(WAITING), complete=True
        )
        self._queryables.append(queryable)
        turns = Turns(queryable.handler)

        def work(answer: Callable[[zenoh.Query], None]) -> None:
            while not self._end.is_set():
                try:
                    query = turns.next()
                except zenoh.ZError:  # closed
                    return
                try:
                    answer(query)
                except Exception:  # no memory, say: the next request is answered
                    log.exception("a request was not answered")
                    query.drop()  # type: ignore[no-untyped-call]

        for number, answer in enumerate(answers):
            self._threads.append(start_thread(f"{key}#{number}", partial(work, answer)))

    # for any Zenoh client

    def _info(self, query: zenoh.Query) -> None:
        self._answer(
            query, lambda: {keys.info(self.name): self.service.do_info(verbs.Nothing(), "")}
        )

    def _variable(self, query: zenoh.Query) -> None:
        self._answer(query, lambda: self._values(query.key_expr))

    def _values(self, wanted: zenoh.KeyExpr) -> Mapping[str, object]:
        user = keys.user_of(str(wanted))
        if user:
            check_role(user, self._doors.role_of(user), verbs.VERBS["read"])
        runtime = self.service.runtime
        infos = {info.name: info for info in runtime.variables()}
        found = [
            n for n in infos if wanted.intersects(zenoh.KeyExpr(keys.variable(self.name, n, user)))
        ]
        if not found:
            raise LinkError(
                f"no variable matches {wanted}; there are:"
                f" {', '.join(infos) or 'none (no program loaded)'}"
            )
        tick, read = runtime.read(found)
        return {
            keys.variable(self.name, name, user): {
                "v": PROTOCOL, "name": name, "value": value, "unit": infos[name].unit, "tick": tick,
            }
            for name, value in read.items()
        }  # fmt: skip

    def _answer(self, query: zenoh.Query, find: Callable[[], Mapping[str, object]]) -> None:
        try:
            with query:
                try:
                    for key, message in find().items():
                        query.reply(key, codec.encode(message))
                except Exception as error:
                    query.reply_err(codec.encode_error(error))
        except zenoh.ZError as error:
            log.debug("reply was not delivered: %s", error)

    def _send_live(self, stream: int, users: frozenset[str], payload: bytes, header: bytes) -> None:
        for user in users:
            self._publisher(stream, user).put(payload, attachment=header)

    def _live_watched(self, stream: int, users: frozenset[str]) -> bool:
        found: list[Any] = [self._publisher(stream, user).matching_status for user in users]
        return any(status.matching for status in found)  # declared a bool, is a MatchingStatus

    def _publisher(self, stream: int, user: str) -> zenoh.Publisher:
        if (stream, user) not in self._publishers:
            self._publishers[stream, user] = self._session.declare_publisher(
                keys.live(self.name, stream, user),
                # a viewer that hangs must not hold up the others
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,
            )
        return self._publishers[stream, user]

    def _may_look(self, user: str) -> bool:
        return not user or may(self._doors.role_of(user), verbs.VERBS["live_open"])

    def _host_gone(self, host: str) -> None:
        self._requests.forget(host)
        self.service.host_gone(host)

    def _pulse(self) -> None:
        """Publish the status at every change of state and twice a second; end live views and
        commands of users whose role was taken away.
        """
        publisher = self._session.declare_publisher(keys.event(self.name))
        last, due = None, 0.0
        links = 0.0
        while not self._end.wait(PULSE_POLL_S):
            try:
                if time.monotonic() >= links:
                    links = time.monotonic() + PULSE_S
                    close_at_once()
                self.live.keep(self._may_look)
                self._requests.end_commands()
                self.service.drives.watch()
                status = self.service.do_status(verbs.Nothing(), "")
            except Later:
                continue  # it just crashed; the next round knows how
            except Exception:  # the next round looks after hosts and roles again
                log.exception("the status cannot be told")
                continue
            now = time.monotonic()
            trouble = (status.crash, status.unsafe, status.trip)
            shown = (status.state, status.drive, trouble, status.hosts)
            if shown != last or now >= due:
                last, due = shown, now + PULSE_S
                publisher.put(codec.encode({"v": PROTOCOL, **msgspec.structs.asdict(status)}))
