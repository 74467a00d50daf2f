"""STOP through shared memory, for a target of this user on this computer: it needs neither the
target's interpreter nor the link.
"""

from __future__ import annotations

import getpass
import mmap
import os
import struct
import time

from zendsp.here.registered import local_entries
from zendsp_protocol import stop_page as page

POLL_S = 0.0005


class StopPage:
    """The stop page of one target, mapped.

    Raises
    ------
    OSError
        It is gone, not this user's, or of another version.
    """

    def __init__(self, path: str) -> None:
        file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
        try:
            if os.fstat(file).st_uid not in (os.getuid(), 0) or os.fstat(file).st_size != page.SIZE:
                raise OSError(f"{path} is not the stop page of a target of this user")
            self._map = mmap.mmap(file, page.SIZE)
        finally:
            os.close(file)
        if struct.unpack_from(page.HEAD, self._map) != (page.MAGIC, page.VERSION):
            raise OSError(f"{path} was made by another version of zendsp")
        self._author = own_name()
        self._words = memoryview(self._map).cast("Q")  # read whole, unlike by `struct`

    def ask(self, by: str = "") -> int:
        """STOP from the next sample on; returns a number for `taken`. Never waits.

        Parameters
        ----------
        by : str
            The connection that asks; default: this process.
        """
        before = self._words[page.TAKEN // 8]
        self._map[page.BY : page.REASON] = page.signed(by or self._author)
        self._map[page.REASON : page.SIZE] = bytes(page.SIZE - page.REASON)
        self._map[page.STOP] = 1
        return before

    def taken(self, asked: int, timeout: float) -> int | None:
        """Wait until the loop has taken a STOP that was asked for.

        Parameters
        ----------
        asked : int
            From `ask`.
        timeout : float, s

        Returns
        -------
        int or None
            The sample at which it, or an earlier trip, was latched; None where no loop said so in
            time.
        """
        deadline = time.monotonic() + timeout
        while self._words[page.TAKEN // 8] == asked:
            if time.monotonic() > deadline:
                return None
            time.sleep(POLL_S)
        return self._words[page.SAMPLE // 8]

    def by_stop(self) -> bool:
        """Whether a STOP is what is latched, once one is `taken`. Otherwise a trip was latched
        before it, or the target is of an older version, which does not say.
        """
        (reason,) = struct.unpack_from("=I", self._map, page.REASON)
        return bool(reason == page.BY_STOP)


def own_name(identity: str = "") -> str:
    """The name of this process: user (or the name in its certificate), computer and process number.
    """
    try:
        user = identity or getpass.getuser()
    except (KeyError, OSError):  # a container without an entry for its user
        user = str(os.getuid())
    return f"{user}@{os.uname().nodename or 'host'}:{os.getpid()}"


def find(name: str, instance: bytes | None = None) -> StopPage | None:
    """The stop page of a target; None where the target runs elsewhere or belongs to another user.

    Parameters
    ----------
    instance : bytes, optional
        Of its run; default: the one that runs now.
    """
    for entry in local_entries():
        if entry.name == name and entry.stop and instance in (None, bytes.fromhex(entry.instance)):
            try:
                return StopPage(entry.stop)
            except (OSError, ValueError):
                return None
    return None
