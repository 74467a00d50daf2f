"""What the monitor may ask of the real-time side: the interface between the network and the loop.

Answers are messages of the protocol, in which arrays are still NumPy arrays.
``zendsp_target.runtime.Runtime`` implements it with shared memory and a native runner process; the
Zenoh server calls it and knows neither. Calls return quickly, or their docstring says that they do
not, and are safe from any thread. Errors are those of ``zendsp_protocol.errors``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from zendsp_protocol.kept import About
from zendsp_protocol.messages import (
    AcquireStatus,
    Change,
    CompileResult,
    Held,
    Limits,
    MachineInfo,
    Status,
    Trigger,
    VariableInfo,
)
from zendsp_protocol.states import DriveMode, OverrunPolicy, TripReason
from zendsp_protocol.values import Value

PRESSED = "the STOP input of the machine is active: release the emergency stop, then try again"
RECORDER = 0  # the acquisition stream that `acquire_…` verbs speak of


@dataclass(frozen=True)
class AcquireConfig:
    """What the recorder records, how often, how long and from when on."""

    channels: tuple[str, ...]  # variable, array element "q[0]", or built-in signal
    decimation: int = 1
    seconds: float = 1.0  # per shot, or ring length
    trigger: Trigger | None = None
    continuous: bool = False


@dataclass(frozen=True)
class Blank:
    """An encoded reply in which only numbers change: where they stand, of eight bytes each, the
    most significant first.
    """

    data: bytes | bytearray
    count: int = -1  # where the tick or the sequence number of a reply goes
    values: tuple[int, ...] = ()  # where each value stands, a double


class RuntimeApi(Protocol):
    """A machine and the program that runs on it, as the network sees them."""

    # slow
    def compile(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> CompileResult: ...
    # slow: starts a new runner and runs UserInit; the state is then "loaded"
    def load(self, key: str) -> None: ...
    def start(self, ticks: int | None = None) -> None: ...  # pauses after so many samples
    def pause(self) -> None: ...
    # path of the file through which this user's programs stop it; "" where there is none
    def stop_page(self) -> str: ...
    # STOP: outputs safe at the next sample, latched until acknowledged
    def stop(self, author: str = "") -> None: ...
    # end a STOP or a trip, or only that of this number; nothing moves before the next start
    def acknowledge(self, trip: int | None = None) -> None: ...
    def unload(self) -> None: ...
    @property
    def unsafe(self) -> str: ...  # why the machine may still move without a program; else ""
    def status(self) -> Status: ...
    def variables(self) -> tuple[VariableInfo, ...]: ...
    # signals that exist without being declared: tick, t, exec_us, enc, aout, …
    def builtins(self) -> tuple[VariableInfo, ...]: ...
    def machine(self) -> MachineInfo: ...
    def limits(self) -> Limits: ...
    # changes: fields of Limits; returns the sequence number of the update
    def set_limits(self, author: str, **changes: Any) -> int: ...
    def set_drive(self, mode: DriveMode) -> None: ...
    def home(self) -> None: ...  # starts the homing; status().homed when done
    def set_ramp(self, seconds: float) -> None: ...  # soft start and soft stop
    # policy "trip": after `limit` late samples in a row
    def set_overrun(self, policy: OverrunPolicy, limit: int = 10) -> None: ...
    def set_inputs(self, bits: int) -> None: ...  # digital inputs of a simulated machine
    # as stop, with the reason "stop" or "host lost"
    def trip(self, reason: TripReason) -> None: ...
    # cancels the updates of these authors that wait for a later sample
    def cancel(self, whose: Callable[[str], bool]) -> None: ...
    # whether the loop shall stop the machine if the monitor hangs and cannot see a lost host
    def attend(self, attended: bool) -> None: ...
    # the sample's tick, and values that are all from that sample
    def read(self, names: Sequence[str]) -> tuple[int, dict[str, Value]]: ...
    # why the program no longer runs: crashed, tripped, stopped; "" where it does
    def ended(self) -> str: ...
    # raises what write would raise, without writing
    def check(self, values: Mapping[str, Value], at_tick: int | None = None) -> None: ...
    # returns the sequence number; `fade`: samples over which numbers reach their new values
    def write(
        self, values: Mapping[str, Value], author: str, at_tick: int | None = None, fade: int = 0
    ) -> int: ...

    # The next two return None where a request cannot be prepared. The function that they return
    # gives 0, without having done anything, where a request has to be decoded after all.
    def repeat_read(self, names: Sequence[str], reply: Blank) -> Callable[[], int] | None: ...
    # the function takes a request as long as the given one; the sequence number is in the reply
    def repeat_write(
        self, names: Sequence[str], author: str, request: Blank, reply: Blank
    ) -> Callable[[bytes], int] | None: ...
    # the sample at which the update took effect; NotYet after the timeout
    def wait_applied(self, sequence: int, timeout: float) -> int: ...
    # lines from number `since` on; a table is told by its number of rows
    def log(self, since: int = 0) -> tuple[Change, ...]: ...
    # stream 0: recorder; 1…7: live
    def acquire_configure(self, stream: int, config: AcquireConfig) -> AcquireStatus: ...
    def acquire_start(self, stream: int, force: bool = False) -> None: ...
    # lets the recorder's rows be salvaged if this process is killed
    def acquire_keep(self, about: About) -> None: ...
    def acquire_stop(self, stream: int) -> None: ...
    def acquire_status(self, stream: int) -> AcquireStatus: ...
    # where the stream's rows are, for a reader of the same user
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
    def reveal(self) -> str: ...  # the sealed record, JSON; for after the diagnosis
    def close(self) -> None: ...
