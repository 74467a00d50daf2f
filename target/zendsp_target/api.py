"""What the monitor may ask of the real-time side: the seam between the network and the loop.

``zendsp_target.runtime.Runtime`` implements it on shared memory and a native runner process; the Zenoh server calls it and
knows nothing of either. Every call is quick (the slow ones say so) and safe from any thread. Errors are those of
``zendsp_protocol.errors``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

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
    kind: str  # "parameter" (host may write) | "signal" (read only) | "table" (large array, two banks)
    unit: str
    minimum: float  # -inf where none
    maximum: float  # +inf where none
    initial: Value
    description: str
    address: int  # offset within the program's image, bytes


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
    reason: str  # "torque" | "speed" | "position" | "overrun" | "nan" | "stop" | "code" | "host lost" …
    joint: int  # 1-based; 0 where none
    tick: int
    value: float
    limit: float
    text: str


@dataclass(frozen=True)
class Status:
    state: str  # "empty" | "loaded" | "running" | "paused" | "stopped" | "crashed"
    tick: int
    t: float  # s since start
    rate_hz: float
    clock: str  # "real" | "fast"
    scheduling: str  # a sentence: what was granted and what was refused
    machine: str
    joints: int
    program: str  # key of the loaded program, "" if none
    timing: Timing
    drive: str  # "off" | "ready" | "homed" | "enabled" | "running" | "stopped" | "tripped"
    trip: Trip | None
    crash: str  # "" or a sentence: signal, last sample
    io: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)  # enc, aout, adc, din, dout


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
    state: str  # "idle" | "armed" | "running" | "done"
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


class RuntimeApi(Protocol):
    """See the module docstring."""

    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult: ...  # slow
    def load(self, key: str) -> None: ...  # slow: starts a fresh runner, runs UserInit, state "loaded"
    def start(self, ticks: int | None = None) -> None: ...  # ticks: run so many samples, then pause
    def pause(self) -> None: ...
    def stop(self) -> None: ...  # STOP: outputs safe at the next sample, latched until acknowledged
    def unload(self) -> None: ...
    def status(self) -> Status: ...
    def variables(self) -> tuple[VariableInfo, ...]: ...
    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]: ...  # all from one sample; its tick
    def write(self, values: Mapping[str, Value], author: str, at_tick: int | None = None) -> int: ...  # -> sequence
    def wait_applied(self, sequence: int, timeout: float) -> int: ...  # -> tick at which it took effect
    def log(self, since: int = 0) -> tuple[Change, ...]: ...
    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus: ...  # stream 0: recorder; 1…7: live
    def acquire_start(self, stream: int, force: bool = False) -> None: ...
    def acquire_stop(self, stream: int) -> None: ...
    def acquire_status(self, stream: int) -> AcquireStatus: ...
    def acquire_read(self, stream: int, first: int, count: int) -> npt.NDArray[np.float64]: ...  # (rows, channels)
    def close(self) -> None: ...
