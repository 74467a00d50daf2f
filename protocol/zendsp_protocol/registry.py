"""The entries by which targets of this computer are found: one small file each, in the user's
runtime directory.

Only names and formats stand here; the target writes the files, the host reads them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import msgspec


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """The entry of a target that runs on this computer."""

    name: str
    pid: int
    # start time of the process as the kernel states it, since numbers of processes are used again
    born: str
    endpoints: list[str]
    machine: str
    protocol: int
    # of the token where it listens on a port that other users of this machine can reach
    user: str = ""
    password: str = ""
    instance: str = ""  # of this run, as in Info: the next of the same name has another
    stop: str = ""  # path of its stop page, see stop_page.py


# where entries of a user stand whose sessions have the variable of XDG, and where those without
STANDARD = ("/run/user/{uid}/zendsp", "/tmp/zendsp-{uid}")


def folder(environment: Mapping[str, str] = os.environ) -> str:
    """Folder of the entries: ``$ZENDSP_RUNTIME_DIR``, ``$XDG_RUNTIME_DIR/zendsp`` or
    ``/tmp/zendsp-<uid>``.
    """
    return folders(environment)[0]


def folders(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Folders in which a host looks for entries, that of `folder` first.

    A service, ``cron``, ``su`` or a connection without a session has no ``$XDG_RUNTIME_DIR``: who
    says STOP there means a target that was started in a session too.
    """
    own = environment.get("ZENDSP_RUNTIME_DIR")
    if own:
        return [own]
    runtime = environment.get("XDG_RUNTIME_DIR")
    standard = [place.format(uid=os.getuid()) for place in STANDARD]
    first = os.path.join(runtime, "zendsp") if runtime else standard[-1]
    return list(dict.fromkeys([first, *standard]))


def steady(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is no link of another user, who could point it elsewhere between two uses.
    """
    return os.lstat(path).st_uid in (os.getuid(), 0)


def file_name(target: str) -> str:
    """File of one target's entry."""
    return f"{target}.json"


def socket_name(target: str) -> str:
    """File of the socket on which a target listens, beside its entry."""
    return f"{target}.sock"


def born(pid: int) -> str:
    """Start time of a process in clock ticks since boot, empty where it does not run."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            fields = file.read().rpartition(")")[2].split()
    except OSError:
        return ""
    # state and starttime, proc(5); of one that ends just then there may be nothing to read
    return "" if not fields or fields[0] in "ZX" else fields[19]
