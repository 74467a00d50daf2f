"""The entry by which hosts on this machine find the target without an address."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from zendsp_protocol import registry
from zendsp_protocol.errors import Refused
from zendsp_protocol.version import PROTOCOL


def register(name: str, endpoints: list[str], machine: str) -> Path:
    """Write the entry of this process; only this user may read the folder.

    Raises
    ------
    Refused
        A target of that name runs already, or the folder belongs to someone else.
    """
    folder = Path(registry.folder())
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise Refused(f"{folder} belongs to another user; set ZENDSP_RUNTIME_DIR to a folder of your own")
    path = folder / registry.file_name(name)
    check_free(name)
    entry = registry.Entry(
        name=name,
        pid=os.getpid(),
        born=registry.born(os.getpid()),
        endpoints=endpoints,
        machine=machine,
        protocol=PROTOCOL,
    )
    temporary = path.with_suffix(f".{os.getpid()}.part")
    temporary.write_bytes(msgspec.json.encode(entry))
    os.replace(temporary, path)
    return path


def check_free(name: str) -> None:
    """Refuse a name that a running target of this user has.

    Raises
    ------
    Refused
        With the number of the process that has it.
    """
    path = Path(registry.folder()) / registry.file_name(name)
    try:
        entry = msgspec.json.decode(path.read_bytes(), type=registry.Entry)
    except (OSError, msgspec.MsgspecError):
        return
    if entry.pid != os.getpid() and entry.born and registry.born(entry.pid) == entry.born:
        raise Refused(
            f"a target named {name!r} runs here already (process {entry.pid}): stop it or choose --name"
        )


def unregister(path: Path) -> None:
    """Remove the entry if it is still this process's own."""
    try:
        if msgspec.json.decode(path.read_bytes(), type=registry.Entry).pid == os.getpid():
            path.unlink()
    except (OSError, msgspec.MsgspecError):
        pass
