"""What each reply holds. Field names and units are the contract; ``docs/protocol.md`` explains them.

Readers ignore fields they do not know, and fields may be added with defaults: neither raises the protocol version.
"""

from __future__ import annotations

from typing import Any

import msgspec

from zendsp_protocol.values import WireValue


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""


class Info(Message, frozen=True, kw_only=True):
    """Who a target is; does not change while it lives."""

    v: int
    name: str
    machine: str
    joints: int
    rate_hz: float
    clock: str
    pid: int
    hostname: str
    versions: dict[str, str]
    verbs: list[str]
    started: float = 0.0  # Unix s


class Diagnostic(Message, frozen=True, kw_only=True):
    """One message of the compiler."""

    severity: str
    file: str
    line: int
    column: int
    message: str


class CompileResult(Message, frozen=True, kw_only=True):
    """Outcome of ``compile``."""

    ok: bool
    key: str
    diagnostics: tuple[Diagnostic, ...] = ()
    seconds: float = 0.0
    cached: bool = False
    compiler: str = ""
    flags: tuple[str, ...] = ()


class VariableInfo(Message, frozen=True, kw_only=True):
    """One entry of the dictionary of the running code."""

    name: str
    type: str
    length: int = 1
    kind: str = "parameter"
    unit: str = ""
    minimum: float = float("-inf")
    maximum: float = float("inf")
    initial: WireValue = 0.0
    description: str = ""
    address: int = 0
    columns: int = 1  # of a table: values a row; length counts all values


class Timing(Message, frozen=True, kw_only=True):
    """Timing counted by the runtime; ns."""

    ticks: int = 0
    overruns: int = 0
    missed: int = 0
    exec_mean_ns: float = 0.0
    exec_max_ns: int = 0
    late_mean_ns: float = 0.0
    late_max_ns: int = 0
    exec_histogram: WireValue = 0
    late_histogram: WireValue = 0
    histogram_edges_ns: WireValue = 0


class Trip(Message, frozen=True, kw_only=True):
    """Why the drive tripped."""

    reason: str
    joint: int = 0
    tick: int = 0
    value: float = 0.0
    limit: float = 0.0
    text: str = ""


class Status(Message, frozen=True, kw_only=True):
    """The state of the target now."""

    state: str
    tick: int = 0
    t: float = 0.0
    rate_hz: float = 0.0
    clock: str = "real"
    scheduling: str = ""
    machine: str = ""
    joints: int = 0
    program: str = ""
    timing: Timing = Timing()
    drive: str = "off"
    trip: Trip | None = None
    crash: str = ""
    io: dict[str, WireValue] = {}
    homed: bool = True
    drive_mode: str = "off"
    hosts: tuple[str, ...] = ()  # filled in by the server: who is connected


class JointInfo(Message, frozen=True, kw_only=True):
    """One joint of the machine."""

    name: str
    unit: str = "rad"
    command: str = "torque"
    counts_per_unit: float = 1.0
    zero_counts: float = 0.0
    mv_per_torque: float = 0.0
    mv_per_speed: float = 0.0
    command_max: float = float("inf")
    position_min: float = float("-inf")
    position_max: float = float("inf")
    speed_max: float = float("inf")
    torque_max: float = float("inf")
    home: float = 0.0
    length: float = 0.0


class MachineInfo(Message, frozen=True, kw_only=True):
    """What the machine says of itself."""

    name: str
    text: str = ""
    simulated: bool = False
    joints: tuple[JointInfo, ...] = ()
    adc_names: tuple[str, ...] = ()
    adc_units: tuple[str, ...] = ()
    dins: int = 0
    douts: int = 0
    stop_input: int = -1
    needs_homing: bool = False


class Limits(Message, frozen=True, kw_only=True):
    """Checked every sample, below the user's code; one entry per joint."""

    position_min: tuple[float, ...]
    position_max: tuple[float, ...]
    speed_max: tuple[float, ...]
    torque_max: tuple[float, ...]
    command_max: tuple[float, ...]
    torque_clamp: bool = True


class Condition(Message, frozen=True, kw_only=True):
    """One thing that enabling the drives needs."""

    name: str
    met: bool
    advice: str = ""  # what to do where it is not met


class DriveStatus(Message, frozen=True, kw_only=True):
    """Where the drives are in the safe sequence."""

    state: str  # off | ready | homed | enabled | running | stopped | tripped
    mode: str = "off"  # what the drives are told: off | torque | velocity
    managed: bool = False  # the sequence cannot be left (--managed)
    explicit: bool = False  # the sequence is in use; else the drives go on at start and off at pause
    homed: bool = True
    commander: str = ""  # who has the exclusive right to command
    host_lost: str = "stop"  # what happens when the commander disappears: stop | hold | finish
    conditions: tuple[Condition, ...] = ()  # of enabling


class Said(Message, frozen=True, kw_only=True):
    """It was done; a sentence for people."""

    text: str = ""


class Change(Message, frozen=True, kw_only=True):
    """One line of the parameter log."""

    tick: int
    host_time: float
    name: str
    old: WireValue
    new: WireValue
    author: str


class Trigger(Message, frozen=True, kw_only=True):
    """When a recording starts."""

    source: str
    level: float
    edge: str = "rising"
    pre_s: float = 0.0


class AcquireStatus(Message, frozen=True, kw_only=True):
    """State of one acquisition stream."""

    state: str
    channels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    decimation: int = 1
    first: int = 0
    count: int = 0
    wanted: int = 0
    lost: int = 0
    start_tick: int = 0
    trigger_row: int = -1


class Reading(Message, frozen=True, kw_only=True):
    """Values of several variables, all from one sample."""

    tick: int
    values: dict[str, WireValue]


class Written(Message, frozen=True, kw_only=True):
    """A write was accepted; it takes effect at the start of a sample."""

    sequence: int


class Applied(Message, frozen=True, kw_only=True):
    """A write took effect at the start of sample ``tick``."""

    sequence: int
    tick: int


class Program(Message, frozen=True, kw_only=True):
    """The loaded program, as it was sent."""

    key: str = ""
    sources: dict[str, str] = {}
    flags: tuple[str, ...] = ()
    compiler: str = ""
    log_start: int = 0  # lines of the parameter log from before it was loaded


class LiveOpened(Message, frozen=True, kw_only=True):
    """A live stream: subscribe to ``key``."""

    stream: int
    key: str
    channels: tuple[str, ...]  # one per column
    units: tuple[str, ...]
    sample_time: float  # s between rows


class LiveHeader(Message, frozen=True, kw_only=True):
    """Attachment of each live message; its payload holds ``rows × columns`` float64, little endian, row by row."""

    v: int
    session: int  # changes whenever the stream is configured anew
    first: int  # index of the first row; a gap to the last message means rows that were skipped
    rows: int
    columns: tuple[str, ...]
    tick: int  # of the first row
    decimation: int
    lost: int  # rows overwritten before the server could send them, in all


class ChunkHeader(Message, frozen=True, kw_only=True):
    """Attachment of each reply of ``acquire_read``; the payload holds the rows, float64, little endian."""

    v: int
    first: int
    rows: int
    columns: int
    crc: int  # folded CRC-32 of the payload, see chunks.folded_crc


class Seal(Message, frozen=True, kw_only=True):
    """Commitment to what a simulated machine conceals, told before the diagnosis."""

    sha256: str  # of the record's UTF-8 bytes, hexadecimal


class Revealed(Message, frozen=True, kw_only=True):
    """What a simulated machine conceals, told after the diagnosis."""

    record: str  # JSON: machine, source, friction, nonce, effects [{effect, joint, parameters {name: {value, unit}}}]
    sha256: str
    tick: int  # at which it was told


class Empty(Message, frozen=True, kw_only=True):
    """Nothing but the fact that it was done."""


class ErrorBody(Message, frozen=True, kw_only=True):
    """Why a request was declined."""

    kind: str  # name of a class in zendsp_protocol.errors
    message: str
    details: dict[str, Any] = {}
