"""The Zenoh side of the target: lanes of requests, publications, and the tokens that show it is
alive.
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
from zendsp_protocol.errors import LinkError, Refused, ZendspError
from zendsp_protocol.version import PROTOCOL
from zendsp_target.access.admission import Doors, check_role, may
from zendsp_target.access.hosts import Hosts
from zendsp_target.access.lingering import close_at_once
from zendsp_target.api import RECORDER, RuntimeApi
from zendsp_target.serving.bulk_transfer import send_rows
from zendsp_target.serving.deferred import Later, Waiters
from zendsp_target.serving.live_streams import LiveStreams
from zendsp_target.serving.repeated_requests import Repeats
from zendsp_target.serving.request_log import Ticket
from zendsp_target.serving.service import Identity, Service
from zendsp_target.serving.turns import WAITING, Turns
from zendsp_target.threads import start_thread

log = logging.getLogger(__name__)

# Threads of each lane. A host waits for its answers, so its own requests stay in order; a compile,
# a wait for a sample or a large transfer must neither hold these up nor each other.
THREADS = {"quick": 3, "sync": 2, "stop": 1, "slow": 2, "bulk": 3}
WRITE = verbs.VERBS["write"]
JOIN_S = 1.0  # a thread that is busy with a compile is not waited for any longer
COMMAND = verbs.VERBS["drive"]
MOST_HOSTS = 1000  # that have commanded or moved the machine, by name
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
        # hosts known by name: the user of each, and the verb that it must go on to be allowed
        self._commanded: dict[str, tuple[str, verbs.Verb]] = {}
        self.live = LiveStreams(runtime, self._send_live, self._live_watched)
        self.service = Service(runtime, identity, self.live, managed)
        self._hosts = Hosts(session, self.name, self._host_gone)
        self.service.present = self._hosts.names
        self.service.drives.sees = self._hosts.__contains__
        self.service.drives.lost = self._host_gone
        self._waiters = Waiters()
        self._threads: list[threading.Thread] = []
        self._queryables: list[Any] = []
        for lane, count in THREADS.items():
            self._serve(
                keys.rpc(self.name, lane), [self._answerer(lane, False) for _ in range(count)]
            )
            # STOP of each waits in a queue of its own, behind nobody else's requests
            for user in self._doors.named if lane == "stop" else ("*",):
                self._serve(keys.rpc(self.name, lane, user), [self._answerer(lane, True)])
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
        """Withdraw everything; the session stays open for its owner to close."""
        self._end.set()
        # hosts elsewhere cannot look for the process: this tells them not to wait for it
        self._ended = self._session.liveliness().declare_token(keys.ended(self.name))
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self.live.close()
        for queryable in self._queryables:
            queryable.undeclare()
        self._waiters.close()
        for thread in self._threads:
            thread.join(JOIN_S)

    # requests

    def _serve(self, key: str, answers: Sequence[Callable[[zenoh.Query], None]]) -> None:
        """Answer what comes for a key, in as many threads."""
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
                answer(query)

        for number, answer in enumerate(answers):
            self._threads.append(start_thread(f"{key}#{number}", partial(work, answer)))

    def _answerer(self, lane: str, named: bool) -> Callable[[zenoh.Query], None]:
        """Make what answers the requests of a lane in one thread; of hosts that are known by name,
        or of the target's own user.
        """
        made: dict[str, Repeats] = {}

        def of(user: str) -> Repeats:
            return made.get(user) or made.setdefault(user, self.service.repeats(lane))

        return partial(self._request, lane, named, of if lane == "quick" else None)

    def _request(
        self,
        lane: str,
        named: bool,
        repeats_of: Callable[[str], Repeats] | None,
        query: zenoh.Query,
    ) -> None:
        """Answer one request, whatever happens: silence would look like a dead target."""
        reply: bytes | bytearray
        ticket: Ticket | None = None
        user = keys.user_of(str(query.key_expr)) if named else ""
        attachment = query.attachment
        if attachment is not None:
            ticket, known = self.service.once.begin(attachment.to_bytes(), query, user)
            if ticket is None:
                if known is not None:
                    self._reply(query, known)
                return
        try:
            payload = query.payload
            if payload is None:
                raise LinkError("a request needs a MessagePack payload; see docs/protocol.md")
            request = payload.to_bytes()
            # a role that may write may read as well; who has less goes the whole way, where each
            # verb asks for its own
            repeats = (
                repeats_of(user)
                if repeats_of and (not user or may(self._doors.role_of(user), WRITE))
                else None
            )
            short = None if repeats is None else repeats.answer(request)
            if short is not None:
                reply = short
            else:
                verb, args, said = codec.decode_request(request, lane)
                if ticket is not None and not verb.once:
                    self.service.once.drop(ticket)
                    ticket = None
                by = said
                if user:  # known by name: its role decides, and its name is what the log says
                    check_role(user, self._doors.role_of(user), verb)
                    by = by if by.startswith(f"{user}@") else user
                    self._note(by, user, verb, args)
                if verb.name == "compile":
                    self._doors.check_upload(user)
                handler = self.service.handlers.get(verb.name)
                result = (
                    self._special(verb, args, by, user, query)
                    if handler is None
                    else handler(args, by)
                )
                reply = codec.encode_result(result)
                if repeats is not None:
                    repeats.learn(request, verb, args, said, by)
        except Later as later:
            try:
                self._waiters.submit(user, partial(self._finish, query, ticket, later.rest))
                return
            except Refused as error:
                reply = codec.encode_error(error)
        except ZendspError as error:
            reply = codec.encode_error(error)
        except Exception as error:
            log.exception("request on lane %s failed", lane)
            reply = codec.encode_error(error)
        self._answered(query, ticket, reply)

    def _note(self, by: str, user: str, verb: verbs.Verb, args: Any) -> None:
        """Remember a host that is known by name and commands or moves the machine."""
        if verb.role == COMMAND.role:
            self._commanded[by] = user, COMMAND
        elif getattr(args, "moves", False):  # a run of it
            self._commanded.setdefault(by, (user, verb))

    def _special(self, verb: verbs.Verb, args: Any, by: str, user: str, query: zenoh.Query) -> Any:
        if verb.name == "acquire_read":
            return send_rows(self.service.runtime, RECORDER, args, query)
        if verb.name == "live_open":
            return self.service.open_live(args, by, user)
        raise LinkError(f"this target does not know the verb {verb.name!r}")

    def _finish(self, query: zenoh.Query, ticket: Ticket | None, rest: Callable[[], Any]) -> None:
        try:
            reply = codec.encode_result(rest())
        except Exception as error:
            reply = codec.encode_error(error)
        self._answered(query, ticket, reply)

    def _answered(
        self, query: zenoh.Query, ticket: Ticket | None, reply: bytes | bytearray
    ) -> None:
        """Reply, also to those who sent the same request again while it was carried out."""
        # first: who waits is spared the rest, and who asks again until then is answered below
        self._reply(query, reply)
        if ticket is not None:
            for again in self.service.once.finish(ticket, reply):
                self._reply(again, reply)

    def _reply(self, query: zenoh.Query, reply: bytes | bytearray) -> None:
        try:
            query.reply(query.key_expr, reply)
        except zenoh.ZError as error:  # the host is gone: nobody is left to tell
            log.debug("reply was not delivered: %s", error)
        finally:
            query.drop()  # type: ignore[no-untyped-call]

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
        self._commanded.pop(host, None)
        self.service.host_gone(host)

    def _end_commands(self) -> None:
        """Whose role no longer moves the machine is, of what it moved, a host that is lost."""
        while len(self._commanded) > MOST_HOSTS:  # names that were never there, the oldest first
            self._commanded.pop(next(iter(self._commanded)), None)
        for host, (user, verb) in list(self._commanded.items()):
            if not may(self._doors.role_of(user), verb):
                self._commanded.pop(host, None)
                log.warning("%s may no longer command or move the machine", host)
                self.service.runs.host_gone(host)

    def _pulse(self) -> None:
        """Publish the status at every change of state and twice a second; end live views and
        commands whose role was taken away.
        """
        publisher = self._session.declare_publisher(keys.event(self.name))
        last, due = None, 0.0
        links = 0.0
        while not self._end.wait(PULSE_POLL_S):
            if time.monotonic() >= links:
                links = time.monotonic() + PULSE_S
                close_at_once()
            self.live.keep(self._may_look)
            self._end_commands()
            self.service.drives.watch()
            try:
                status = self.service.do_status(verbs.Nothing(), "")
            except Later:
                continue  # it just crashed; the next round knows how
            except Exception:
                log.exception("the status cannot be read")
                continue
            now = time.monotonic()
            trouble = (status.crash, status.unsafe, status.trip)
            shown = (status.state, status.drive, trouble, status.hosts)
            if shown != last or now >= due:
                last, due = shown, now + PULSE_S
                publisher.put(codec.encode({"v": PROTOCOL, **msgspec.structs.asdict(status)}))
