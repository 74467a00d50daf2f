"""Reads what certificates (PEM) state, with the standard library alone."""

from __future__ import annotations

import re
import socket
import ssl
import tempfile
import time
from typing import Any

LOOK_S = 1.0  # for a target to show its certificate


def decoded(path: str) -> dict[str, Any]:
    """Return the fields of a certificate; empty where it cannot be read."""
    try:
        # the standard library's only reader of a file
        found: dict[str, Any] = ssl._ssl._test_decode_cert(path)  # type: ignore[attr-defined]
        return found
    except (AttributeError, OSError, ssl.SSLError):
        return {}


def ended(path: str) -> str:
    """Return the day on which a certificate ended; empty where it has not."""
    end = _seconds(path, "notAfter")
    return _day(end) if end is not None and end < time.time() else ""


def ends_within(path: str, days: float) -> str:
    """Return the day on which a certificate ends, empty where that is later or unknown."""
    end = _seconds(path, "notAfter")
    return _day(end) if end is not None and end < time.time() + 86400.0 * days else ""


def begins(path: str) -> str:
    """Return the day on which a certificate begins; empty where it has begun."""
    begin = _seconds(path, "notBefore")
    return _day(begin) if begin is not None and begin > time.time() else ""


def _seconds(path: str, field: str) -> float | None:
    stated = decoded(path).get(field)
    try:
        return ssl.cert_time_to_seconds(stated) if stated else None
    except ValueError:
        return None


def _day(seconds: float) -> str:
    return time.strftime("%Y-%m-%d", time.gmtime(seconds))


def unfit(certificate: str, key: str) -> bool:
    """Whether a private key belongs to another certificate."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(certificate, key, lambda: "")
    except (OSError, ssl.SSLError):
        return True
    return False


def shown_to_have_ended(endpoint: str) -> str:
    """Return the day on which the certificate that a ``tls/host:port`` shows ended; empty where it
    has not, or nothing is shown.
    """
    found = re.fullmatch(r"tls/\[?([^\]]+?)\]?:(\d+)([?#].*)?", endpoint)
    if found is None:
        return ""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # it is looked at only
    try:
        with (
            socket.create_connection((found[1], int(found[2])), LOOK_S) as plain,
            context.wrap_socket(plain) as secured, tempfile.NamedTemporaryFile("w") as file,
        ):  # fmt: skip
            file.write(ssl.DER_cert_to_PEM_cert(secured.getpeercert(binary_form=True) or b""))
            file.flush()
            return ended(file.name)
    except (OSError, OverflowError):
        return ""
