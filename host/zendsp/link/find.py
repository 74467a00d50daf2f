"""Find targets: those of this computer through their registry entries, others at given endpoints.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import zenoh

from zendsp.errors import LinkError, VersionMismatch, ZendspError
from zendsp.here.registered import local_entries, remote_endpoints
from zendsp.link.session import SOCKET, open_session, silent
from zendsp.link.settings import Credentials, doubts
from zendsp_protocol import codec, keys, registry
from zendsp_protocol import messages as m
from zendsp_protocol.verbs import VERBS


@dataclass(frozen=True)
class Found:
    """A target that answered.

    Attributes
    ----------
    name, endpoints
        To connect to.
    info : Info or None
        What it says of itself; None where it speaks another version of the protocol.
    problem : str
        Why it cannot be used, empty where it can.
    status : Status or None
        None where it did not say.
    """

    name: str
    endpoints: tuple[str, ...]
    info: m.Info | None
    problem: str = ""
    status: m.Status | None = None

    def __repr__(self) -> str:
        what = repr(self.info)[1:-1] if self.info else f"Found {self.name}: {self.problem}"
        return f"<{what}, at {', '.join(self.endpoints)}>"


def discover(
    pattern: str = "*", connect: str | Sequence[str] | None = None, timeout: float = 3.0
) -> list[Found]:
    """The targets that answer.

    Parameters
    ----------
    pattern : str
        Shell wildcard on the name, for example ``"imi*"``.
    connect : str or sequence of str, optional
        Endpoints of targets or routers elsewhere; default ``$ZENDSP_CONNECT``.
    timeout : float, s
        For each to answer, as long as `zendsp.connect` waits; all are asked at once.

    Returns
    -------
    list of Found
        By name.

    Examples
    --------
    >>> [found.name for found in discover("no-such-*")]
    []
    """
    return look(pattern, connect, timeout)[0]


def look(
    pattern: str = "*", connect: str | Sequence[str] | None = None, timeout: float = 3.0
) -> tuple[list[Found], list[str]]:
    """The targets that answer, as `discover` returns them, and the endpoints elsewhere at which
    none does.
    """
    entries = [entry for entry in local_entries() if fnmatch.fnmatchcase(entry.name, pattern)]
    places: list[tuple[Sequence[str], Credentials | None]] = [reach(entry) for entry in entries]
    elsewhere = remote_endpoints(connect)
    places += [([endpoint], None) for endpoint in elsewhere]
    found: dict[str, Found] = {}
    asked = _ask_all(places, timeout)
    for entry, answers in zip_longest(entries, asked):
        problem = unreachable(entry) if entry else ""
        if entry and not answers:
            problem = problem or silent(entry.endpoints)
        if entry and problem:
            found[entry.name] = Found(entry.name, tuple(entry.endpoints), None, problem)
        for one in answers:
            if one.name == entry.name if entry else fnmatch.fnmatchcase(one.name, pattern):
                found.setdefault(one.name, one)
    dead = [
        place for place, answers in zip(elsewhere, asked[len(entries) :], strict=True)
        if not answers
    ]
    return [found[name] for name in sorted(found)], dead


def there(endpoints: Sequence[str]) -> list[Found]:
    """The targets that answer at ``endpoints``, by name, whatever runs on this computer.

    Raises
    ------
    LinkError
        No target answers.
    """
    answers = _ask_all([([endpoint], None) for endpoint in endpoints], 3.0)
    found = {one.name: one for some in answers for one in some}
    if not found:
        why = doubts(Credentials.from_environment(), endpoints)
        why = why or "is it running, and may this host reach it?"
        raise LinkError(f"no target answers at {', '.join(endpoints)}: {why}")
    return [found[name] for name in sorted(found)]


def unreachable(entry: registry.Entry) -> str:
    """Why a target of this user cannot be connected to; empty where its socket exists."""
    sockets = [
        endpoint.partition("/")[2] for endpoint in reach(entry)[0] if endpoint.startswith(SOCKET)
    ]
    if not sockets or any(map(os.path.exists, sockets)):
        return ""
    return (
        f"{entry.name} runs here (process {entry.pid}), but its socket {sockets[0]} was removed:"
        f" 'zendsp stop {entry.name}' stops it as ever, nothing else reaches it. 'kill"
        f" {entry.pid}' ends it; then start it again"
    )


def reach(entry: registry.Entry) -> tuple[list[str], Credentials | None]:
    """Endpoint and credentials by which a target's own user reaches it; None where it asks everyone
    for the same credentials.
    """
    sockets = [endpoint for endpoint in entry.endpoints if endpoint.startswith(SOCKET)]
    if sockets or entry.user:
        return sockets or entry.endpoints, Credentials(
            user=entry.user, password=entry.password, own=True
        )
    return entry.endpoints, None


def _ask_all(
    places: Sequence[tuple[Sequence[str], Credentials | None]], timeout: float
) -> list[list[Found]]:
    """The answers of all endpoints, which are asked at once: one that does not answer delays no
    other.
    """
    answers: list[list[Found]] = [[] for _ in places]

    def ask(k: int) -> None:
        endpoints, credentials = places[k]
        answers[k] = _ask(endpoints, timeout, credentials)

    threads = [
        threading.Thread(target=ask, args=(k,), name="looking", daemon=True)
        for k in range(1, len(places))
    ]
    for thread in threads:
        thread.start()
    if places:
        ask(0)
    for thread in threads:
        thread.join()
    return answers


def _ask(
    endpoints: Sequence[str], timeout: float, credentials: Credentials | None = None
) -> list[Found]:
    try:
        credentials = credentials or Credentials.from_environment()
        session = open_session(endpoints, credentials, timeout)
    except LinkError:
        return []
    found = []
    try:
        answers = session.get(keys.info(), timeout=timeout)
        for reply in answers:
            if reply.ok is None:
                continue
            name = keys.target_of(str(reply.ok.key_expr))
            try:
                info = codec.decode(reply.ok.payload.to_bytes(), m.Info)
                codec.check_version(info.v)
                status = _status(session, name, credentials.identity)
                found.append(Found(name, tuple(endpoints), info, status=status))
            except VersionMismatch as error:
                found.append(Found(name, tuple(endpoints), None, str(error)))
            except LinkError as error:
                found.append(
                    Found(name, tuple(endpoints), None, f"its description cannot be read: {error}")
                )
    finally:
        session.close()  # type: ignore[no-untyped-call]
    return found


def _status(session: zenoh.Session, name: str, identity: str) -> m.Status | None:
    asked = codec.encode_request("status", {}, identity)
    key, wait = keys.rpc(name, "quick", identity), VERBS["status"].timeout
    with contextlib.suppress(ZendspError):  # of another role, or it has just ended
        for reply in session.get(key, payload=asked, timeout=wait):
            if reply.ok is not None:
                said: m.Status = codec.decode_reply(reply.ok.payload.to_bytes(), m.Status)
                return said
    return None
