"""The table of verbs: one row per request, with its arguments, its result, its lane and how long it
may take.

To add a verb: write its arguments here, add a row, and give the target a handler of the same name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from zendsp_protocol import messages as m
from zendsp_protocol.states import DriveAction, DriveMode, HostLost, OverrunPolicy
from zendsp_protocol.values import Packed, WireValue


class Arguments(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all arguments: unknown fields are refused, so that a misspelled one is not silently
    ignored.
    """


class Nothing(Arguments, frozen=True, kw_only=True):
    """No arguments."""


class Compile(Arguments, frozen=True, kw_only=True):
    """C sources that the target compiles."""

    sources: dict[str, str]  # file name to text
    flags: list[str] = []  # for the compiler


class Load(Arguments, frozen=True, kw_only=True):
    """Which of the compiled programs is loaded."""

    key: str  # of CompileResult


class Start(Arguments, frozen=True, kw_only=True):
    """How long the program runs, and whether its host must stay."""

    ticks: int | None = None  # samples after which it pauses; nil: none
    attended: bool = False  # if this host is lost before a pause, the host-lost policy acts


class Read(Arguments, frozen=True, kw_only=True):
    """Which values are read, and after which write."""

    names: list[str]  # of variables, or elements of arrays
    after: int = 0  # `sequence` of a write whose values are to be seen


class Write(Arguments, frozen=True, kw_only=True):
    """Values, and when and how fast they take effect: of ``check``, ``write`` and ``update``."""

    values: dict[str, WireValue]  # by name
    at_tick: int | None = None  # sample at whose start they take effect; nil: the next
    fade: float = 0.0  # s, over which numbers go over to their new values; at most 2


class Wait(Arguments, frozen=True, kw_only=True):
    """For which write to wait, and for how long."""

    sequence: int  # of Written
    timeout: float = 2.0  # s


class Log(Arguments, frozen=True, kw_only=True):
    """From where on the log is told."""

    since: int = 0  # lines that are left out, the oldest first


class SetLimits(Arguments, frozen=True, kw_only=True):
    """Limits, SI: only those that are given change."""

    position_min: list[float] | None = None  # rad or m, one number a joint; nil: as it is
    position_max: list[float] | None = None  # rad or m
    speed_max: list[float] | None = None  # rad/s or m/s
    torque_max: list[float] | None = None  # N m or N
    command_max: list[float] | None = None  # mV
    torque_clamp: bool | None = None  # true: clamp a command at its limit; false: trip


class SetDrive(Arguments, frozen=True, kw_only=True):
    """When the drives are on."""

    mode: DriveMode  # auto: on at start, off at pause


class SetRamp(Arguments, frozen=True, kw_only=True):
    """Time of the soft start and the soft stop."""

    seconds: float  # s


class SetOverrun(Arguments, frozen=True, kw_only=True):
    """What an overrun does."""

    policy: OverrunPolicy
    limit: int = 10  # overruns in a row after which it trips


class SetInputs(Arguments, frozen=True, kw_only=True):
    """Digital inputs of a simulated machine."""

    bits: int  # one an input, the first the lowest


class Drive(Arguments, frozen=True, kw_only=True):
    """A step of the safe sequence; each of the other fields belongs to one action."""

    action: DriveAction
    mode: DriveMode = DriveMode.TORQUE  # of enable: torque or velocity
    force: bool = False  # of take
    policy: HostLost = HostLost.STOP  # of host_lost


class Acknowledge(Arguments, frozen=True, kw_only=True):
    """Which trip is acknowledged; nil: whichever is latched."""

    trip: int | None = None  # number of the one that is meant: no other is acknowledged


class RunBegin(Arguments, frozen=True, kw_only=True):
    """What a run sets, and what happens at its end."""

    names: list[str]  # what the run will set; those that the program lacks are left out
    moves: bool = False  # it moves the machine: if its host is lost, the host-lost policy acts
    fade: float = 0.0  # s, over which it is put back while the program runs; at most 2


class RunEnd(Arguments, frozen=True, kw_only=True):
    """Which run ends."""

    run: int  # of RunBegun


class AcquireConfigure(Arguments, frozen=True, kw_only=True):
    """What the recorder records, how often, how long and from when on."""

    channels: list[str]  # variables or elements
    decimation: int = 1  # samples per row
    seconds: float = 1.0  # s, length; of a continuous ring, what it holds
    trigger: m.Trigger | None = None  # nil: at once
    continuous: bool = False  # a ring, which runs until acquire_stop
    take: bool = False  # also when another host is recording


class AcquireStart(Arguments, frozen=True, kw_only=True):
    """Whether the trigger is waited for."""

    force: bool = False  # fires the trigger by hand
    begun: int | None = None  # as of acquire_stop


class OfRows(Arguments, frozen=True, kw_only=True):
    """Of which rows the recorder is asked."""

    begun: int | None = None  # of AcquireStatus: refused where it has others; nil: any


class AcquireStatus(OfRows, frozen=True, kw_only=True):
    """Of which rows it is asked, and whether their host has them."""

    loaded: bool = False  # all are brought home: other hosts may record


class AcquireRead(Arguments, frozen=True, kw_only=True):
    """Which rows are sent, and in parts of what size."""

    first: int  # index of a row
    count: int  # rows
    chunk: int = 1 << 20  # bytes of one reply, about
    begun: int | None = None  # as of acquire_stop


class TableBegin(Arguments, frozen=True, kw_only=True):
    """The array that is uploaded, and what has to arrive."""

    name: str  # of the table, or array
    dtype: str  # as of packed values
    length: int  # elements
    crc: int  # CRC-32 of all bytes


class TableChunk(Arguments, frozen=True, kw_only=True):
    """A part of an upload; it may be sent again."""

    upload: int  # of TableState
    offset: int  # bytes
    data: bytes  # little endian
    crc: int  # CRC-32 of data


class TableCommit(Arguments, frozen=True, kw_only=True):
    """Which upload takes effect, and when; refused until all of its bytes are there."""

    upload: int  # of TableState
    at_tick: int | None = None  # as of write


class TableState(m.Message, frozen=True, kw_only=True):
    """An upload: bytes received so far without a gap."""

    upload: int  # number, for table_chunk and table_commit
    received: int  # bytes


class LiveOpen(Arguments, frozen=True, kw_only=True):
    """What a live stream carries, and how often."""

    channels: list[str]  # variables or elements
    decimation: int = 1  # samples per row
    interval: float = 0.001  # s between messages at the least
    window: int = 4096  # rows of one message at the most; older ones are skipped


class LiveClose(Arguments, frozen=True, kw_only=True):
    """Which live stream is left."""

    stream: int  # of LiveOpened


@dataclass(frozen=True)
class Verb:
    """One row of the table."""

    name: str
    arguments: type[Arguments]
    result: Any
    lane: str
    timeout: float = 5.0  # s, after which a host gives up
    role: str = ""  # that a host needs at least, see ROLES
    does: str = ""  # for docs/protocol.md
    # carried out once, however often it is sent (once.py). Of other verbs it does not matter: they
    # read, stop, or name their own place in the data
    once: bool = False


# What a host may do; each includes those before it. STOP is open to every host that was let in.
ROLES = ("observe", "tune", "command", "download")

_ROWS = (
    Verb(
        "info", Nothing, m.Info, "quick", role="observe",
        does="who the target is",
    ),
    Verb(
        "status", Nothing, m.Status, "quick", role="observe",
        does="its state now",
    ),
    Verb(
        "stop", Nothing, m.Empty, "stop", role="observe",
        does="STOP: latched, safe outputs",
    ),
    Verb(
        "stopped", Nothing, m.Status, "stop", role="observe",
        does="as `status`, past whatever holds up the other lanes",
    ),
    Verb(
        "compile", Compile, m.CompileResult, "slow", 120.0, role="download",
        does="compiles C sources; loads nothing",
    ),
    Verb(
        "load", Load, m.Empty, "slow", 30.0, role="download", once=True,
        does="loads a compiled program, in place of the one that is loaded",
    ),
    Verb(
        "unload", Nothing, m.Empty, "slow", 30.0, role="download", once=True,
        does="removes the program",
    ),
    Verb(
        "start", Start, m.Empty, "quick", role="command", once=True,
        does="starts or continues the program",
    ),
    Verb(
        "pause", Nothing, m.Empty, "quick", role="command", once=True,
        does="pauses it, with a soft stop",
    ),
    Verb(
        "program", Nothing, m.Program, "quick", role="observe",
        does="the loaded program, as it was sent",
    ),
    Verb(
        "variables", Nothing, tuple[m.VariableInfo, ...], "quick", role="observe",
        does="its variables",
    ),
    Verb(
        "read", Read, m.Reading, "quick", role="observe",
        does="values, all from one sample",
    ),
    Verb(
        "check", Write, m.Empty, "quick", role="observe",
        does="refuses what `write` would; writes nothing",
    ),
    Verb(
        "write", Write, m.Written, "quick", role="tune", once=True,
        does="hands values to the loop",
    ),
    Verb(
        "update", Write, m.Applied, "sync", role="tune", once=True,
        does="the same, answered when they have taken effect",
    ),
    Verb(
        "wait_applied", Wait, m.Applied, "slow", 60.0, role="observe",
        does="waits until a `write` has taken effect",
    ),
    Verb(
        "builtins", Nothing, tuple[m.VariableInfo, ...], "quick", role="observe",
        does="signals of every program: tick, t, exec_us, enc, aout, …",
    ),
    Verb(
        "machine", Nothing, m.MachineInfo, "quick", role="observe",
        does="what the machine says of itself",
    ),
    Verb(
        "limits", Nothing, m.Limits, "quick", role="observe",
        does="the limits that are checked",
    ),
    Verb(
        "set_limits", SetLimits, m.Applied, "quick", role="command", once=True,
        does="tightens or loosens them, never beyond what the machine bears",
    ),
    Verb(
        "set_drive", SetDrive, m.Empty, "quick", role="command", once=True,
        does="tells the drives their mode",
    ),
    Verb(
        "set_ramp", SetRamp, m.Empty, "quick", role="command", once=True,
        does="time of the soft start and the soft stop",
    ),
    Verb(
        "set_overrun", SetOverrun, m.Empty, "quick", role="command", once=True,
        does="what an overrun does",
    ),
    Verb(
        "set_inputs", SetInputs, m.Empty, "quick", role="command", once=True,
        does="digital inputs of a simulated machine",
    ),
    Verb(
        "home", Nothing, m.Empty, "quick", role="command", once=True,
        does="begins homing; `homed` of the status tells its end",
    ),
    Verb(
        "acknowledge", Acknowledge, m.Said, "quick", role="command", once=True,
        does="ends a STOP or a trip",
    ),
    Verb(
        "drive", Drive, m.Said, "quick", role="command", once=True,
        does="a step of the safe sequence, or the right to command",
    ),
    Verb(
        "drive_status", Nothing, m.DriveStatus, "quick", role="observe",
        does="where the sequence is",
    ),
    Verb(
        "seal", Nothing, m.Seal, "quick", role="observe",
        does="commits to what a simulated machine conceals",
    ),
    Verb(
        "reveal", Nothing, m.Revealed, "quick", role="tune",
        does="tells it",
    ),
    Verb(
        "run_begin", RunBegin, m.RunBegun, "quick", role="tune", once=True,
        does="begins a run: what it sets is put back at its end, or when its host is lost",
    ),
    Verb(
        "run_end", RunEnd, m.Applied, "sync", role="tune",
        does="ends it, and puts back",
    ),
    Verb(
        "log", Log, tuple[m.Change, ...], "quick", role="observe",
        does="changes of parameters",
    ),
    # the target makes up to 2 GB of pages present
    Verb(
        "acquire_configure", AcquireConfigure, m.AcquireStatus, "quick", 30.0, role="tune",
        once=True,
        does="says what the recorder records",
    ),
    Verb(
        "acquire_start", AcquireStart, m.AcquireStatus, "quick", role="tune", once=True,
        does="starts it, or arms the trigger",
    ),
    Verb(
        "acquire_stop", OfRows, m.Empty, "quick", role="tune", once=True,
        does="ends the recording",
    ),
    Verb(
        "acquire_status", AcquireStatus, m.AcquireStatus, "quick", role="observe",
        does="how far it is",
    ),
    Verb(
        "acquire_held", OfRows, m.Held, "quick", role="observe",
        does="where its rows stand in shared memory",
    ),
    Verb(
        "acquire_program", Nothing, m.Replaced, "quick", role="observe",
        does="what made its rows, where that program is loaded no more",
    ),
    Verb(
        "acquire_read", AcquireRead, m.Empty, "bulk", 60.0, role="observe",
        does="sends rows, in parts",
    ),
    Verb(
        "table_begin", TableBegin, TableState, "bulk", role="tune", once=True,
        does="begins the upload of an array",
    ),
    Verb(
        "table_chunk", TableChunk, TableState, "bulk", 20.0, role="tune",
        does="sends a part of it",
    ),
    Verb(
        "table_commit", TableCommit, m.Applied, "bulk", 20.0, role="tune", once=True,
        does="applies it whole, in one sample",
    ),
    Verb(
        "live_open", LiveOpen, m.LiveOpened, "quick", role="observe", once=True,
        does="opens a live stream",
    ),
    Verb(
        "live_close", LiveClose, m.Empty, "quick", role="observe", once=True,
        does="leaves it",
    ),
)
VERBS: dict[str, Verb] = {row.name: row for row in _ROWS}

__all__ = ["ROLES", "VERBS", "Arguments", "Packed", "Verb"]
