"""Reads what certificates (PEM) state, with the standard library alone."""

from __future__ import annotations

import ssl
import time
from typing import Any


def decoded(path: str) -> dict[str, Any]:
    """Return the fields of a certificate; empty where it cannot be read."""
    try:
        # the standard library's only reader of a file
        found: dict[str, Any] = ssl._ssl._test_decode_cert(path)  # type: ignore[attr-defined]
        return found
    except (AttributeError, OSError, ssl.SSLError):
        return {}


def ended(path: str) -> str:
    """Return the day on which a certificate ended; empty where it is still good."""
    until = decoded(path).get("notAfter")
    try:
        seconds = ssl.cert_time_to_seconds(until) if until else float("inf")
    except ValueError:
        return ""
    return time.strftime("%Y-%m-%d", time.gmtime(seconds)) if seconds < time.time() else ""


def unfit(certificate: str, key: str) -> bool:
    """Whether a private key belongs to another certificate."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(certificate, key, lambda: "")
    except (OSError, ssl.SSLError):
        return True
    return False
