"""What the monitor may ask of the real-time side: the seam between the network and the loop.

``zendsp_target.runtime.Runtime`` implements it on shared memory and a native runner process; the
Zenoh server calls it and knows nothing of either. Every call is quick (the slow ones say so) and
safe from any thread. Errors are those of ``zendsp_protocol.errors``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from zendsp_protocol.kept import About
from zendsp_protocol.messages import Held
from zendsp_protocol.states import DriveState, ProgramState, RecorderState

RECORDER = 0  # the acquisition stream that `acquire_…` verbs speak of
Value = bool | int | float | npt.NDArray[Any]


@dataclass(frozen=True)
class Diagnostic:
    """One message of the compiler, in the user's own file."""

    severity: str  # "error" | "warning" | "note"
    file: str
    line: int  # 1-based; 0 where the compiler gives none
    column: int
    message: str


@dataclass(frozen=True)
class CompileResult:
    ok: bool
    key: str  # content hash: source + header + flags + compiler; names the cached program
    diagnostics: tuple[Diagnostic, ...]
    seconds: float
    cached: bool
    compiler: str  # path and version line
    flags: tuple[str, ...]


@dataclass(frozen=True)
class VariableInfo:
    """One entry of the dictionary that the running code declares."""

    name: str
    type: str  # "double" | "float" | "int32" | "bool"
    length: int  # 1 = scalar, else array elements
    # "parameter" (host may write) | "signal" (read only) | "table" (large array, two banks)
    kind: str
    unit: str
    minimum: float  # -inf where none
    maximum: float  # +inf where none
    initial: Value
    description: str
    address: int  # offset within the program's image, bytes
    columns: int = 1  # of a table: values a row; `length` counts all values, rows × columns


@dataclass(frozen=True)
class JointInfo:
    """One joint of the machine."""

    name: str
    unit: str  # "rad" | "m"
    command: str  # what the analog output means in torque mode: "torque" | "force" | "voltage"
    counts_per_unit: float  # encoder counts per rad (m)
    zero_counts: float  # encoder reading at position zero
    mv_per_torque: float  # mV per N m (N); 0 where the command is a voltage
    mv_per_speed: float  # mV per rad/s (m/s), velocity mode
    command_max: float  # mV
    position_min: float
    position_max: float
    speed_max: float
    torque_max: float
    home: float  # position where homing ends
    length: float  # link length, m; 0 where it has no meaning


@dataclass(frozen=True)
class MachineInfo:
    """What the machine says of itself."""

    name: str
    text: str
    simulated: bool
    joints: tuple[JointInfo, ...]
    adc_names: tuple[str, ...]
    adc_units: tuple[str, ...]
    dins: int
    douts: int
    stop_input: int  # digital input that stops, -1: none
    needs_homing: bool


@dataclass(frozen=True)
class Limits:
    """Checked every sample, below the user's code. One entry per joint."""

    position_min: tuple[float, ...]
    position_max: tuple[float, ...]
    speed_max: tuple[float, ...]
    torque_max: tuple[float, ...]
    command_max: tuple[float, ...]  # mV
    torque_clamp: bool  # True: clamp a command at its limit; False: trip


@dataclass(frozen=True)
class Timing:
    """Counted by the runtime in constant time per sample; all times in ns."""

    ticks: int
    overruns: int
    missed: int
    exec_mean_ns: float
    exec_max_ns: int
    late_mean_ns: float
    late_max_ns: int
    exec_histogram: npt.NDArray[np.int64]  # counts per bin
    late_histogram: npt.NDArray[np.int64]
    histogram_edges_ns: npt.NDArray[np.float64]  # logarithmic, len = bins + 1


@dataclass(frozen=True)
class Trip:
    # "torque" | "speed" | "position" | "overrun" | "nan" | "stop" | "code" | "host lost" …
    reason: str
    joint: int  # 1-based; 0 where none
    tick: int
    value: float
    limit: float
    text: str


@dataclass(frozen=True)
class Status:
    state: ProgramState
    tick: int
    t: float  # s since start
    rate_hz: float
    clock: str  # "real" | "fast"
    scheduling: str  # a sentence: what was granted and what was refused
    machine: str
    joints: int
    program: str  # key of the loaded program, "" if none
    timing: Timing
    drive: DriveState
    trip: Trip | None
    crash: str  # "" or a sentence: signal, last sample
    # enc, aout, adc, din, dout
    io: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    homed: bool = True
    drive_mode: str = "off"  # what the drives are told: "off" | "torque" | "velocity"


@dataclass(frozen=True)
class Trigger:
    source: str  # variable or element
    level: float
    edge: str  # "rising" | "falling" | "both"
    pre_s: float = 0.0


@dataclass(frozen=True)
class AcquireConfig:
    channels: tuple[str, ...]  # variable, array element "q[0]", or built-in signal
    decimation: int = 1
    seconds: float = 1.0  # per shot, or ring length
    trigger: Trigger | None = None
    continuous: bool = False


@dataclass(frozen=True)
class AcquireStatus:
    state: RecorderState
    channels: tuple[str, ...]
    units: tuple[str, ...]
    decimation: int
    first: int  # index of the oldest row still held
    count: int  # rows written so far (monotonic)
    wanted: int  # rows of a single shot, 0 when continuous
    lost: int  # rows overwritten before they were read, or never stored
    start_tick: int  # tick of row 0
    trigger_row: int  # row at which the trigger fired, -1 where none


@dataclass(frozen=True)
class Change:
    """One line of the parameter log."""

    tick: int
    host_time: float  # Unix s
    name: str
    old: Value
    new: Value
    author: str


@dataclass(frozen=True)
class Blank:
    """A reply in which only numbers are missing, of eight bytes each, the most significant first.
    """

    data: bytearray
    count: int  # where the tick or the sequence number goes
    values: tuple[int, ...] = ()  # where each value goes, a double


class RuntimeApi(Protocol):
    """See the module docstring."""

    # slow
    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult: ...
    # slow: starts a fresh runner, runs UserInit, state "loaded"
    def load(self, key: str) -> None: ...
    def start(self, ticks: int | None = None) -> None: ...  # ticks: run so many samples, then pause
    def pause(self) -> None: ...
    # path of the file by which this user's own programs stop it; "" where there is none
    def stop_page(self) -> str: ...
    def stop(self) -> None: ...  # STOP: outputs safe at the next sample, latched until acknowledged
    def acknowledge(self) -> None: ...  # end a STOP or a trip; nothing moves before the next start
    def unload(self) -> None: ...
    def status(self) -> Status: ...
    def variables(self) -> tuple[VariableInfo, ...]: ...
    # signals that exist undeclared: tick, t, exec_us, enc, aout, …
    def builtins(self) -> tuple[VariableInfo, ...]: ...
    def machine(self) -> MachineInfo: ...
    def limits(self) -> Limits: ...
    # fields of Limits; -> sequence, as of write
    def set_limits(self, author: str, **changes: Any) -> int: ...
    # "off" | "torque" | "velocity" | "auto" (on at start, off at pause)
    def set_drive(self, mode: str) -> None: ...
    def home(self) -> None: ...  # starts the machine's homing; status().homed tells
    def set_ramp(self, seconds: float) -> None: ...  # soft start and soft stop
    # "count" | "skip" | "trip" after `limit` in a row
    def set_overrun(self, policy: str, limit: int = 10) -> None: ...
    def set_inputs(self, bits: int) -> None: ...  # digital inputs of a simulated machine
    # stop with a reason of the monitor's: "stop" | "host lost"
    def trip(self, reason: str) -> None: ...
    # all from one sample; its tick
    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]: ...
    # why the program no longer runs: crashed, tripped, stopped; "" where it does
    def ended(self) -> str: ...
    # raises what write would; nothing is written
    def check(self, values: Mapping[str, Value]) -> None: ...
    # -> sequence
    def write(
        self, values: Mapping[str, Value], author: str, at_tick: int | None = None
    ) -> int: ...

    # Of the next two, None: there is no shorter way; what they return gives 0, and nothing has
    # happened, where the whole way has to be gone. takes the least tick
    def repeat_read(self, names: Sequence[str], reply: Blank) -> Callable[[int], int] | None: ...
    # takes a request, in which the value stands from byte `value_at` on, as in a reply
    def repeat_write(
        self, name: str, author: str, value_at: int, reply: Blank
    ) -> Callable[[bytes], int] | None: ...
    # its tick; NotYet: not within the timeout
    def wait_applied(self, sequence: int, timeout: float) -> int: ...
    # lines from number `since` on; tables by their rows
    def log(self, since: int = 0) -> tuple[Change, ...]: ...
    # stream 0: recorder; 1…7: live
    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus: ...
    def acquire_start(self, stream: int, force: bool = False) -> None: ...
    # the recorder's rows can be salvaged when this process is killed
    def acquire_keep(self, about: About) -> None: ...
    def acquire_stop(self, stream: int) -> None: ...
    def acquire_status(self, stream: int) -> AcquireStatus: ...
    # where its rows stand, for a reader of the same user
    def acquire_held(self, stream: int) -> Held: ...
    # (rows, channels), in the memory of `into` where given; their bytes are folded into `fold`
    def acquire_read(
        self,
        stream: int,
        first: int,
        count: int,
        into: npt.NDArray[np.float64] | None = None,
        fold: bytearray | None = None,
    ) -> npt.NDArray[np.float64]: ...

    def seal(self) -> str: ...  # SHA-256 of what the machine conceals
    def reveal(self) -> str: ...  # the sealed record, JSON: asked for after the fact
    def close(self) -> None: ...
