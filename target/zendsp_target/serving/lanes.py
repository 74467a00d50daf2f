"""Takes the requests of each lane, carries each out once, and answers it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh

from zendsp_protocol import codec, keys, verbs
from zendsp_protocol.errors import LinkError, Refused, ZendspError
from zendsp_target.access.admission import Doors, check_role, may
from zendsp_target.api import RECORDER
from zendsp_target.serving.bulk_transfer import send_rows
from zendsp_target.serving.deferred import Later, Waiters
from zendsp_target.serving.repeated_requests import Repeats
from zendsp_target.serving.request_log import Ticket
from zendsp_target.serving.service import Service

log = logging.getLogger(__name__)

# Threads of each lane. A host waits for its answers, so its own requests stay in order; a compile
# or a large transfer must not hold up another. Several threads that wait in a lane are woken in
# turn, and each finds nothing of its own in the caches: where answers come at once, one is quicker.
THREADS = {"quick": 1, "sync": 1, "stop": 1, "slow": 2, "bulk": 3}
# Of the quick lane, what waits for nothing: the lane's own thread does it. Waiters do the rest.
AT_ONCE = frozenset(("read", "write", "check", "status"))
REPEATED = ("quick", "sync")  # lanes in which the same requests come thousands of times
MOST_HOSTS = 1000  # names of hosts that have commanded or moved the machine
WRITE = verbs.VERBS["write"]
COMMAND = verbs.VERBS["drive"]


class Requests:
    """What all lanes share: the handlers, the rights of users, and the way of an answer.

    Parameters
    ----------
    service : Service
    doors : Doors
    """

    def __init__(self, service: Service, doors: Doors) -> None:
        self.service, self.doors = service, doors
        self._waiters = Waiters()
        # hosts known by name: the user of each, and the verb that it must go on to be allowed
        self._commanded: dict[str, tuple[str, verbs.Verb]] = {}

    def author(self, user: str, said: str, verb: verbs.Verb, args: Any) -> str:
        """The name of the asker for the log. A user whom the target knows by name has that name,
        whatever the request says.

        Raises
        ------
        Refused
            The user's role does not include the verb.
        """
        if not user:
            return said
        check_role(user, self.doors.role_of(user), verb)
        by = said if said.startswith(f"{user}@") else user
        if verb.role == COMMAND.role:
            self._commanded[by] = user, COMMAND
        elif getattr(args, "moves", False):  # a run of it
            self._commanded.setdefault(by, (user, verb))
        return by

    def work(
        self, verb: verbs.Verb, args: Any, by: str, user: str, query: zenoh.Query
    ) -> Callable[[], Any]:
        """Return a function that carries a request out."""
        if verb.name == "compile":
            self.doors.check_upload(user)
        handler = self.service.handlers.get(verb.name)
        if handler is not None:
            return partial(handler, args, by)
        if verb.name == "acquire_read":
            now = self.service.runtime.acquire_status(RECORDER).begun
            self.service.claim.check_rows(args.begun, now, by)
            return partial(send_rows, self.service.runtime, RECORDER, args, query)
        if verb.name == "live_open":
            return partial(self.service.open_live, args, by, user)
        raise LinkError(f"this target does not know the verb {verb.name!r}")

    def later(
        self,
        rest: Callable[[], Any],
        user: str,
        query: zenoh.Query,
        key: zenoh.KeyExpr,
        ticket: Ticket | None,
    ) -> None:
        """Have another thread finish a request and answer it.

        Raises
        ------
        Refused
            Too much of this user's waits already.
        """
        self._waiters.submit(user, partial(self._finish, rest, query, key, ticket))

    def _finish(
        self,
        rest: Callable[[], Any],
        query: zenoh.Query,
        key: zenoh.KeyExpr,
        ticket: Ticket | None,
    ) -> None:
        try:
            try:
                result = rest()
            except Later as later:
                result = later.rest()
            reply = codec.encode_result(result)
        except Exception as error:
            reply = refusal(error)
        self.answered(query, key, ticket, reply)

    def answered(
        self,
        query: zenoh.Query,
        key: zenoh.KeyExpr,
        ticket: Ticket | None,
        reply: bytes | bytearray,
    ) -> None:
        """Send a reply, also to those who sent the same request again meanwhile."""
        # first, so that nobody waits for the rest; who asks again meanwhile is answered below
        send(query, key, reply)
        if ticket is not None:
            for again in self.service.once.finish(ticket, reply):
                send(again, key, reply)

    def forget(self, host: str) -> None:
        """Forget the commands of a host that is gone."""
        self._commanded.pop(host, None)

    def end_commands(self) -> None:
        """Treat a host as lost, in what it moved, once its user's role no longer includes that."""
        while len(self._commanded) > MOST_HOSTS:  # names that were never there, the oldest first
            self._commanded.pop(next(iter(self._commanded)), None)
        for host, (user, verb) in list(self._commanded.items()):
            if not may(self.doors.role_of(user), verb):
                self._commanded.pop(host, None)
                log.warning("%s may no longer command or move the machine", host)
                self.service.runs.host_gone(host)

    def close(self) -> None:
        """Start no further work."""
        self._waiters.close()


class Lane:
    """Answers the requests of one lane, in one thread.

    Parameters
    ----------
    requests : Requests
    name : str
    key : zenoh.KeyExpr or None
        Of the target's own user. None: of hosts known by name, each of which has its own.
    """

    def __init__(self, requests: Requests, name: str, key: zenoh.KeyExpr | None) -> None:
        self._requests, self._name, self._key = requests, name, key
        self._once = requests.service.once
        self._repeats: dict[str, Repeats] = {}  # by user

    def _repeats_of(self, user: str) -> Repeats | None:
        """The prepared answers of a user; None where each request has to be decoded.

        A role that may write may read as well. Who has less goes the whole way, where each verb
        asks for its own.
        """
        doors = self._requests.doors
        if self._name not in REPEATED or (user and not may(doors.role_of(user), WRITE)):
            return None
        known = self._repeats.get(user)
        if known is None:
            known = self._repeats[user] = self._requests.service.repeats(self._name)
        return known

    def answer(self, query: zenoh.Query) -> None:
        """Answer one request in every case: silence would look like a dead target."""
        key, user = self._key, ""
        if key is None:
            key = query.key_expr
            user = keys.user_of(str(key))
        ticket: Ticket | None = None
        attachment = query.attachment
        if attachment is not None:
            ticket, known = self._once.begin(attachment.to_bytes(), query, user)
            if ticket is None:
                if known is not None:
                    send(query, key, known)
                return
        learn: Callable[[], None] | None = None
        try:
            payload = query.payload
            if payload is None:
                raise LinkError("a request needs a MessagePack payload; see docs/protocol.md")
            request = payload.to_bytes()
            repeats = self._repeats_of(user)
            reply = None if repeats is None else repeats.answer(request)
            if reply is None:
                verb, args, said = codec.decode_request(request, self._name)
                if ticket is not None and not verb.once:
                    self._once.drop(ticket)
                    ticket = None
                by = self._requests.author(user, said, verb, args)
                work = self._requests.work(verb, args, by, user, query)
                if self._name == "quick" and verb.name not in AT_ONCE:
                    raise Later(work)
                reply = codec.encode_result(work())
                if repeats is not None:
                    learn = partial(repeats.learn, request, verb, args, said, by)
        except Later as later:
            try:
                self._requests.later(later.rest, user, query, key, ticket)
                return
            except Refused as error:
                reply = refusal(error)
        except Exception as error:
            reply = refusal(error)
        self._requests.answered(query, key, ticket, reply)
        if learn is not None:  # whoever waits has the answer
            learn()


def refusal(error: Exception) -> bytes:
    """The encoded reply for an error."""
    if not isinstance(error, ZendspError):
        log.error("a request failed", exc_info=error)
    return codec.encode_error(error)


def send(query: zenoh.Query, key: zenoh.KeyExpr, reply: bytes | bytearray) -> None:
    """Send the one reply to a request."""
    try:
        query.reply(key, reply)
    except zenoh.ZError as error:  # the host is gone: nobody is left to tell
        log.debug("reply was not delivered: %s", error)
    finally:
        query.drop()  # type: ignore[no-untyped-call]
