"""Remembers the replies to requests that change something, so that a request sent again is not
carried out again.
"""

from __future__ import annotations

import os
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from zendsp_protocol import codec
from zendsp_protocol.errors import LinkError, NotApplied
from zendsp_protocol.once import FIRST, SETTLE, STAMP_SIZE, read_stamp

LINKS = 256  # connections of one user that are remembered
# a connection that was quiet for so long has given up every request: a host sends one again for 30
# s at most
QUIET_S = 120.0
RESULTS = 256  # of one connection: many times what its threads can have under way


Ticket = tuple[str, bytes, int]  # user, connection and number of a request


@dataclass(slots=True)
class _Memory:
    """The memory of one connection: by number of request, the reply, or a list of those who wait
    for it.
    """

    results: dict[int, bytes | list[Any]] = field(default_factory=dict)
    forgotten: int = -1  # largest number whose reply was dropped
    begun: int = 0  # requests under way
    last: float = 0.0  # when it was heard of, s


@dataclass(slots=True)
class _Links:
    """The connections of one user, that which was quiet longest first."""

    memories: OrderedDict[bytes, _Memory] = field(default_factory=OrderedDict)
    # s; until then an unknown connection may be one that was dropped too early
    unsure: float = 0.0


class Once:
    """Replies by request; safe from any thread.

    Each user has a memory of limited size, so that nobody can push out the replies of others.

    Parameters
    ----------
    now : callable
        The clock, s.

    Attributes
    ----------
    instance : bytes
        Of this run of the target.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.instance = os.urandom(8)
        self._now = now
        self._lock = threading.Lock()
        self._users: dict[str, _Links] = {}

    def begin(self, data: bytes, who: Any, user: str = "") -> tuple[Ticket | None, bytes | None]:
        """Enter a request.

        Parameters
        ----------
        data : bytes
            Its attachment.
        who : object
            Is handed back by :meth:`finish` if the same request is being carried out now.
        user : str
            Name under which the host is known.

        Returns
        -------
        Ticket or None
            It is new: carry it out, then call :meth:`finish`.
        bytes or None
            Otherwise its reply; None: it is being carried out.
        """
        try:
            link, number, instance, attempt = read_stamp(data)
        except struct.error:
            return None, codec.encode_error(
                LinkError(
                    f"an attachment of a request has {STAMP_SIZE} bytes, not {len(data)}; see"
                    " docs/protocol.md"
                )
            )
        if attempt != FIRST and instance != self.instance:
            return None, codec.encode_error(
                LinkError(
                    "the target was started again while the link was broken: whether the request"
                    " was applied before cannot be known, and what it changed is gone with the"
                    " program that ran; it is not applied now"
                )
            )
        with self._lock:
            links = self._users.get(user)
            memory = None if links is None else links.memories.get(link)
            if links is None or memory is None:
                links = self._users.setdefault(user, _Links())
                if attempt != FIRST and self._now() < links.unsure:
                    return None, codec.encode_error(
                        LinkError(
                            f"more than {LINKS} connections of the same user asked at once: whether"
                            " the request was applied before cannot be known; it is not applied now"
                        )
                    )
                memory = self._enter(links, link)
            results = memory.results
            known = results.get(number)
            if known is None and attempt != SETTLE and number > memory.forgotten:
                results[number] = []
                memory.begun += 1
                return (user, link, number), None
            self._heard(links, link, memory)
            if known is None:
                if number <= memory.forgotten:
                    return None, codec.encode_error(
                        LinkError(
                            "the request is too old: whether it was applied cannot be known any"
                            " more"
                        )
                    )
                known = results[number] = codec.encode_error(
                    NotApplied(
                        "the request did not arrive in time: it was not applied, and will not be"
                    )
                )
                return None, known
            if type(known) is list:
                known.append(who)
                return None, None
            assert isinstance(known, bytes)
            return None, known

    def _enter(self, links: _Links, link: bytes) -> _Memory:
        """Begin to remember a connection."""
        memory = links.memories[link] = _Memory(last=self._now())
        self._make_room(links, memory.last)
        return memory

    def _heard(self, links: _Links, link: bytes, memory: _Memory) -> None:
        links.memories.move_to_end(link)
        memory.last = self._now()

    def _make_room(self, links: _Links, now: float) -> None:
        """Drop connections that have long given up, then the quietest ones while there are too
        many; never one with a request under way.
        """
        for link, memory in list(links.memories.items())[:-1]:
            quiet = now - memory.last > QUIET_S
            if memory.begun or not (quiet or len(links.memories) > LINKS):
                continue
            del links.memories[link]
            if not quiet:
                links.unsure = now + QUIET_S

    def remembered(self, user: str = "") -> tuple[bytes, ...]:
        """How many connections of a user are remembered."""
        with self._lock:
            return tuple(self._users[user].memories) if user in self._users else ()

    def drop(self, ticket: Ticket) -> None:
        """Do not remember a request, since it changes nothing however often it comes."""
        user, link, number = ticket
        with self._lock:
            links = self._users[user]
            memory = links.memories[link]
            memory.begun -= 1
            del memory.results[number]
            self._heard(links, link, memory)

    def finish(self, ticket: Ticket, reply: bytes | bytearray) -> list[Any]:
        """Remember the reply of a request that was carried out; return those who asked for it
        meanwhile.
        """
        user, link, number = ticket
        with self._lock:
            links = self._users[user]
            memory = links.memories[link]
            memory.begun -= 1
            self._heard(links, link, memory)
            results = memory.results
            waiting = results.get(number)
            results[number] = bytes(reply)
            if len(results) > RESULTS:
                oldest = next(iter(results))
                if type(results[oldest]) is bytes:
                    del results[oldest]
                    memory.forgotten = max(memory.forgotten, oldest)
            return waiting if type(waiting) is list else []
