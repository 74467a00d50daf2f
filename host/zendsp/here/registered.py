"""Targets of this user on this computer, by the entries that they register."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from zendsp_protocol import registry

CONNECT = "ZENDSP_CONNECT"


def local_entries() -> list[registry.Entry]:
    """Targets of this user on this machine whose process lives."""
    found: dict[tuple[str, int], registry.Entry] = {}
    for folder in registry.folders():
        for entry in _entries_in(folder):
            found.setdefault((entry.name, entry.pid), entry)
    return list(found.values())


def _entries_in(folder: str) -> list[registry.Entry]:
    entries = []
    try:
        found = os.stat(folder)
        own = found.st_uid == os.getuid() and registry.steady(folder)
        if not own or found.st_mode & 0o022:
            return []  # somebody else's, or written by others: what stands there may lead anywhere
    except OSError:
        return []
    for path in sorted(Path(folder).glob("*.json")):
        if not path.is_file():  # a pipe, or a device, would never end
            continue
        try:
            entry = msgspec.json.decode(path.read_bytes(), type=registry.Entry)
        except (OSError, msgspec.MsgspecError, RecursionError):
            continue
        if entry.born and registry.born(entry.pid) == entry.born:
            entries.append(entry)
    return entries


def remote_endpoints(connect: str | Sequence[str] | None) -> list[str]:
    """Endpoints given by the caller, or else by ``ZENDSP_CONNECT`` (separated by commas)."""
    if connect is None:
        connect = os.environ.get(CONNECT, "")
    return (
        [part.strip() for part in connect.split(",") if part.strip()]
        if isinstance(connect, str)
        else list(connect)
    )


def own_entries(name: str = "", connect: str | Sequence[str] | None = ()) -> list[registry.Entry]:
    """Targets of this user on this computer that are meant; where endpoints are given, those that
    listen there.
    """
    endpoints = {*remote_endpoints(connect)}
    return [
        entry
        for entry in local_entries()
        if name in ("", entry.name) and endpoints <= {*entry.endpoints}
    ]
