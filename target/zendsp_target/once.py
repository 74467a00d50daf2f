"""Remembers what became of the requests that change something, so that one that comes again is not carried out again."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

from zendsp_protocol import codec
from zendsp_protocol.errors import LinkError, NotApplied
from zendsp_protocol.once import FIRST, SETTLE, read_stamp

LINKS = 256  # connections that are remembered; the one that was quiet longest goes first
RESULTS = 256  # of one connection: many times what its threads can have under way


Ticket = tuple[bytes, int]  # connection and number of a request


@dataclass
class _Memory:
    """Of one connection: replies by number; a list of who waits where the work goes on."""

    results: dict[int, bytes | list[Any]] = field(default_factory=dict)
    forgotten: int = -1  # largest number whose reply was dropped


class Once:
    """Outcomes of requests by their identity; safe from any thread.

    Attributes
    ----------
    instance : bytes
        Of this run of the target.
    """

    def __init__(self) -> None:
        self.instance = os.urandom(8)
        self._lock = threading.Lock()
        self._links: OrderedDict[bytes, _Memory] = OrderedDict()

    def begin(self, data: bytes, who: Any) -> tuple[Ticket | None, bytes | None]:
        """Enter a request.

        Parameters
        ----------
        data : bytes
            Its attachment.
        who : object
            Is handed back by :meth:`finish` if the same request is being carried out now.

        Returns
        -------
        Ticket or None
            It is new: carry it out, then call :meth:`finish`.
        bytes or None
            Otherwise its reply; None: it is being carried out.
        """
        try:
            link, number, instance, attempt = read_stamp(data)
        except ValueError as error:
            return None, codec.encode_error(LinkError(str(error)))
        if attempt != FIRST and instance != self.instance:
            return None, codec.encode_error(LinkError(
                "the target was started again while the link was broken: whether the request was applied before cannot be known, "
                "and what it changed is gone with the program that ran; it is not applied now"
            ))  # fmt: skip
        with self._lock:
            memory = self._links.get(link)
            if memory is None:
                memory = self._links[link] = _Memory()
                if len(self._links) > LINKS:
                    self._links.popitem(last=False)
            results = memory.results
            known = results.get(number)
            if known is None:
                if number <= memory.forgotten:
                    return None, codec.encode_error(LinkError("the request is too old: whether it was applied cannot be known any more"))
                if attempt == SETTLE:
                    known = results[number] = codec.encode_error(NotApplied("the request did not arrive in time: it was not applied, and will not be"))
                    return None, known
                results[number] = []
                return (link, number), None
            if type(known) is list:
                known.append(who)
                return None, None
            assert isinstance(known, bytes)
            return None, known

    def finish(self, ticket: Ticket, reply: bytes | bytearray) -> list[Any]:
        """Remember the reply of a request that was carried out; returns who asked for it meanwhile."""
        link, number = ticket
        with self._lock:
            memory = self._links.get(link)
            if memory is None:  # many others came in the time that it took
                return []
            results = memory.results
            waiting = results.get(number)
            results[number] = bytes(reply)
            if len(results) > RESULTS:
                oldest = next(iter(results))
                if type(results[oldest]) is bytes:
                    del results[oldest]
                    memory.forgotten = max(memory.forgotten, oldest)
                self._links.move_to_end(link)
            return waiting if type(waiting) is list else []
