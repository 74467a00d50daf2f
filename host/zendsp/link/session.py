"""Opens Zenoh sessions with targets, says which targets exist, and names this connection."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence

import zenoh

from zendsp.errors import LinkError
from zendsp.here.registered import local_entries
from zendsp.here.stop_page import own_name
from zendsp.link.settings import Credentials, doubts, zenoh_config
from zendsp_protocol import keys
from zendsp_protocol.files_left import need_files

_numbers = itertools.count(1)
_opened: set[int] = set()  # process ids; a fork leaves the threads of Zenoh behind

SOCKET = "unixsock-stream/"
REFUSES = (
    ", or it refuses the certificate or password given, or its own certificate is not of the"
    " authority given"
)

NOTHING_GIVEN = (
    ", or it asks for a certificate ($ZENDSP_TLS_CERT, $ZENDSP_TLS_KEY) or a password"
    " ($ZENDSP_USER, $ZENDSP_PASSWORD), of which none is given, or its own certificate is not of"
    " the authority given"
)


def open_session(
    endpoints: Sequence[str], credentials: Credentials, timeout: float
) -> zenoh.Session:
    """Open a Zenoh session with at least one of ``endpoints``.

    Raises
    ------
    LinkError
        None answers; or, indistinguishable for Zenoh, the credentials are refused; or this process
        may not open enough files, or was forked from one that had connected.
    """
    need_files()
    if _opened - {os.getpid()}:
        raise LinkError(
            "this process was forked from one that had connected, and Zenoh's threads are not here:"
            " start it afresh (multiprocessing.get_context('spawn'), subprocess)"
        )
    _opened.add(os.getpid())
    where = ", ".join(endpoints)
    try:
        session = zenoh.open(zenoh_config(endpoints, credentials, timeout))
        if session.info.routers_zid():  # which hand nothing from peer to peer
            session.close()  # type: ignore[no-untyped-call]
            session = zenoh.open(zenoh_config(endpoints, credentials, timeout, "client"))
    except zenoh.ZError as error:
        if wrong := doubts(credentials, endpoints):
            raise LinkError(f"nothing answers at {where}: {wrong}") from error
        if frozen := silent(endpoints):
            raise LinkError(f"{frozen} (asked for {timeout:g} s)") from error
        raise LinkError(
            f"nothing answers at {where} within {timeout:g} s{_refusal(endpoints, credentials)}."
            " Is the target running?"
        ) from error
    if not session.info.peers_zid() and not session.info.routers_zid():
        session.close()  # type: ignore[no-untyped-call]
        raise LinkError(f"nothing answers at {where}{REFUSES}")
    return session


def _refusal(endpoints: Sequence[str], credentials: Credentials) -> str:
    """What a target that is there may have against this host, as a clause."""
    secured = any(endpoint.startswith(("tls/", "quic/")) for endpoint in endpoints)
    if secured and not credentials.certificate and not credentials.user:
        return NOTHING_GIVEN
    if secured or credentials.user:
        return REFUSES
    plain = any(endpoint.startswith("tcp/") for endpoint in endpoints)
    return ", or it asks for a password or for encryption (tls/ in place of tcp/)" if plain else ""


def silent(endpoints: Sequence[str]) -> str:
    """What is known of a target of this user on this computer that does not answer at
    ``endpoints``; empty where none of these is its socket. (Elsewhere it may refuse the caller.)
    """
    sockets = {endpoint for endpoint in endpoints if endpoint.startswith(SOCKET)}
    for entry in local_entries():
        if sockets & {*entry.endpoints}:
            return (
                f"{entry.name} runs here (process {entry.pid}) and does not answer: it is stopped"
                f" (kill -STOP, a debugger) or hangs. 'zendsp stop {entry.name}' stops its machine"
                f" all the same. 'kill -CONT {entry.pid}' lets it go on, 'kill -KILL {entry.pid}'"
                " ends it"
            )
    return ""


def not_there(session: zenoh.Session, target: str, endpoints: Sequence[str]) -> str:
    """A sentence on a target that does not exist, and on those that do."""
    names = [
        keys.target_of(str(reply.ok.key_expr))
        for reply in session.liveliness().get(keys.alive(), timeout=0.5)
        if reply.ok is not None
    ]
    there = f"there is {', '.join(sorted(names))}" if names else "no target is there"
    if not names and any(endpoint.startswith(("tls/", "quic/")) for endpoint in endpoints):
        there += (
            ", or it has no role for this certificate (zendsp keys list; a new name is let in when"
            " the target starts again)"
        )
    return f"no target named {target!r} at {', '.join(endpoints)}; {there}"


def new_author(identity: str = "") -> str:
    """The name of a new connection: user, computer, process, and from the second connection on a
    number. It is valid in a key.
    """
    number = next(_numbers)
    name = own_name(identity) + (f".{number}" if number > 1 else "")
    return re.sub(r"[^\w@:.-]", "_", name)
