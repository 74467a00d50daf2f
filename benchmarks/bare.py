"""The same with nothing but Zenoh: a process that answers, and a session to it.

    python benchmarks/bare.py ENDPOINT     # serves until standard input ends
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import zenoh

from zendsp.link.settings import Credentials, zenoh_config
from zendsp_target.access.endpoints import Security, with_free_ports
from zendsp_target.access.endpoints import zenoh_config as target_config

BARE = "bare/quick"
PACKED = "bare/packed"
BULK = "bare/bulk"
ANSWER = 64  # bytes
STAMP = bytes(25)  # as many as that of a request has


def serve_bare(endpoint: str) -> None:
    """Answer requests with nothing but Zenoh until standard input ends: the other process of the
    comparison.
    """
    session = zenoh.open(target_config([endpoint], Security()))
    quick = session.declare_queryable(BARE, zenoh.handlers.FifoChannel(256))
    told = session.declare_keyexpr(BARE)  # as the product does: a few µs less
    # as many different bytes as a recording has: one block sent again and again would never leave
    # the caches
    blobs = [np.random.default_rng(k).bytes(1 << 20) for k in range(256)]

    def bulk(query: zenoh.Query) -> None:
        with query:
            for k in range(int(query.parameters["n"])):
                query.reply(BULK, blobs[k % len(blobs)], attachment=b"header")

    def packed_answer(query: zenoh.Query) -> bytes:
        query.attachment.to_bytes()
        (value,) = msgpack.unpackb(query.payload.to_bytes())["args"]["values"].values()
        return msgpack.packb({"sequence": int(value)})

    bulk_server = session.declare_queryable(BULK, bulk)
    packed = session.declare_queryable(PACKED, zenoh.handlers.FifoChannel(256))
    packed_key = session.declare_keyexpr(PACKED)
    servers = [
        threading.Thread(target=serve, args=each, daemon=True)
        for each in (
            (quick.handler, told, lambda query: query.payload.to_bytes()[:ANSWER]),
            (packed.handler, packed_key, packed_answer),
        )
    ]
    for server in servers:
        server.start()
    print("ready", flush=True)
    sys.stdin.read()
    for served in (bulk_server, quick, packed):
        served.undeclare()
    session.close()
    for server in servers:
        server.join(2.0)


def serve(waiting: Any, key: zenoh.KeyExpr, answer: Callable[[zenoh.Query], bytes]) -> None:
    """Answer what comes in until there will be no more."""
    while True:
        try:
            query = waiting.recv()
        except zenoh.ZError:
            return
        with query:
            query.reply(key, answer(query))


class Bare:
    """The bare peer and a session to it, with the settings of the product.

    Parameters
    ----------
    endpoint : str
    """

    def __init__(self, endpoint: str) -> None:
        endpoint = with_free_ports([endpoint])[0]
        self.process = subprocess.Popen(
            [sys.executable, __file__, endpoint],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.process.stdout is not None
        self.process.stdout.readline()
        self.session = zenoh.open(zenoh_config([endpoint], Credentials(), 5.0))
        self.querier, self.packed_querier = (
            self.session.declare_querier(
                key,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
            for key in (BARE, PACKED)
        )
        deadline = time.monotonic() + 10.0
        while (
            not list(self.session.get(BARE, payload=b"x", timeout=1.0))
            and time.monotonic() < deadline
        ):
            time.sleep(0.05)

    def round_trip(self, size: int = 64) -> None:
        """One request of so many bytes and its answer of 64."""
        self.querier.get(payload=b"y" * size).recv().ok.payload.to_bytes()

    def packed(self, value: float) -> None:
        """A write by a client and a target of Zenoh and MessagePack alone, with the stamp by which
        a request is carried out once: nothing is checked, and nothing written.
        """
        body = {"v": 1, "verb": "write", "by": "me", "args": {"values": {"v0": value}}}
        reply = self.packed_querier.get(payload=msgpack.packb(body), attachment=STAMP).recv().ok
        msgpack.unpackb(reply.payload.to_bytes())["sequence"]

    def load(self, chunks: int) -> np.ndarray:
        """Fetch ``chunks`` MiB in one request and put them into an array.

        With the priority of the product: the settings give it a long queue, which makes bare Zenoh
        faster as well (by a third).
        """
        data = np.empty(chunks << 20, dtype=np.uint8)
        place = 0
        for reply in self.session.get(
            f"{BULK}?n={chunks}",
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=60.0,
            priority=zenoh.Priority.DATA_LOW,
        ):
            part = reply.ok.payload.to_bytes()
            data[place : place + len(part)] = np.frombuffer(part, np.uint8)
            place += len(part)
        return data

    def close(self) -> None:
        self.session.close()
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(10)


if __name__ == "__main__":
    serve_bare(sys.argv[1])
