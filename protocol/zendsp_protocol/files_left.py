"""Counts how many more files this process may open: Zenoh ends a process that has too few left."""

from __future__ import annotations

import contextlib
import errno
import os
import resource

from zendsp_protocol.errors import LinkError

NEEDED = 24  # of a session with its first peers; Zenoh 1 ends the process below some 17


def need_files() -> None:
    """Refuse to begin a session that would end this process.

    Raises
    ------
    LinkError
        Fewer than `NEEDED` files may still be opened.
    """
    opened: list[int] = []
    try:
        for _ in range(NEEDED):
            opened.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            raise
        most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        raise LinkError(
            f"a link needs {NEEDED} more open files, and only {len(opened)} are left of the {most}"
            " that this process may open: allow more, for example by 'ulimit -n 1024'"
        ) from None
    finally:
        for file in opened:
            with contextlib.suppress(OSError):
                os.close(file)
