"""The metadata of a recording, asked of the target once the rows have arrived."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from importlib import metadata
from typing import cast

import msgspec
import msgspec.json
import numpy as np
import numpy.typing as npt

from zendsp.errors import Refused, RunnerDied
from zendsp.link.parameters import ParameterSets
from zendsp.link.variables import Reading, plain
from zendsp.recording import Channel, ParameterChange, Recording
from zendsp.recording.names import FloatArray, split_element
from zendsp.recording.notes import Extra, LoopTiming, MachineNote
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState
from zendsp_protocol.texts import units_of
from zendsp_protocol.values import Assignable, from_wire
from zendsp_protocol.version import PROTOCOL


def describe(
    parameters: ParameterSets,
    status: m.AcquireStatus,
    first: int,
    data: FloatArray,
    note: str,
    patience: float,
) -> Recording:
    """The recording that is made of loaded rows and the target's metadata.

    Parameters
    ----------
    parameters : ParameterSets
        Of the target, which is asked for its log, program, parameters and timing.
    status : AcquireStatus
        Of the recorder.
    first : int
        Number of the first row of ``data``.
    data : ndarray, shape (rows, columns)
    patience : float, s
        For a broken link to come back.
    """
    overall: m.Status = parameters.insist("status", patience)
    info: m.Info = parameters.insist("info", patience)
    ticks = ticks_of(first, len(data), status.start_tick, status.decimation, status.gaps)
    last = int(ticks[-1]) if len(ticks) else 0
    program, read, changes, replaced = _made_by(parameters, status, last, patience)
    full = status.wanted > 0 and status.count - status.first >= status.wanted
    crashed = overall.state == ProgramState.CRASHED and not replaced and not full
    # a sample that crashes leaves no row: what was changed in it belongs to the recording all the
    # more
    logged = max(last, overall.tick) if crashed else last
    return Recording(
        t=ticks / overall.rate_hz,
        data=data,
        channels=join_channels(status.channels, status.units),
        sample_time=status.decimation / overall.rate_hz,
        start_tick=int(ticks[0]) if len(ticks) else status.start_tick,
        decimation=status.decimation,
        trigger_row=status.trigger_row - first if status.trigger_row >= 0 else -1,
        lost=status.lost,
        timing=_timing(overall.timing) if not replaced else {},
        log=tuple(_change(change) for change in changes if change.tick <= logged),
        parameters=parameters_at(last, read, changes),
        sources=dict(program.sources),
        compiler=program.compiler,
        flags=tuple(program.flags),
        machine=overall.machine,
        target=parameters.link.target,
        versions={**info.versions, "protocol": str(PROTOCOL), "host": host_version()},
        created=time.time(),
        note=note,
        extra={**_extra(parameters, overall, patience), "program": program.key},
    )


def ticks_of(
    first: int, rows: int, start: int, decimation: int, gaps: Sequence[tuple[int, int]]
) -> npt.NDArray[np.int64]:
    """The samples at which rows were taken, (rows,). Samples that were left out make a gap.

    Parameters
    ----------
    first, rows : int
        Number of the first row, and how many.
    start : int
        Sample of row 0.
    decimation : int
        Samples per row.
    gaps : sequence of (int, int)
        As in `AcquireStatus`.
    """
    number = np.arange(first, first + rows, dtype=np.int64)
    missing = np.zeros(rows, dtype=np.int64)
    for row, missed in gaps:
        missing[max(0, row - first) :] = missed
    return start + decimation * (number + missing)


def _made_by(
    parameters: ParameterSets, status: m.AcquireStatus, last: int, patience: float
) -> tuple[m.Program, Reading, Sequence[m.Change], bool]:
    """The program that made the rows, its parameters at sample ``last`` or later, the changes in
    between, and whether the program is no longer loaded.
    """
    program: m.Program = parameters.insist("program", patience)
    try:
        read = parameters.insist_on_all(patience)
    except (Refused, RunnerDied):
        read = Reading(last, {})  # the program is gone; its log still tells
    # after the reading, so that it holds all changes that the reading shows
    changes: Sequence[m.Change] = parameters.insist("log", patience, since=program.log_start)
    # refused where the rows are others by now
    now: m.AcquireStatus = parameters.insist("acquire_status", patience, begun=status.begun)
    if not now.replaced:  # asked last: another may have been loaded meanwhile
        return program, read, changes, False
    gone: m.Replaced = parameters.insist("acquire_program", patience)
    values = {name: from_wire(value) for name, value in gone.values.items()}
    return gone.program, Reading(gone.tick, values), gone.log, True


def parameters_at(tick: int, read: Reading, changes: Sequence[m.Change]) -> dict[str, Assignable]:
    """The parameters as they were at a sample.

    Parameters
    ----------
    read : Reading
        Of all parameters, at that sample or later.
    changes : sequence of Change
        The log, with all changes between the two.

    Examples
    --------
    >>> change = m.Change(tick=8, host_time=0.0, name="Kp[1]", old=2.0, new=5.0, author="anna")
    >>> parameters_at(7, Reading(9, {"Kp": [1.0, 5.0]}), [change])
    {'Kp': [1.0, 2.0]}
    """
    values = {name: np.asarray(value).tolist() for name, value in read.values.items()}
    for change in reversed(changes):
        if not tick < change.tick <= read.tick:
            continue
        whole, element = split_element(change.name) or (change.name, None)
        if whole not in values:
            continue
        if element is None:
            values[whole] = plain(change.old)
        else:
            values[whole][element] = plain(change.old)
    return values


def join_channels(columns: Sequence[str], units: Sequence[str]) -> tuple[Channel, ...]:
    """Turn the target's list of columns into channels: a run ``q[0], q[1], …`` is one vector ``q``.

    Examples
    --------
    >>> [(c.name, c.unit) for c in join_channels(["q[0]", "q[1]", "u[0]", "u[1]"], ["rad", "rad", "A", "V"])]
    [('q', 'rad'), ('u', 'A, V')]
    """  # noqa: E501
    channels: list[Channel] = []
    for name, unit in zip(columns, units, strict=True):
        element = split_element(name)
        if (
            element
            and element[1] > 0
            and channels
            and (channels[-1].name, channels[-1].width) == element
        ):
            each = (*units_of(channels[-1].unit, element[1]), unit)
            joined = unit if len(set(each)) == 1 else ", ".join(each)
            channels[-1] = Channel(element[0], joined, len(each))
        elif element and element[1] == 0:
            channels.append(Channel(element[0], unit, 1))
        else:
            channels.append(Channel(name, unit))
    alone = {e[0] for name in columns if (e := split_element(name)) and e[1] == 0}
    return tuple(
        Channel(f"{c.name}[0]", c.unit) if c.name in alone and c.width == 1 else c for c in channels
    )


def _timing(counted: m.Timing) -> LoopTiming:
    """The loop's timing, in types that JSON has."""
    fields = msgspec.structs.asdict(counted)
    return cast(LoopTiming, {name: plain(value) for name, value in fields.items()})


def _extra(parameters: ParameterSets, overall: m.Status, patience: float) -> Extra:
    extra = Extra(program=overall.program, scheduling=overall.scheduling, clock=overall.clock)
    try:
        machine: m.MachineInfo = parameters.insist("machine", patience)
    except (Refused, RunnerDied):
        return extra  # the program is gone, and its machine with it; the rows are not
    told: MachineNote = msgspec.json.decode(msgspec.json.encode(machine))  # without a limit: null
    return {**extra, "machine": told}


def _change(change: m.Change) -> ParameterChange:
    return ParameterChange(
        change.tick, change.host_time, change.name, plain(change.old), plain(change.new),
        change.author, change.fade,
    )


def host_version() -> str:
    """The versions that this host runs, for a recording."""
    return f"zendsp {metadata.version('zendsp')}, python {platform.python_version()}"
