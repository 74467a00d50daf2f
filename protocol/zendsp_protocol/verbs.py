"""The table of verbs: one row per request, with its arguments, its result, its lane and how long it
may take.

To add a verb: write its arguments here, add a row, and give the target a handler of the same name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from zendsp_protocol import messages as m
from zendsp_protocol.values import Packed, WireValue


class Arguments(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all arguments: unknown fields are refused, so that a misspelled one is not silently
    ignored.
    """


class Nothing(Arguments, frozen=True, kw_only=True):
    """No arguments."""


class Compile(Arguments, frozen=True, kw_only=True):
    sources: dict[str, str]
    flags: list[str] = []


class Load(Arguments, frozen=True, kw_only=True):
    key: str


class Start(Arguments, frozen=True, kw_only=True):
    ticks: int | None = None
    attended: bool = False  # if this host is lost before a pause, the host-lost policy acts


class Read(Arguments, frozen=True, kw_only=True):
    names: list[str]
    after: int = 0  # number of an update whose values are to be seen


class Write(Arguments, frozen=True, kw_only=True):
    values: dict[str, WireValue]
    at_tick: int | None = None
    fade: float = 0.0  # s, over which numbers go over to their new values; at most 2


class Wait(Arguments, frozen=True, kw_only=True):
    sequence: int
    timeout: float = 2.0


class Log(Arguments, frozen=True, kw_only=True):
    since: int = 0


class SetLimits(Arguments, frozen=True, kw_only=True):
    position_min: list[float] | None = None
    position_max: list[float] | None = None
    speed_max: list[float] | None = None
    torque_max: list[float] | None = None
    command_max: list[float] | None = None
    torque_clamp: bool | None = None


class SetDrive(Arguments, frozen=True, kw_only=True):
    mode: str


class SetRamp(Arguments, frozen=True, kw_only=True):
    seconds: float


class SetOverrun(Arguments, frozen=True, kw_only=True):
    policy: str
    limit: int = 10


class SetInputs(Arguments, frozen=True, kw_only=True):
    bits: int


class Drive(Arguments, frozen=True, kw_only=True):
    # take | release | power_on | power_off | home | enable | disable | acknowledge | auto |
    # host_lost
    action: str
    mode: str = ""  # of enable: torque | velocity
    force: bool = False  # of take
    policy: str = ""  # of host_lost: stop | hold | finish


class Acknowledge(Arguments, frozen=True, kw_only=True):
    trip: int | None = None  # number of the one that is meant: no other is acknowledged


class RunBegin(Arguments, frozen=True, kw_only=True):
    names: list[str]  # what the run will set; those that the program lacks are left out
    moves: bool = False  # it moves the machine: if its host is lost, the host-lost policy acts
    fade: float = 0.0  # s, over which it is put back while the program runs; at most 2


class RunEnd(Arguments, frozen=True, kw_only=True):
    run: int


class AcquireConfigure(Arguments, frozen=True, kw_only=True):
    channels: list[str]
    decimation: int = 1
    seconds: float = 1.0
    trigger: m.Trigger | None = None
    continuous: bool = False
    take: bool = False  # also when another host is recording


class AcquireStart(Arguments, frozen=True, kw_only=True):
    force: bool = False


class AcquireRead(Arguments, frozen=True, kw_only=True):
    first: int
    count: int
    chunk: int = 1 << 20  # bytes of one reply, about


class TableBegin(Arguments, frozen=True, kw_only=True):
    name: str
    dtype: str
    length: int  # elements
    crc: int  # CRC-32 of all bytes


class TableChunk(Arguments, frozen=True, kw_only=True):
    upload: int
    offset: int  # bytes
    data: bytes
    crc: int  # CRC-32 of data


class TableCommit(Arguments, frozen=True, kw_only=True):
    upload: int
    at_tick: int | None = None


class TableState(m.Message, frozen=True, kw_only=True):
    """An upload: bytes received so far without a gap."""

    upload: int  # number, for table_chunk and table_commit
    received: int  # bytes


class LiveOpen(Arguments, frozen=True, kw_only=True):
    channels: list[str]
    decimation: int = 1
    interval: float = 0.001  # s between messages at the least
    window: int = 4096  # rows of one message at the most; older ones are skipped


class LiveClose(Arguments, frozen=True, kw_only=True):
    stream: int


@dataclass(frozen=True)
class Verb:
    """One row of the table."""

    name: str
    arguments: type[Arguments]
    result: Any
    lane: str
    timeout: float = 5.0  # s, after which a host gives up
    role: str = ""  # that a host needs at least, see ROLES
    # carried out once, however often it is sent (once.py). Of other verbs it does not matter: they
    # read, stop, or name their own place in the data
    once: bool = False


# What a host may do; each includes those before it. STOP is open to every host that was let in.
ROLES = ("observe", "tune", "command", "download")

_ROWS = (
    Verb("info", Nothing, m.Info, "quick", role="observe"),
    Verb("status", Nothing, m.Status, "quick", role="observe"),
    Verb("stop", Nothing, m.Empty, "stop", role="observe"),
    # as `status`, past whatever holds up the other lanes
    Verb("stopped", Nothing, m.Status, "stop", role="observe"),
    Verb("compile", Compile, m.CompileResult, "slow", 120.0, role="download"),
    Verb("load", Load, m.Empty, "slow", 30.0, role="download", once=True),
    Verb("unload", Nothing, m.Empty, "slow", 30.0, role="download", once=True),
    Verb("start", Start, m.Empty, "quick", role="command", once=True),
    Verb("pause", Nothing, m.Empty, "quick", role="command", once=True),
    Verb("program", Nothing, m.Program, "quick", role="observe"),
    Verb("variables", Nothing, tuple[m.VariableInfo, ...], "quick", role="observe"),
    Verb("read", Read, m.Reading, "quick", role="observe"),
    Verb("check", Write, m.Empty, "quick", role="observe"),
    Verb("write", Write, m.Written, "quick", role="tune", once=True),
    Verb("update", Write, m.Applied, "sync", role="tune", once=True),
    Verb("wait_applied", Wait, m.Applied, "slow", 60.0, role="observe"),
    Verb("builtins", Nothing, tuple[m.VariableInfo, ...], "quick", role="observe"),
    Verb("machine", Nothing, m.MachineInfo, "quick", role="observe"),
    Verb("limits", Nothing, m.Limits, "quick", role="observe"),
    Verb("set_limits", SetLimits, m.Applied, "quick", role="command", once=True),
    Verb("set_drive", SetDrive, m.Empty, "quick", role="command", once=True),
    Verb("set_ramp", SetRamp, m.Empty, "quick", role="command", once=True),
    Verb("set_overrun", SetOverrun, m.Empty, "quick", role="command", once=True),
    Verb("set_inputs", SetInputs, m.Empty, "quick", role="command", once=True),
    Verb("home", Nothing, m.Empty, "quick", role="command", once=True),
    Verb("acknowledge", Acknowledge, m.Said, "quick", role="command", once=True),
    Verb("drive", Drive, m.Said, "quick", role="command", once=True),
    Verb("drive_status", Nothing, m.DriveStatus, "quick", role="observe"),
    Verb("seal", Nothing, m.Seal, "quick", role="observe"),
    Verb("reveal", Nothing, m.Revealed, "quick", role="tune"),
    Verb("run_begin", RunBegin, m.RunBegun, "quick", role="tune", once=True),
    Verb("run_end", RunEnd, m.Applied, "sync", role="tune"),
    Verb("log", Log, tuple[m.Change, ...], "quick", role="observe"),
    # the target makes up to 2 GB of pages present
    Verb(
        "acquire_configure", AcquireConfigure, m.AcquireStatus, "quick", 30.0, role="tune",
        once=True,
    ),
    Verb("acquire_start", AcquireStart, m.Empty, "quick", role="tune", once=True),
    Verb("acquire_stop", Nothing, m.Empty, "quick", role="tune", once=True),
    Verb("acquire_status", Nothing, m.AcquireStatus, "quick", role="observe"),
    Verb("acquire_held", Nothing, m.Held, "quick", role="observe"),
    Verb("acquire_program", Nothing, m.Replaced, "quick", role="observe"),
    Verb("acquire_read", AcquireRead, m.Empty, "bulk", 60.0, role="observe"),
    Verb("table_begin", TableBegin, TableState, "bulk", role="tune", once=True),
    Verb("table_chunk", TableChunk, TableState, "bulk", 20.0, role="tune"),
    Verb("table_commit", TableCommit, m.Applied, "bulk", 20.0, role="tune", once=True),
    Verb("live_open", LiveOpen, m.LiveOpened, "quick", role="observe", once=True),
    Verb("live_close", LiveClose, m.Empty, "quick", role="observe", once=True),
)
VERBS: dict[str, Verb] = {row.name: row for row in _ROWS}

__all__ = ["ROLES", "VERBS", "Arguments", "Packed", "Verb"]
