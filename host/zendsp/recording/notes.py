"""Types of the keys in `Recording.timing` and `Recording.extra`, which a recording holds as JSON.
"""

from __future__ import annotations

from typing import NotRequired, TypedDict


class LoopTiming(TypedDict, total=False):
    """Timing of the loop, as the target tells it (`zendsp_protocol.messages.Timing`)."""

    ticks: int
    overruns: int
    missed: int
    exec_mean_ns: float
    exec_max_ns: int
    late_mean_ns: float
    late_max_ns: int
    exec_histogram: list[int] | int  # counts per bin; 0 where none were counted
    late_histogram: list[int] | int
    histogram_edges_ns: list[float] | int  # one more than there are bins


class JointNote(TypedDict):
    """A joint of the machine: those keys of `zendsp_protocol.messages.JointInfo` that are read."""

    name: str
    unit: str
    torque_max: float | None  # None: no limit
    counts_per_unit: float


class MachineNote(TypedDict):
    """The machine: those keys of `zendsp_protocol.messages.MachineInfo` that are read."""

    name: str
    model: str
    options: list[str]
    joints: list[JointNote]


class CutNote(TypedDict):
    """Which rows of a longer recording these are."""

    first_row: int
    rows: int
    of: int


class ResponseNote(TypedDict):
    """A frequency response that was computed from the recording."""

    f: list[float]  # Hz
    real: list[float]
    imaginary: list[float]
    std: list[float]
    coherence: list[float]
    distortion: NotRequired[list[float]]
    input: str
    output: str
    unit: str
    periods: int


class Halving(TypedDict):
    """How far each position moved when the steps of a sample were doubled."""

    inner: int
    change: list[float]


class SimulationNote(TypedDict):
    """How the simulation was made that gave the recording."""

    inner: int  # integration steps a sample
    model: str  # its file
    beyond: NotRequired[list[str]]  # limits that it left
    reference: NotRequired[str]  # what is to be said where it was planned for another machine


class StepCheck(TypedDict):
    """Whether more integration steps a sample would still move the positions."""

    converged: bool
    units: list[str]  # of each joint's position
    allowed: list[float]
    halvings: list[Halving]


class Extra(TypedDict, total=False):
    """`Recording.extra`. A user's own keys may be added; they are kept and not read."""

    # of a target
    program: str
    scheduling: str
    clock: str
    machine: MachineNote
    salvaged: str  # what is not known, since the target was killed
    # of a simulation
    simulation: SimulationNote
    step_check: StepCheck
    # of what was made of a recording
    cut: CutNote
    frequency_response: ResponseNote
    # of a foreign file
    constants: dict[str, float]
    notes: list[str]
    time_column: str  # what `t` is called there
