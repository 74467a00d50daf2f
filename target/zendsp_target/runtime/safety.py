"""Trips, limits, drive modes and timing: the loop's numbers as messages of the protocol."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import Refused
from zendsp_protocol.messages import JointInfo, Limits, MachineInfo, Timing, Trip
from zendsp_protocol.states import DriveMode, OverrunPolicy, TripReason
from zendsp_protocol.stop_page import signature
from zendsp_protocol.texts import counted
from zendsp_protocol.values import Value
from zendsp_target.runtime.memory.layout import layout, text_of

DRIVE_MODES = {DriveMode.OFF: 0, DriveMode.TORQUE: 1, DriveMode.VELOCITY: 2}
OVERRUN_POLICIES = {OverrunPolicy.COUNT: 0, OverrunPolicy.SKIP: 1, OverrunPolicy.TRIP: 2}
_UNWATCHED = 12
# TRIP_… of layout.h, in its order
_REASONS = {
    **dict(enumerate(tuple(TripReason)[:11], 1)),
    _UNWATCHED: TripReason.HOST_LOST,
    13: TripReason.STALL,
    14: TripReason.OUTSIDE,
}
REQUESTS = {TripReason.STOP: 1, TripReason.HOST_LOST: 3}
_ASKED = {
    TripReason.STOP: "STOP was requested",
    TripReason.HOST_LOST: "the host that commanded the motion is gone",
}
_NOBODY = "the target's monitor stood still: nobody would have seen that the host is lost"
_IDLE = "; the program commands it 0, so nothing holds it"  # after what a joint passed
_LOOKS = 100  # until two are the same: one may be acknowledged, and another latched, meanwhile
_ARRAYS = ("position_min", "position_max", "speed_max", "torque_max", "command_max")


def trip_of(control: Any, machine: MachineInfo) -> Trip | None:
    """The trip that is latched and carried out, None while there is none. A trip is not told before
    the machine has its safe outputs.

    Parameters
    ----------
    machine : MachineInfo
        For the names and units in its sentence.
    """
    ffi, lib = layout()
    acted = lib.monitor_load32(ffi.addressof(control.trip, "acted"))
    return _trip_in(control, machine) if acted else None


def latched_trip(control: Any, machine: MachineInfo) -> Trip | None:
    """The latched trip, carried out or not (see :func:`trip_of`), or one that was requested and
    that the loop has not yet seen; None while there is none.
    """
    ffi, lib = layout()
    # before the trip, which the loop latches before it clears this
    asked = lib.monitor_load32(ffi.addressof(control, "stop"))
    trip = _trip_in(control, machine)
    lost = asked == REQUESTS[TripReason.HOST_LOST]
    reason = TripReason.HOST_LOST if lost else TripReason.STOP
    return trip or (asked_trip(reason, int(control.tick)) if asked else None)


def _trip_in(control: Any, machine: MachineInfo) -> Trip | None:
    ffi, _ = layout()
    shared = ffi.addressof(control.trip)
    copy = ffi.new(ffi.typeof(shared))
    raw, seen = copy[0], bytes(ffi.buffer(shared))
    for _ in range(_LOOKS):
        before, seen = seen, bytes(ffi.buffer(shared))
        if seen == before:
            break
    ffi.memmove(copy, seen, len(seen))
    reason = _REASONS.get(raw.reason)
    if reason is None:
        return None
    joint, tick, value, limit = int(raw.joint), int(raw.tick), float(raw.value), float(raw.limit)
    said = _NOBODY if raw.reason == _UNWATCHED else _cause(machine, reason, joint, value, limit)
    idle = bool(raw.idle) and machine.joints[joint - 1].command != "none"
    cause = said + _IDLE * idle + _by(bytes(ffi.buffer(raw.by)))
    text = f"{cause} (sample {tick}); outputs are safe until acknowledged"
    return Trip(reason, joint, tick, value, limit, text, cause, idle=idle)


def asked_trip(reason: TripReason, tick: int, by: bytes = b"") -> Trip:
    """A STOP, or another of `REQUESTS`, that no loop has carried out, because none ran or it ended
    before.
    """
    cause = _ASKED[reason] + _by(by)
    return Trip(reason, tick=tick, text=f"{cause}; nothing moves until acknowledged", cause=cause)


def _by(who: bytes) -> str:
    name = signature(who)
    return f" by {name}" if name else ""


def _cause(
    machine: MachineInfo, reason: TripReason, joint: int, value: float, limit: float
) -> str:
    if reason == TripReason.OUTSIDE:
        return (
            f"the code names joint or channel [{value:.0f}], counted from 0, which is not there:"
            f" this machine has {counted(len(machine.joints), 'joint')}"
        )
    if joint > len(machine.joints):
        return (
            f"the code writes to joint {joint}, which this machine has not: it has"
            f" {len(machine.joints)}; in the code, which counts from 0, it is"
            f" WRITE_TORQUE({joint - 1}, …) or another output of that number"
        )
    which = machine.joints[joint - 1] if joint >= 1 else machine.joints[0]
    unit, who = which.unit, which.name
    torque = "N" if unit == "m" else "N m"
    if reason == TripReason.TORQUE and which.mv_per_torque == 0.0:
        takes = (
            "which has no motor"
            if which.command == "none"
            else f"which takes a {which.command}: IOGP_FU1_WRITE_AOUT_ENGU({joint - 1}) = mV"
        )
        return f"the code writes {value:.4g} {torque} to {who}, {takes}"
    causes = {
        **_ASKED,
        TripReason.STOP_INPUT: "the STOP input of the machine is active",
        TripReason.TORQUE: (
            f"{who}: command of {value:.4g} {torque} exceeds the limit of {limit:.4g} {torque}"
        ),
        TripReason.SPEED: (
            f"{who}: speed of {value:.4g} {unit}/s exceeds the limit of {limit:.4g} {unit}/s"
        ),
        TripReason.POSITION: (
            f"{who}: position {value:.6g} {unit} is beyond the limit of {limit:.6g} {unit}"
        ),
        TripReason.COMMAND: (
            f"{who}: command of {value:.5g} mV exceeds the limit of {limit:.5g} mV"
        ),
        TripReason.NAN: f"{who}: the code computed {value} as its output",
        TripReason.OVERRUN: f"{value:.0f} samples in a row came later and later",
        TripReason.SENSOR: f"{who}: the position sensor reports a fault",
        TripReason.HOMING: "homing failed",
        TripReason.STALL: (
            f"the loop stood still for {value:.3g} s; {limit:g} s are borne (did the computer"
            " sleep?)"
        ),
    }
    return causes[reason]


def machine_of(control: Any) -> MachineInfo:
    """What the machine says of itself."""
    info = control.info
    joints = tuple(
        JointInfo(
            text_of(j.name),
            text_of(j.unit),
            text_of(j.command),
            j.counts_per_unit,
            j.zero_counts,
            j.mv_per_torque,
            j.mv_per_speed,
            j.command_max,
            j.position_min,
            j.position_max,
            j.speed_max,
            j.torque_max,
            j.home,
            j.length,
        )
        for j in (info.joint[i] for i in range(info.joints))
    )
    return MachineInfo(
        text_of(info.name),
        text_of(info.text),
        bool(info.simulated),
        joints,
        tuple(text_of(info.adc_name[i]) for i in range(info.adcs)),
        tuple(text_of(info.adc_unit[i]) for i in range(info.adcs)),
        info.dins,
        info.douts,
        info.stop_input,
        bool(info.needs_homing),
    )


def limits_of(values: dict[str, Value]) -> Limits:
    """Limits from the values of the settings ``limit.…``."""
    arrays = {
        name: tuple(float(x) for x in np.atleast_1d(np.asarray(values[f"limit.{name}"])))
        for name in _ARRAYS
    }
    return Limits(**arrays, torque_clamp=bool(values["limit.torque_clamp"]))


def limit_names() -> tuple[str, ...]:
    """Names of the settings that are limits."""
    return tuple(f"limit.{name}" for name in (*_ARRAYS, "torque_clamp"))


def check_limits(machine: MachineInfo, changes: Mapping[str, Value]) -> dict[str, Value]:
    """Settings for changed limits, checked against the machine: a limit may be tightened, and never
    lies beyond the machine's own.

    Parameters
    ----------
    changes : dict
        Fields of Limits; arrays have one entry per joint, or one number for all.

    Returns
    -------
    dict
        Setting name to value.

    Raises
    ------
    Refused
        Unknown field, wrong length, NaN, or beyond the machine.
    """
    settings: dict[str, Value] = {}
    joints = len(machine.joints)
    for name, value in changes.items():
        if name == "torque_clamp":
            settings["limit.torque_clamp"] = int(bool(value))
            continue
        if name not in _ARRAYS:
            raise Refused(f"no limit {name!r}: there are {', '.join((*_ARRAYS, 'torque_clamp'))}")
        array = np.asarray(value, dtype=np.float64)
        array = np.full(joints, float(array)) if array.ndim == 0 else array
        if array.shape != (joints,) or not np.all(np.isfinite(array)):
            raise Refused(f"limit {name}: give {joints} finite numbers, got {value!r}")
        for joint, (wanted, own) in enumerate(
            zip(array, (getattr(j, name) for j in machine.joints), strict=True), 1
        ):
            beyond = wanted < own if name == "position_min" else wanted > own
            if beyond or (name not in ("position_min", "position_max") and wanted < 0.0):
                raise Refused(
                    f"limit {name} of joint {joint}: {wanted:g} is outside what the machine bears"
                    f" ({own:g})"
                )
        settings[f"limit.{name}"] = float(array[0]) if joints == 1 else array
    return settings


@lru_cache
def histogram_edges(bins: int) -> npt.NDArray[np.float64]:
    """Edges of the timing histograms: four bins an octave, the last one open.

    Returns
    -------
    ndarray, shape (bins + 1,)
        ns; bin b counts durations in [edge b, edge b + 1).
    """
    edges = np.array(
        [float(b) if b < 4 else float((4 + b % 4) * 2 ** (b // 4 - 1)) for b in range(bins + 1)]
    )
    edges.flags.writeable = False  # one array for all who ask
    return edges


def timing_of(control: Any) -> Timing:
    """Timing counts.
    """
    ffi, lib = layout()
    raw = control.timing
    samples = max(1, int(raw.samples))
    bins = int(lib.LAYOUT_BINS)
    return Timing(
        ticks=int(raw.samples), overruns=int(raw.overruns), missed=int(raw.missed),
        exec_mean_ns=int(raw.exec_sum) / samples, exec_max_ns=int(raw.exec_max),
        late_mean_ns=int(raw.late_sum) / samples, late_max_ns=int(raw.late_max),
        exec_histogram=np.frombuffer(ffi.buffer(raw.exec_bins), dtype=np.int64).copy(),
        late_histogram=np.frombuffer(ffi.buffer(raw.late_bins), dtype=np.int64).copy(),
        histogram_edges_ns=histogram_edges(bins),
    )  # fmt: skip


def no_timing() -> Timing:
    """Timing of a loop that never ran."""
    _, lib = layout()
    bins = int(lib.LAYOUT_BINS)
    zeros = np.zeros(bins, dtype=np.int64)
    return Timing(0, 0, 0, 0.0, 0, 0.0, 0, zeros, zeros, histogram_edges(bins))
