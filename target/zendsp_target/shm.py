"""Files in shared memory: plain ``mmap`` on ``/dev/shm``, in a folder that its owner's lock marks as alive.

Not ``multiprocessing.shared_memory``: its resource tracker deletes a segment when a process that merely attached exits.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import shutil
import tempfile
import uuid
import weakref
from pathlib import Path
from typing import Any

from zendsp_target.layout import layout

_PREFIX = "zendsp-"


def _base() -> Path:
    shm = Path("/dev/shm")
    return shm if shm.is_dir() and os.access(shm, os.W_OK) else Path(tempfile.gettempdir())


def _remove_abandoned(base: Path) -> None:
    """Folders whose owner is gone: nobody holds their lock any more."""
    for folder in base.glob(f"{_PREFIX}*"):
        lock = folder / "lock"
        try:
            with lock.open("r+") as handle:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue  # alive, another user's, or not ours at all


def _available_memory() -> int:
    """Bytes that programs may still take, as the kernel reckons."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError, IndexError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


class SharedFolder:
    """A folder in shared memory that lives as long as its owner."""

    def __init__(self) -> None:
        base = _base()
        _remove_abandoned(base)
        self.path = base / f"{_PREFIX}{os.getpid()}-{uuid.uuid4().hex[:8]}"
        self.path.mkdir(mode=0o700)
        self._lock = (self.path / "lock").open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def free_bytes(self) -> int:
        """Bytes that still fit, into the file system and into memory, which it is made of."""
        status = os.statvfs(self.path)
        return min(status.f_bavail * status.f_frsize, _available_memory())

    def close(self) -> None:
        """Remove the folder and all files in it; mappings stay valid until they are dropped."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.close()


class SharedFile:
    """One mapped file; the mapping lives as long as the last reference to its memory.

    Parameters
    ----------
    path : Path
    size : int or None
        Create the file with so many bytes, allocated now (a full /dev/shm is an error here, not a crash later); None: map it
        as it is.
    """

    def __init__(self, path: Path, size: int | None = None) -> None:
        self.path = path
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if size is not None else 0)
        file = os.open(path, flags, 0o600)
        try:
            if size is not None:
                os.posix_fallocate(file, 0, size)
            self.map = mmap.mmap(file, 0)
        except OSError:
            if size is not None:
                os.unlink(path)
            raise
        finally:
            os.close(file)
        ffi, _ = layout()
        self._buffer = ffi.from_buffer(self.map, require_writable=True)

    def pointer(self, type_name: str, offset: int = 0) -> Any:
        """Address within the file as a cffi pointer; keep this object alive while it is used."""
        ffi, _ = layout()
        return ffi.cast(f"{type_name} *", self._buffer + offset)

    def reader(self) -> Path:
        """A path by which other processes of this user can read the file, also without its name."""
        file = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
        weakref.finalize(self, os.close, file)
        return Path(f"/proc/{os.getpid()}/fd/{file}")

    def unlink(self) -> None:
        """Remove the name; the memory stays until it is dropped."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
