"""What each reply holds. Field names and units are the contract; ``docs/protocol.md`` explains
them.

Readers ignore fields they do not know, and fields may be added with defaults: neither raises the
protocol version.
"""

from __future__ import annotations

from typing import Any

import msgspec

from zendsp_protocol.states import (
    Clock,
    DriveMode,
    DriveState,
    HostLost,
    ProgramState,
    RecorderState,
    Severity,
    TripReason,
    VariableKind,
)
from zendsp_protocol.texts import counted, placed
from zendsp_protocol.values import WireValue
from zendsp_protocol.views import html_table


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""


class Info(Message, frozen=True, kw_only=True):
    """Who a target is; does not change while it lives."""

    v: int  # protocol version
    name: str  # of the target
    machine: str  # what it drives
    joints: int  # 0 before the first program is loaded
    rate_hz: float  # samples a second
    clock: Clock  # real or fast
    pid: int  # process of the monitor
    hostname: str  # machine on which it runs
    versions: dict[str, str]  # of zendsp, Python, the kernel and the libraries
    verbs: list[str]  # that this target answers
    started: float = 0.0  # Unix s
    instance: str = ""  # of this run of the target, hexadecimal: another after each start

    def __repr__(self) -> str:
        return (
            f"<Info {self.name}: {self.machine}, {self.rate_hz:g} Hz, {self.clock} clock, process"
            f" {self.pid} on {self.hostname}, zendsp {self.versions.get('zendsp', '?')}>"
        )


class Diagnostic(Message, frozen=True):
    """One message of the compiler."""

    severity: Severity  # error, warning or note
    file: str  # as the host named it
    line: int  # from 1; 0 where the compiler gives none
    column: int  # from 1; 0 where there is none, as of the linker
    message: str  # the compiler's own words

    def __str__(self) -> str:
        words = f"{self.severity}: {self.message}"
        return placed(self.file, self.line, self.column, words) if self.line else words


class CompileResult(Message, frozen=True):
    """Outcome of ``compile``."""

    ok: bool  # whether there is a program to load
    key: str  # content hash of source, header, flags and compiler; for load
    diagnostics: tuple[Diagnostic, ...] = ()  # in the user's own files
    seconds: float = 0.0  # s, spent
    cached: bool = False  # whether it was compiled before
    compiler: str = ""  # path and version
    flags: tuple[str, ...] = ()  # all that were used

    def __repr__(self) -> str:
        cached = " (from the cache)" if self.cached else ""
        parts = [f"ok in {self.seconds:.2g} s{cached}" if self.ok else "not compiled"]
        parts += map(str, self.diagnostics)
        return f"<CompileResult {'; '.join(parts)}>"


class VariableInfo(Message, frozen=True):
    """One entry of the dictionary of the running code."""

    name: str  # as in the C code
    type: str  # double, float, int32 or bool
    length: int = 1  # elements; 1 for a scalar
    # parameter (may be written), signal (read only), table (large) or builtin
    kind: VariableKind = VariableKind.PARAMETER
    unit: str = ""  # as declared
    minimum: float = float("-inf")  # -inf where there is none
    maximum: float = float("inf")  # inf where there is none
    # value after UserInit; a table of one value throughout is sent as that value
    initial: WireValue = 0.0
    description: str = ""  # as declared
    address: int = 0  # bytes within the program's image
    columns: int = 1  # of a table or matrix: values a row; length counts all values


class Timing(Message, frozen=True):
    """Timing counted by the runtime; ns."""

    ticks: int = 0  # samples counted
    overruns: int = 0  # samples that took longer than the period
    missed: int = 0  # samples that were skipped
    exec_mean_ns: float = 0.0  # ns, time in the ISR
    exec_max_ns: int = 0  # ns
    late_mean_ns: float = 0.0  # ns, start of the ISR after its deadline
    late_max_ns: int = 0  # ns
    exec_histogram: WireValue = 0  # counts per bin
    late_histogram: WireValue = 0  # counts per bin
    histogram_edges_ns: WireValue = 0  # ns, one more than there are bins

    def __repr__(self) -> str:
        def spent(mean: float, most: float) -> str:
            return f"{mean / 1e3:.1f} (at most {most / 1e3:.1f}) us"

        return (
            f"<Timing {self.ticks} samples, {self.overruns} overruns, {self.missed} missed;"
            f" execution {spent(self.exec_mean_ns, self.exec_max_ns)},"
            f" late {spent(self.late_mean_ns, self.late_max_ns)}>"
        )


class Trip(Message, frozen=True):
    """Why the drive tripped."""

    # stop, stop input, host lost, torque, speed, position, command, nan, overrun, sensor, homing
    # or stall
    reason: TripReason
    joint: int = 0  # from 1; 0 where none
    tick: int = 0  # sample at which it happened
    value: float = 0.0  # that broke the limit
    limit: float = 0.0  # that was broken, same unit
    text: str = ""  # a sentence for people
    cause: str = ""  # its first words: what broke which limit
    number: int = 0  # of trips, and STOPs beside them, of this target; moves on with a STOP


class Status(Message, frozen=True):
    """The state of the target now."""

    state: ProgramState  # empty, loaded, running, paused, stopped or crashed
    tick: int = 0  # samples since the program was loaded
    t: float = 0.0  # s since the program was loaded
    rate_hz: float = 0.0  # samples a second
    clock: Clock = Clock.REAL  # real or fast
    scheduling: str = ""  # a sentence: what the kernel granted and refused
    machine: str = ""  # name
    joints: int = 0  # number
    program: str = ""  # key of the loaded program
    timing: Timing = Timing()  # see Timing
    drive: DriveState = DriveState.OFF  # off, ready, homed, enabled, running, stopped or tripped
    trip: Trip | None = None  # latched until acknowledged
    crash: str = ""  # empty, or how the runner died and at which sample
    io: dict[str, WireValue] = {}  # enc, aout, adc, din, dout; fault of hardware at rest
    homed: bool = True  # whether positions mean anything
    drive_mode: DriveMode = DriveMode.OFF  # what the drives are told: off, torque or velocity
    hosts: tuple[str, ...] = ()  # filled in by the server: who is connected
    unsafe: str = ""  # why the machine may still move where no program runs; empty: it is safe
    own: tuple[str, ...] = ()  # parameters that the program itself sets, a sentence each
    pressed: bool = False  # the machine's STOP input is active
    homings: int = 0  # that came to their end since the program was loaded
    homing: bool = False  # the machine's homing moves it now, not the program

    @property
    def doing(self) -> str:
        """The state in a word, *homing* where the machine's own routine moves it."""
        return "homing" if self.homing else self.state

    def __repr__(self) -> str:
        trip = (self.trip.text or self.trip.reason) if self.trip else ""
        trouble = self.crash or self.unsafe or trip
        return (
            f"<Status {self.machine}: {self.doing}, drives {self.drive}, {self.t:.3f} s at"
            f" {self.rate_hz:g} Hz{f', {trouble}' if trouble else ''}>"
        )

    def _repr_html_(self) -> str:
        t = self.timing
        when = f"sample {self.tick} ({self.t:.3f} s at {self.rate_hz:g} Hz)"
        joints = f"{counted(self.joints, 'joint')}, " if self.joints else ""  # told by the program
        rows = [
            ("machine", f"{self.machine}, {joints}{self.clock} clock"),
            ("program", f"{self.doing}, {when}"),
            ("drives", f"{self.drive}, {self.drive_mode}"),
            ("time in ISR", f"{t.exec_mean_ns / 1e3:.1f} µs, at most {t.exec_max_ns / 1e3:.1f}"),
            ("begins late by", f"{t.late_mean_ns / 1e3:.1f} µs, at most {t.late_max_ns / 1e3:.1f}"),
            ("overruns, missed", f"{t.overruns}, {t.missed}"),
            ("hosts", ", ".join(self.hosts) or "none"),
        ]
        if self.trip is not None:
            rows.append(("trip", self.trip.text or self.trip.reason))
        if self.crash:
            rows.append(("crash", self.crash))
        elif self.unsafe:
            rows.append(("machine", self.unsafe))
        return html_table(("", ""), rows)


class JointInfo(Message, frozen=True):
    """One joint of the machine."""

    name: str  # of the joint
    unit: str = "rad"  # rad or m
    command: str = "torque"  # what the analog output means: torque, force or voltage
    counts_per_unit: float = 1.0  # encoder counts per rad or m
    zero_counts: float = 0.0  # encoder reading at position zero
    mv_per_torque: float = 0.0  # mV per N m or N; 0 where the command is a voltage
    mv_per_speed: float = 0.0  # mV per rad/s or m/s, in velocity mode
    command_max: float = float("inf")  # mV
    position_min: float = float("-inf")  # rad or m
    position_max: float = float("inf")  # rad or m
    speed_max: float = float("inf")  # rad/s or m/s
    torque_max: float = float("inf")  # N m or N
    home: float = 0.0  # rad or m, where homing ends
    length: float = 0.0  # m, of the link; 0 where it means nothing


class MachineInfo(Message, frozen=True):
    """What the machine says of itself."""

    name: str  # of the machine
    text: str = ""  # what it is
    simulated: bool = False  # whether it is a simulation
    joints: tuple[JointInfo, ...] = ()  # see JointInfo
    adc_names: tuple[str, ...] = ()  # of the analog inputs
    adc_units: tuple[str, ...] = ()  # of the analog inputs
    dins: int = 0  # digital inputs
    douts: int = 0  # digital outputs
    stop_input: int = -1  # digital input that stops; -1 where none
    needs_homing: bool = False  # before it may be enabled
    model: str = ""  # path, on the target, of the MuJoCo model that is simulated; empty: none
    options: tuple[str, ...] = ()  # that the model was started with, KEY=VALUE each

    def __repr__(self) -> str:
        joints = ", ".join(
            f"{j.name} [{j.unit}] {j.position_min:g} … {j.position_max:g}" for j in self.joints
        )
        simulated = ", simulated" if self.simulated else ""
        return f"<MachineInfo {self.name}{simulated}: {joints or 'no joints yet'}>"


class Limits(Message, frozen=True):
    """Checked every sample, below the user's code; one entry per joint."""

    position_min: tuple[float, ...]  # rad or m
    position_max: tuple[float, ...]  # rad or m
    speed_max: tuple[float, ...]  # rad/s or m/s
    torque_max: tuple[float, ...]  # N m or N
    command_max: tuple[float, ...]  # mV
    torque_clamp: bool = True  # true: clamp a command at its limit; false: trip


class Condition(Message, frozen=True, kw_only=True):
    """One thing that enabling the drives needs."""

    name: str  # of the condition
    met: bool  # now
    advice: str = ""  # what to do where it is not met


class DriveStatus(Message, frozen=True, kw_only=True):
    """Where the drives are in the safe sequence."""

    state: DriveState  # off, ready, homed, enabled, running, stopped or tripped
    mode: str = "off"  # what the drives are told: off, torque or velocity
    managed: bool = False  # the sequence cannot be left (--managed)
    # the sequence is in use; else the drives go on at start and off at pause
    explicit: bool = False
    homed: bool = True  # whether positions mean anything
    commander: str = ""  # who has the exclusive right to command
    moved_by: str = ""  # whose run, or attended start, moves the machine now
    host_lost: HostLost = HostLost.STOP  # when the commander disappears: stop, hold or finish
    conditions: tuple[Condition, ...] = ()  # of enabling

    def __repr__(self) -> str:
        how = "explicit" if self.explicit else "automatic: on at start, off at pause"
        unmet = ", ".join(c.name for c in self.conditions if not c.met) or "none"
        return (
            f"<DriveStatus {self.state}, {self.mode}, {how}; commands:"
            f" {self.commander or 'nobody'}; conditions not met: {unmet}>"
        )


class RunBegun(Message, frozen=True, kw_only=True):
    """A run began: what it sets is put back when it ends, or when its host is lost."""

    run: int  # number, for run_end
    names: tuple[str, ...]  # that are put back
    follows: bool = True  # the program follows its table


class Said(Message, frozen=True, kw_only=True):
    """It was done; a sentence for people."""

    text: str = ""  # what was done


class Change(Message, frozen=True):
    """One line of the parameter log."""

    tick: int  # sample at which it took effect
    host_time: float  # Unix s, by the target's clock
    name: str  # of the parameter
    old: WireValue  # value before
    new: WireValue  # value after
    author: str  # who asked
    fade: int = 0  # samples over which it came; `tick` is then that of its end


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
    begun: int = 0  # how often it was configured or started: with another number, other rows
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


class Reading(Message, frozen=True, kw_only=True):
    """Values of several variables, all from one sample."""

    tick: int  # the sample
    values: dict[str, WireValue]  # by name
    # why the program no longer runs (crash, trip, STOP): the values are those of its last sample
    ended: str = ""


class Written(Message, frozen=True, kw_only=True):
    """A write was accepted; it takes effect at the start of a sample."""

    sequence: int  # for wait_applied


class Applied(Message, frozen=True, kw_only=True):
    """A write took effect at the start of sample ``tick``."""

    sequence: int  # of the update
    tick: int  # sample at whose start it took effect


class Program(Message, frozen=True, kw_only=True):
    """The loaded program, as it was sent."""

    key: str = ""  # of the loaded program
    sources: dict[str, str] = {}  # file name to text, as they were sent
    flags: tuple[str, ...] = ()  # for the compiler
    compiler: str = ""  # path and version
    log_start: int = 0  # lines of the parameter log from before it was loaded

    def __repr__(self) -> str:
        files = (f"{name} ({text.count(chr(10))} lines)" for name, text in self.sources.items())
        return f"<Program {', '.join(files) or 'none'}; {self.compiler or 'no compiler known'}>"


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


class Seal(Message, frozen=True, kw_only=True):
    """Commitment to what a simulated machine conceals, told before the diagnosis."""

    sha256: str  # of the record's UTF-8 bytes, hexadecimal


class Revealed(Message, frozen=True, kw_only=True):
    """What a simulated machine conceals, told after the diagnosis."""

    # JSON: machine, source, friction, nonce, effects [{effect, joint, parameters {name: {value,
    # unit}}}]
    record: str
    sha256: str  # of its UTF-8 bytes, as in Seal
    tick: int  # at which it was told


class Empty(Message, frozen=True, kw_only=True):
    """Nothing but the fact that it was done."""


class ErrorBody(Message, frozen=True, kw_only=True):
    """Why a request was declined."""

    kind: str  # name of a class in zendsp_protocol.errors
    message: str  # what, the value, the limit, what to do next
    details: dict[str, Any] = {}  # more, for programs
