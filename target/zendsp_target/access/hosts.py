"""The connected hosts, by Zenoh's liveliness tokens: a host that was killed is gone within the
lease. A busy computer may lose the link of a process that still runs: it has time to come back.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import zenoh

from zendsp_protocol import keys
from zendsp_protocol.codec import MOST_NAME
from zendsp_target.access.endpoints import LEASE_MS

MOST_HOSTS = 256  # of one user that are told of: the status names them all, to everybody
LOOK_S = 0.25  # between questions to the routers
# s, for a host of this computer whose process runs to come back: it tries again after 0.1 to 0.5 s
BACK_S = 2.0
PROCESS_S = 0.02  # between looks whether it still runs


class Hosts:
    """Follows the liveliness tokens of the hosts of one target."""

    def __init__(self, session: zenoh.Session, target: str, on_gone: Callable[[str], None]) -> None:
        self._present: set[str] = set()
        self._hidden: set[str] = set()  # behind a router that is silent
        self._awaited: dict[str, threading.Event] = {}  # whose link was lost, until it is back
        self._lock = threading.Lock()
        self._on_gone = on_gone
        self._session, self._key = session, keys.host(target)
        self._subscriber = session.liveliness().declare_subscriber(
            self._key, self._changed, history=True
        )
        self._leaving = session.liveliness().declare_subscriber(keys.left(target), self._left)

    def __contains__(self, host: str) -> bool:
        with self._lock:
            return host in self._present

    def names(self) -> tuple[str, ...]:
        """Hosts connected now, sorted."""
        with self._lock:
            return tuple(sorted(self._present))

    def _count(self, user: str) -> int:
        return sum(host.partition("@")[0] == user for host in self._present)

    def ask_routers(self, end: threading.Event) -> None:
        """Ask the routers for their hosts again and again, until the ``end``.

        Behind a router that does not answer within the target's own lease, a lost host would stay
        unnoticed for the router's longer lease. So all hosts of other computers then count as lost;
        they are back once the router answers.
        """
        while not end.wait(LOOK_S):
            try:
                answers = list(self._session.liveliness().get(self._key, timeout=LEASE_MS / 1000.0))
            except zenoh.ZError:  # the session was closed
                continue
            if any(answer.ok is None for answer in answers):
                hidden = {host for host in self.names() if not _runs_here(host)}
                self._hidden |= hidden
                for host in hidden:
                    self._change(host, gone=True)
                continue
            there = {keys.host_of(str(answer.ok.key_expr)) for answer in answers if answer.ok}
            for host in there & self._hidden:
                self._change(host, gone=False)
            self._hidden.clear()

    def _changed(self, sample: zenoh.Sample) -> None:
        gone, host = sample.kind == zenoh.SampleKind.DELETE, keys.host_of(str(sample.key_expr))
        if not gone or host not in self or not _runs_here(host) or not self._waits(host):
            self._change(host, gone)

    def _left(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._change(keys.host_of(str(sample.key_expr)), gone=True)

    def _waits(self, host: str) -> bool:
        """Wait in a thread for a host to come back; False where there can be no more threads."""
        back = threading.Event()
        with self._lock:
            self._awaited[host] = back
        try:
            threading.Thread(target=self._wait_for, args=(host, back), daemon=True).start()
        except RuntimeError:
            return False
        return True

    def _wait_for(self, host: str, back: threading.Event) -> None:
        """Count a host as lost unless its token is back in time, or as soon as its process ends."""
        deadline = time.monotonic() + BACK_S
        while not back.wait(PROCESS_S):
            if time.monotonic() > deadline or not _runs_here(host):
                self._change(host, gone=True)

    def _change(self, host: str, gone: bool) -> None:
        user = host.partition("@")[0]
        with self._lock:
            known = host in self._present
            if awaited := self._awaited.pop(host, None):
                awaited.set()
            if gone:
                self._present.discard(host)
            elif len(host) <= MOST_NAME and self._count(user) < MOST_HOSTS:
                self._present.add(host)
        if gone and known:
            # Not in this thread: it belongs to Zenoh and must not wait for the runtime.
            try:
                threading.Thread(target=self._on_gone, args=(host,), daemon=True).start()
            except RuntimeError:  # there can be no more threads: late is better than never
                self._on_gone(host)


def _runs_here(host: str) -> bool:
    """Whether a host is, by its name, a process of this computer that still runs."""
    machine, _, process = host.partition("@")[2].rpartition(":")
    try:
        state = Path(f"/proc/{int(process.partition('.')[0])}/stat").read_text(errors="replace")
    except (OSError, ValueError):
        return False
    return machine == os.uname().nodename and state.rpartition(")")[2].split()[0] not in "TtXZ"
