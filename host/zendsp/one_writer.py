"""One process at a time writes into a folder."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from zendsp.errors import ZendspError
from zendsp.here.stop_page import own_name

LOCK = ".zendsp.lock"  # in the folder, while somebody writes there


@contextmanager
def one_writer(folder: Path, what: str) -> Iterator[None]:
    """Keep other processes of zendsp from writing into a folder meanwhile. A process that ends,
    however it does, keeps nobody: the kernel takes its lock away. A folder that did not exist, and
    into which nothing was written, is gone afterwards.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    what : str
        That writes there, for the message to another.

    Raises
    ------
    ZendspError
        Another process writes there: which, since when, and what to do.
    """
    place = folder.expanduser().resolve()
    made = [one for one in (place, *place.parents) if not one.exists()]
    file = _locked(place / LOCK, folder)
    try:
        if file is not None:
            now = time.strftime("%H:%M:%S on %d %B %Y")
            with suppress(OSError):  # a full disk
                os.truncate(file, 0)
                said = f"{what} (process {own_name()}) writes there since {now}"
                os.pwrite(file, said.encode(), 0)
        yield
    finally:
        if file is not None:
            with suppress(OSError):
                (place / LOCK).unlink()
            os.close(file)
        with suppress(OSError):  # not empty
            for one in made:
                one.rmdir()


def _locked(path: Path, folder: Path) -> int | None:
    """The open file, locked; None where it cannot be made or its file system has no locks."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)  # another, who made it, may have ended
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        except FileNotFoundError:
            continue
        except OSError:
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = os.pread(file, 400, 0).decode(errors="replace") or "another zendsp writes there"
            os.close(file)
            raise ZendspError(
                f"--out {folder}: {who}: wait until it has ended, or choose another folder"
            ) from None
        except OSError:
            os.close(file)
            return None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.stat(path), os.fstat(file)):
                return file
        os.close(file)  # of a writer that ended meanwhile, and took it away
