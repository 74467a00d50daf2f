"""Requests that come again and again, known by their bytes: a host that tunes or watches sends the
same ones thousands of times.

A monitor that wakes up for a request finds little of its Python in the caches, and pays for every
function on the way several times over. So a request that has gone the whole way once is answered by
what was made ready for its bytes: a reading by all of them, a write of one double by all but the
number at its end. Whatever is not plainly right goes the whole way again, which finds the words.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from zendsp_protocol import codec, verbs
from zendsp_protocol.errors import LinkError
from zendsp_target.api import Blank, RuntimeApi
from zendsp_target.bounded import keep
from zendsp_target.serving.drives import Drives

LONGEST = 65536  # bytes of a request that is kept
_FLOAT = struct.Struct(">d")  # what MessagePack puts behind the byte that announces a double
_COUNT = struct.Struct(">Q")  # likewise
# a count that takes all of its eight bytes, which are no text: it stands nowhere else in a reply
_LARGEST = 2**64 - 1
_PROBE = -0.1  # likewise


class Repeats:
    """Answers to requests that came before; of one user and one thread, since a reply is filled in
    where the last one stood.
    """

    def __init__(self, runtime: RuntimeApi, drives: Drives, lane: str) -> None:
        self._runtime, self._drives, self._lane = runtime, drives, lane
        # None: it was looked at, and has no shorter way
        self._reads: dict[bytes, tuple[Callable[[], int], bytearray] | None] = {}
        self._writes: dict[bytes, tuple[Callable[[bytes], int], bytearray, str] | None] = {}

    def answer(self, request: bytes) -> bytearray | None:
        """Return the reply, good until the next; None: the request has to go the whole way."""
        reading = self._reads.get(request)
        if reading is not None:
            read, reply = reading
            return reply if read() else None
        writing = self._writes.get(request[: -_FLOAT.size])
        if writing is not None:
            write, reply, author = writing
            commander = self._drives.commander
            if not commander or commander == author:
                return reply if write(request) else None
        return None

    def learn(self, request: bytes, verb: verbs.Verb, args: Any, said: str, author: str) -> None:
        """Make ready for a request that went the whole way, and well: from whom, as it says, and as
        the target knows.
        """
        if len(request) > LONGEST:
            return
        if verb.name == "read":
            self._learn_read(request, args)
        elif verb.name == "write":
            self._learn_write(request, args, said, author)

    def forget(self) -> None:
        """Let go of what was made ready for a program that is gone."""
        self._reads.clear()
        self._writes.clear()

    def _learn_read(self, request: bytes, args: verbs.Read) -> None:
        if request in self._reads or not args.names or args.after:
            return
        values = {name: _PROBE - number for number, name in enumerate(args.names)}
        data = bytearray(codec.encode_result({"tick": _LARGEST, "values": values}))
        places = tuple(data.index(_FLOAT.pack(value)) for value in values.values())
        read = self._runtime.repeat_read(
            args.names, Blank(data, data.index(_COUNT.pack(_LARGEST)), places)
        )
        keep(self._reads, request, None if read is None else (read, data))

    def _learn_write(self, request: bytes, args: verbs.Write, said: str, author: str) -> None:
        key = request[: -_FLOAT.size]
        if key in self._writes or args.at_tick is not None or len(args.values) != 1:
            return
        ((name, value),) = args.values.items()
        if type(value) is not float:
            return
        # whether the last eight bytes are the value, and nothing else is: with others there,
        # another value must come out
        try:
            verb, other, by = codec.decode_request(key + _FLOAT.pack(_PROBE), self._lane)
        except LinkError:
            return
        if (verb.name, other, by) != ("write", verbs.Write(values={name: _PROBE}), said):
            return
        data = bytearray(codec.encode_result({"sequence": _LARGEST}))
        write = self._runtime.repeat_write(
            name, author, len(key), Blank(data, data.index(_COUNT.pack(_LARGEST)))
        )
        keep(self._writes, key, None if write is None else (write, data, author))
