"""Who is connected, as the link itself knows it: a host that is killed is gone within the lease."""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh

from zendsp_protocol import keys
from zendsp_protocol.codec import MOST_NAME

MOST_HOSTS = 256  # of one user that are told of: the status names them all, to everybody


class Hosts:
    """Follows the liveliness tokens of the hosts of one target."""

    def __init__(self, session: zenoh.Session, target: str, on_gone: Callable[[str], None]) -> None:
        self._present: set[str] = set()
        self._lock = threading.Lock()
        self._on_gone = on_gone
        self._subscriber = session.liveliness().declare_subscriber(
            keys.host(target), self._changed, history=True
        )

    def __contains__(self, host: str) -> bool:
        with self._lock:
            return host in self._present

    def names(self) -> tuple[str, ...]:
        """Hosts connected now, sorted."""
        with self._lock:
            return tuple(sorted(self._present))

    def _count(self, user: str) -> int:
        return sum(host.partition("@")[0] == user for host in self._present)

    def _changed(self, sample: zenoh.Sample) -> None:
        host = keys.host_of(str(sample.key_expr))
        gone = sample.kind == zenoh.SampleKind.DELETE
        user = host.partition("@")[0]
        with self._lock:
            known = host in self._present
            if gone:
                self._present.discard(host)
            elif len(host) <= MOST_NAME and self._count(user) < MOST_HOSTS:
                self._present.add(host)
        if gone and known:
            # Not in this thread: it belongs to Zenoh and must not wait for the runtime.
            threading.Thread(target=self._on_gone, args=(host,), daemon=True).start()
