"""What the terminal needs of a target; ``link_port`` implements it with a
:class:`zendsp.link.Target`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from zendsp.link import Rehearsal
from zendsp.link.put_back import Before
from zendsp.recording import Recording
from zendsp.tui.snapshot import Snapshot
from zendsp_protocol.messages import Diagnostic, Program
from zendsp_protocol.states import DriveAction
from zendsp_protocol.values import Assignable

if TYPE_CHECKING:  # the experiments are loaded when one is asked for
    from zendsp.experiment import FrequencyResponse, Sweep

Quantity = Literal["position", "torque"]
Tell = Callable[[float], None]  # what is told of the share that is done; may raise, to end it
Sink = Callable[[npt.NDArray[np.int64], npt.NDArray[np.float64], float], None]


@dataclass(frozen=True)
class Build:
    """The result of building a source."""

    ok: bool
    seconds: float
    cached: bool
    remarks: tuple[Diagnostic, ...]


@dataclass(frozen=True)
class Shot:
    """What to acquire."""

    channels: tuple[str, ...]
    seconds: float
    decimation: int = 1
    trigger: str = ""  # source, "" to start now
    level: float = 0.0
    edge: str = "rising"
    pre_s: float = 0.0


@dataclass(frozen=True)
class Swing:
    """The arguments of `zendsp.frequency_response` that a form asks for."""

    joint: int = 1
    quantity: Quantity = "position"
    amplitude: float | None = None
    f_min: float = 0.5
    f_max: float = 30.0
    lines: int = 30
    periods: int = 6
    input: str = ""
    output: str = ""


@dataclass(frozen=True)
class Tries:
    """The arguments of `zendsp.sweep` that a form asks for; names with blanks between them."""

    words: str = ""  # as `zendsp.experiment.sweep.tried_of` reads them
    channels: str = ""
    measures: str = "rms max"
    seconds: float = 2.0
    settle: float = 0.5
    together: bool = False


class Port(Protocol):
    """A target as the terminal uses it. Every call may raise ``ZendspError``; ``LinkError`` means
    that the target cannot be reached.
    """

    here: bool  # the target was started by this terminal, and ends with it

    @property
    def over(self) -> bool: ...  # the target's process has ended
    def farewell(self) -> bool | None: ...  # whether its machine is safe, as it said at its end

    def snapshot(self) -> Snapshot: ...
    def live(self, names: Sequence[str], sink: Sink) -> Callable[[], None]: ...
    def stop(self) -> str: ...  # how it ended; NotStopped where nothing says that it did
    def start(self, ticks: int | None = None) -> None: ...
    def pause(self) -> None: ...
    def program(self) -> Program: ...  # what is loaded, with its sources
    def build(self, sources: Mapping[str, str], flags: Sequence[str] = ()) -> Build: ...
    def write(self, values: Mapping[str, Assignable]) -> int: ...
    def update(self, values: Mapping[str, Assignable]) -> int: ...
    def fade(self, values: Mapping[str, Assignable]) -> int: ...  # without a step of the torque
    def before(self, names: Iterable[str]) -> Before: ...  # as they are now, to be put back
    def drive(self, action: DriveAction, **values: Any) -> str: ...
    def arm(self, shot: Shot) -> None: ...
    def recorded(self) -> bool: ...  # whether the recorder has ended
    def load(self, note: str = "") -> Recording: ...
    def end_acquisition(self) -> None: ...
    def acquire(self, shot: Shot, note: str = "") -> Recording: ...  # arm, wait, load
    # a table; the tick at which it took effect
    def fill(self, name: str, rows: npt.NDArray[np.float64]) -> int: ...
    def rehearse(
        self,
        tables: Mapping[str, npt.NDArray[np.float64]],
        values: Mapping[str, Assignable],
        seconds: float,
        tell: Tell,
    ) -> Rehearsal: ...
    def respond(self, asked: Swing, channels: Sequence[str], tell: Tell) -> FrequencyResponse: ...
    def sweep(self, asked: Tries, on_run: Callable[[Sweep], None], tell: Tell) -> Sweep: ...
    def close(self) -> None: ...
