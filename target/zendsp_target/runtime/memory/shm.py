"""Files in shared memory: plain ``mmap`` on ``/dev/shm``, in a folder with a lock that its owner
holds as long as it runs.

Not ``multiprocessing.shared_memory``: its resource tracker deletes a segment when a process that
merely attached exits.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import mmap
import os
import shutil
import uuid
import weakref
from pathlib import Path
from typing import Any

from zendsp_protocol import kept
from zendsp_protocol.errors import Refused
from zendsp_protocol.kept import Kept
from zendsp_target.runtime.memory.layout import layout


def _clear_abandoned() -> tuple[list[Kept], list[Kept]]:
    """Remove what killed targets left behind, except for the rows that the last few had recorded.
    Returns the recordings that stay and those that were removed.
    """
    with kept.abandoned() as folders:
        found: list[tuple[float, Path, Kept]] = []
        for folder in folders:
            note = kept.read(folder)
            if note is None:
                shutil.rmtree(folder, ignore_errors=True)
                continue
            found.append((note.about.since_start, folder, note))
            for path in folder.iterdir():
                if path.name not in (kept.LOCK, kept.NOTE, note.file):
                    path.unlink(missing_ok=True)
        found.sort(key=lambda one: one[0], reverse=True)
        for _, folder, _ in found[kept.MOST :]:
            shutil.rmtree(folder, ignore_errors=True)
    notes = [note for _, _, note in found]
    return notes[: kept.MOST], notes[kept.MOST :]


def _available_memory() -> int:
    """Bytes that programs may still take, as the kernel estimates."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(
            int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")
        )
    except (OSError, StopIteration, ValueError, IndexError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


class SharedFolder:
    """A folder in shared memory that lives as long as its owner.

    Attributes
    ----------
    kept, dropped : list of Kept
        What targets that were killed had recorded: what stays in shared memory, and what was
        removed now.
    """

    def __init__(self) -> None:
        self.kept, self.dropped = _clear_abandoned()
        self.path = kept.base() / f"{kept.PREFIX}{os.getpid()}-{uuid.uuid4().hex[:8]}"
        making = self.path.with_name(f".{self.path.name}")  # nobody may find it before it is locked
        making.mkdir(mode=0o700)
        self._lock = (making / kept.LOCK).open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        making.rename(self.path)

    def free_bytes(self) -> int:
        """Bytes that still fit, both into the file system and into the memory behind it."""
        status = os.statvfs(self.path)
        return min(status.f_bavail * status.f_frsize, _available_memory())

    def close(self) -> None:
        """Remove the folder and all files in it; what is mapped stays readable until it is
        unmapped.
        """
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.close()


class SharedFile:
    """One mapped file; the mapping lives as long as the last reference to its memory.

    Parameters
    ----------
    size : int or None
        Create the file with so many bytes, allocated now (a full /dev/shm is an error here, not a
        crash later); None: map it as it is.

    Raises
    ------
    Refused
        There is not so much.
    """

    def __init__(self, path: Path, size: int | None = None) -> None:
        self.path = path
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if size is not None else 0)
        file = os.open(path, flags, 0o600)
        try:
            if size is not None:
                os.posix_fallocate(file, 0, size)
            self.map = mmap.mmap(file, 0)
        except OSError as error:
            if size is not None:
                os.unlink(path)
                if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM):
                    raise Refused(
                        f"{size / 1e6:.3g} MB of shared memory are not free for {path}: make room"
                        " ('df -h /dev/shm'; end other targets, remove files), and try again"
                    ) from error
            raise OSError(error.errno, error.strerror, str(path)) from error
        finally:
            os.close(file)
        ffi, _ = layout()
        self._buffer = ffi.from_buffer(self.map, require_writable=True)

    def pointer(self, type_name: str, offset: int = 0) -> Any:
        """Address within the file as a cffi pointer; keep this object alive while it is used."""
        ffi, _ = layout()
        return ffi.cast(f"{type_name} *", self._buffer + offset)

    def reader(self) -> Path:
        """A path by which other processes of this user can read the file, even after its name was
        removed.
        """
        file = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
        weakref.finalize(self, os.close, file)
        return Path(f"/proc/{os.getpid()}/fd/{file}")

    def unlink(self) -> None:
        """Remove the name; the memory stays until it is dropped."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
