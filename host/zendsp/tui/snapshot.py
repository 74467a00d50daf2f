"""The state of the target at one moment, for the screens: made by the session's thread, and
immutable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from zendsp.link.outside import Outside
from zendsp_protocol.messages import Limits, MachineInfo
from zendsp_protocol.states import DriveState, ProgramState, TripReason, VariableKind
from zendsp_protocol.values import Value


class LinkState(StrEnum):
    """State of the terminal's link to a target."""

    NONE = "none"  # no target was chosen
    STARTING = "starting"
    CONNECTING = "connecting"
    UP = "up"
    LOST = "lost"  # and looked for again
    ENDED = "ended"  # by the target itself


@dataclass(frozen=True)
class Variable:
    """One row of the table of variables."""

    name: str
    type: str
    length: int
    kind: VariableKind  # parameter, signal or table
    unit: str
    minimum: float
    maximum: float
    initial: Value
    description: str
    columns: int = 1  # of a table: values a row

    @property
    def writable(self) -> bool:
        """Whether a host may write it."""
        return self.kind != VariableKind.SIGNAL


@dataclass(frozen=True)
class Event:
    """One line of the event log."""

    host_time: float  # Unix s
    level: str  # "info" | "good" | "warning" | "error"
    text: str


@dataclass(frozen=True)
class TripView:
    """Why the drives are in the safe state."""

    reason: TripReason
    tick: int
    text: str
    number: int = 0  # 0: told by a target that counts none
    cause: str = ""  # the first words of the text: what broke which limit


@dataclass(frozen=True)
class Snapshot:
    """Everything that a screen shows apart from curves."""

    link: LinkState = LinkState.NONE
    target: str = ""
    complaint: str = ""  # why it is not connected yet
    gone: bool = False  # of a link that is lost: the process of the target has ended
    safe: bool | None = None  # its machine, as it said at its end; None: it said nothing
    here: tuple[str, ...] | None = None  # targets that answer while none is connected, once known
    machine: str = ""
    joints: int = 0
    # what the machine says of itself and the limits in force, once a program is loaded
    described: MachineInfo | None = None
    limits: Limits | None = None
    state: ProgramState | Literal[""] = ""  # "" until the target has told it
    drive: DriveState | Literal[""] = ""
    homing: bool = False  # the machine's own routine moves it
    # the safe sequence is in use; else drives go on at start and off at pause
    explicit: bool = False
    program: str = ""
    clock: str = ""
    tick: int = 0
    t: float = 0.0
    rate_hz: float = 0.0
    exec_mean_ns: float = 0.0
    exec_max_ns: float = 0.0
    late_max_ns: float = 0.0
    overruns: int = 0
    missed: int = 0
    lost: int = 0
    latency_s: float = float("nan")
    asked: float = float("nan")  # when the target was asked, by the monotonic clock
    commander: str = ""  # who holds the right to command, "" if nobody
    moved_by: str = ""  # whose run moves the machine, "you" of this terminal
    mine: bool = False  # it is held here
    recording: bool = False
    host_lost: str = ""
    trip: TripView | None = None
    crash: str = ""
    unsafe: str = ""  # why the machine may still move where no program runs
    own: tuple[str, ...] = ()  # parameters that the program itself sets, a sentence each
    scheduling: str = ""
    io: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)
    # of each joint by its encoder, rad or m; also while no program computes anything; none of a
    # machine that is not homed
    position: tuple[float, ...] = ()
    outside: tuple[Outside, ...] = ()  # the joints outside their position limits
    conditions: tuple[tuple[str, bool, str], ...] = ()  # of enabling: name, met, what to do
    # until the program runs: actions by name, or sentences (zendsp.link.way_back)
    steps: tuple[str, ...] = ()
    variables: tuple[Variable, ...] = ()
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """The longest execution time as a fraction of the period."""
        return self.exec_max_ns * 1e-9 * self.rate_hz

    @property
    def enabled(self) -> bool:
        """Whether the drives act on what a program commands."""
        return self.drive in (DriveState.ENABLED, DriveState.RUNNING)

    @property
    def period_s(self) -> float:
        """Sample time, s."""
        return 1.0 / self.rate_hz if self.rate_hz else 0.001

    def news(self, before: Snapshot) -> bool:
        """Whether this snapshot differs from another in more than numbers that change all the time.
        """
        return replace(self, **NUMBERS) != replace(before, **NUMBERS)


NUMBERS: dict[str, Any] = {
    "tick": 0,
    "t": 0.0,
    "exec_mean_ns": 0.0,
    "exec_max_ns": 0.0,
    "late_max_ns": 0.0,
    "latency_s": 0.0,
    "asked": 0.0,
    "io": {},
    "position": (),
    "values": {},
}
