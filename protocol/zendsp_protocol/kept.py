"""The note that a target keeps in shared memory for the case that it is killed: what it was
recording, and where the rows are.

The target writes the note when a recording begins. A reader who finds the note while the lock of
its folder is free knows that the target was killed. The rows are in the file beside it, float64 in
the byte order of the machine.
"""

from __future__ import annotations

import fcntl
import os
import stat
import struct
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import msgspec

from zendsp_protocol.messages import Program
from zendsp_protocol.values import WireValue, enc_hook

PREFIX = "zendsp-"  # of a target's folder
LOCK = "lock"  # held by the target as long as it lives
NOTE = "recording"
MOST = 3  # recordings of killed targets that are kept; the next start removes older ones


class About(msgspec.Struct, frozen=True, kw_only=True):
    """What was recorded, by whom, and how."""

    target: str
    machine: str
    rate_hz: float
    begun: float  # Unix s
    since_start: float = 0.0  # s of the computer's: orders them, since the time of day may be set
    program: Program
    parameters: Mapping[str, WireValue]  # values when the recording began
    versions: dict[str, str]
    extra: dict[str, str]


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """The note: what was recorded, and where it stands."""

    about: About
    file: str  # name, in the same folder
    rows_at: int  # byte of row 0
    capacity: int  # rows held; row r stands at r mod capacity
    columns: tuple[str, ...]
    units: tuple[str, ...]
    decimation: int
    rows: int  # of a shot, or promised to be held by a ring
    pre: int  # rows before the trigger
    ring: bool
    triggered: bool
    count_at: int  # bytes of the words that the loop writes: rows written,
    start_at: int  # tick of row 0,
    fired_at: int  # row of the trigger (-1: not yet),
    missed_at: int  # rows that were lost,
    gaps_at: int  # how many gaps, and what `AcquireStatus` has of each
    gaps_held: int  # the newest: gap n stands at n mod gaps_held

    def word(self, folder: Path, at: int) -> int:
        """The value of a word that the loop wrote."""
        with (folder / self.file).open("rb") as file:
            file.seek(at)
            found: int = struct.unpack("=q", file.read(8))[0]
            return found

    def gaps(self, folder: Path) -> tuple[tuple[int, int], ...]:
        """Where rows are missing, as in `AcquireStatus`."""
        words = 1 + 2 * self.gaps_held
        with (folder / self.file).open("rb") as file:
            file.seek(self.gaps_at)
            found, *held = struct.unpack(f"={words}q", file.read(8 * words))
        newest = (2 * (n % self.gaps_held) for n in range(max(0, found - self.gaps_held), found))
        return tuple((held[i], held[i + 1]) for i in newest)

    def count(self, folder: Path) -> int:
        """Rows written; 0 where the file is gone or cut."""
        try:
            return self.word(folder, self.count_at)
        except (OSError, struct.error):
            return 0


def first_row(count: int, fired: int, rows: int, pre: int, ring: bool, triggered: bool) -> int:
    """Number of the first row that belongs to a recording.

    Parameters
    ----------
    count : int
        Rows written.
    fired : int
        Row of the trigger, -1: not yet.
    rows, pre, ring, triggered
        As in `Kept`.
    """
    if fired >= 0:
        first = max(0, fired - pre)
        return max(first, count - rows) if ring else first
    return max(0, count - rows) if ring or triggered else 0


def base() -> Path:
    """The folder in which targets have their folders."""
    shm = Path("/dev/shm")
    return shm if shm.is_dir() and os.access(shm, os.W_OK) else Path(tempfile.gettempdir())


def write(folder: Path, note: Kept) -> None:
    """Write the note of a recording that begins; whole or not at all."""
    temporary = folder / f"{NOTE}.part"
    temporary.write_bytes(msgspec.msgpack.encode(note, enc_hook=enc_hook))
    os.replace(temporary, folder / NOTE)


def read(folder: Path) -> Kept | None:
    """The note of a folder; None where there is none of this version, or where no row was written.
    """
    try:
        note = msgspec.msgpack.decode((folder / NOTE).read_bytes(), type=Kept)
    except (OSError, msgspec.MsgspecError):
        return None
    return note if note.count(folder) > 0 and os.path.basename(note.file) == note.file else None


@contextmanager
def abandoned() -> Iterator[Iterator[Path]]:
    """Folders of this user's targets that were killed. Several processes may look at once: the
    owner's lock is exclusive, theirs is shared.
    """
    locks = []

    def each() -> Iterator[Path]:
        for folder in sorted(base().glob(f"{PREFIX}*")):
            try:
                found = folder.lstat()  # no link: who planted it could turn it at any time
                if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode):
                    continue
                lock = (folder / LOCK).open("r+")
                locks.append(lock)
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                continue  # alive
            yield folder

    try:
        yield each()
    finally:
        for lock in locks:
            lock.close()
