"""Rows: recorded, fetched and seen live."""

from __future__ import annotations

from zendsp_protocol.messages.base import Message
from zendsp_protocol.messages.program import Change, Program
from zendsp_protocol.states import RecorderState
from zendsp_protocol.values import WireValue


class Trigger(Message, frozen=True):
    """When a recording starts."""

    source: str  # variable or element
    level: float  # to cross
    edge: str = "rising"  # rising, falling or both
    pre_s: float = 0.0  # s to keep from before


class AcquireStatus(Message, frozen=True):
    """State of one acquisition stream."""

    state: RecorderState  # idle, armed, running or done
    channels: tuple[str, ...] = ()  # one for each column
    units: tuple[str, ...] = ()  # one for each column
    decimation: int = 1  # samples per row
    first: int = 0  # index of the oldest row still held
    count: int = 0  # rows written so far
    wanted: int = 0  # rows of a single shot; 0 for a continuous ring
    lost: int = 0  # rows that were overwritten or never stored
    # where samples were left out: [row, rows that are missing before it, all together]
    gaps: tuple[tuple[int, int], ...] = ()
    start_tick: int = 0  # sample of row 0
    trigger_row: int = -1  # row at which the trigger fired; -1 where none
    begun: int = 0  # number of its rows: another when it is configured, or started again
    replaced: bool = False  # the program that made the rows is loaded no more: see acquire_program


class Held(Message, frozen=True, kw_only=True):
    """Where the recorder keeps its rows, for a host of the target's own user on the same computer.
    """

    kernel: str = ""  # boot of the computer, as in /proc/sys/kernel/random/boot_id
    path: str = ""  # of the file; empty where nothing is configured
    device: int = 0  # of the file, st_dev; with the next two, to know it again
    inode: int = 0  # of the file, st_ino
    offset: int = 0  # bytes; where row 0 stands
    columns: int = 0  # float64, little endian, in each row
    capacity: int = 0  # rows; row k stands where row k + capacity will
    first: int = 0  # index of the oldest row still held
    count: int = 0  # rows written so far


class Replaced(Message, frozen=True, kw_only=True):
    """What the recorder's rows were made by, where that program is loaded no more."""

    program: Program = Program()  # as it was sent
    tick: int = 0  # sample of the values
    values: dict[str, WireValue] = {}  # its parameters at the end; empty where it had crashed
    log: tuple[Change, ...] = ()  # their changes


class LiveOpened(Message, frozen=True, kw_only=True):
    """A live stream: subscribe to ``key``."""

    stream: int  # number, for live_close
    key: str  # to subscribe to
    channels: tuple[str, ...]  # one per column
    units: tuple[str, ...]  # one for each column
    sample_time: float  # s between rows


class LiveHeader(Message, frozen=True, kw_only=True):
    """Attachment of each live message; its payload holds ``rows × columns`` float64, little endian,
    row by row.
    """

    v: int  # protocol version
    session: int  # changes whenever the stream is configured again
    first: int  # index of the first row; a gap to the last message means rows that were skipped
    rows: int  # in this message
    columns: tuple[str, ...]  # names
    tick: int  # of the first row
    decimation: int  # samples per row
    lost: int  # rows overwritten before the server could send them, in all


class ChunkHeader(Message, frozen=True, kw_only=True):
    """Attachment of each reply of ``acquire_read``; the payload holds the rows, float64, little
    endian.
    """

    v: int  # protocol version
    first: int  # index of the first row
    rows: int  # in this chunk
    columns: int  # in each row
    crc: int  # folded CRC-32 of the payload, see chunks.folded_crc
