"""A control program loaded beside a simulated machine: its variables, its tables, its channels."""

from __future__ import annotations

import mmap
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, CompileFailed, VariableError
from zendsp.physics.simulation.plant import Plant
from zendsp_protocol.texts import counted, joint_units, on_one_line, units_of
from zendsp_protocol.values import Assignable

Array = npt.NDArray[np.float64]

_INT32, _BOOL = 3, 4  # of isr.h
_TYPES = {1: ("double *", 8), 2: ("float *", 4), _INT32: ("int32_t *", 4), _BOOL: ("bool *", 1)}
_PARAMETER, _SIGNAL, _TABLE = 1, 2, 3
_CONTINUOUS = 1e-6  # rad or m per count where the model's sensor has no resolution
_FULL_SCALE = 10000.0  # mV of the analog output for the command limit


@dataclass(frozen=True)
class Variable:
    """What a program declares: kind 1 parameter, 2 signal, 3 table; ``length`` of a table: rows."""

    name: str
    unit: str
    kind: int
    length: int
    columns: int


@dataclass(frozen=True)
class Reached:
    """How far one output of a run went.

    ``low``, ``high``: positions, rad or m (of a joint of the model). ``command``: its largest
    magnitude, in torque (mV where the model has no such joint). ``limit``: of the command, in
    torque; 0: none. ``beyond``: the first sample that asked for more, or -1.
    """

    low: float
    high: float
    command: float
    limit: float
    beyond: int


@dataclass(frozen=True)
class Outcome:
    """A run: columns by channel name (rows,) or (rows, m), units, parameters at the end, samples
    completed and wanted, how far each of the eight outputs went.
    """

    columns: Mapping[str, Array]
    units: Mapping[str, str]
    parameters: Mapping[str, Assignable]
    ticks: int
    wanted: int
    reached: tuple[Reached, ...]
    outside: int  # as of `zendsp_io` in isr.h


@dataclass(frozen=True)
class Job:
    """What the child is asked to do. ``defaults``: parameters set where the program has them and
    ``parameters`` does not name them.
    """

    parameters: Mapping[str, Assignable]
    defaults: Mapping[str, float]
    tables: Mapping[str, Array]
    seconds: float | None
    channels: Sequence[str] | None
    decimation: int
    background: int


class LoadedProgram:
    """A program loaded into this process; ``source`` is named where it cannot be."""

    def __init__(self, path: Path, source: str, plant: Plant) -> None:
        self.plant, self.native = plant, plant.native
        model, n = plant.model, plant.joints
        counts = np.ones(8)
        scale = np.ones(8)
        most = np.zeros(8)
        for j in range(n):
            step = plant.config.resolution[j]
            counts[j] = 1.0 / (step if step > 0 else _CONTINUOUS)
            full = abs(plant.config.gain[j]) * plant.config.limit[j]
            scale[j] = _FULL_SCALE / full if full > 0 else 1000.0
            most[j] = _FULL_SCALE / scale[j]
        inertia = np.zeros(8)
        inertia[:n] = plant.inertia()
        self.keep: list[Any] = [counts, scale, most, inertia]
        doubles = self.native.doubles
        program = str(path).encode()
        self.host = self.native.lib.host_open(
            program, n, plant.period, doubles(counts), doubles(scale), doubles(most),
            doubles(inertia),
        )
        problem = self.native.ffi.string(self.host.problem).decode(errors="replace")
        if problem:
            raise CompileFailed(f"{source}: {problem}")
        self.joints = tuple(
            "m" if model.joint_kind(j + 1) == "linear" else "rad" for j in range(n)
        )
        text = self.native.ffi.string
        self.variables = {}
        self.entries = {}
        for k in range(self.host.variables):
            v = self.host.variable[k]
            name = text(v.name).decode()
            unit = joint_units(
                on_one_line(text(v.unit).decode(errors="replace")),
                self.joints,
                0 if v.kind == _TABLE else v.length,
            )
            self.variables[name] = Variable(name, unit, v.kind, v.length, v.columns)
            self.entries[name] = v

    def run(self, job: Job, progress: mmap.mmap) -> Outcome:
        """Run it to the end of the job; ``progress`` has the sample that it is in."""
        for name, rows in job.tables.items():
            if name in self.variables and self.variables[name].kind == _TABLE:
                self._load_table(name, rows)
        self._write(
            {
                **{name: value for name, value in job.defaults.items() if name in self.variables},
                **job.parameters,
            }
        )
        ticks = self._ticks(job)
        columns, units, places = self._channels(job.channels)
        out = np.zeros((-(-ticks // job.decimation), len(places)))
        channel = self.native.ffi.new("host_channel[]", max(1, len(places)))
        for k, (address, kind) in enumerate(places):
            channel[k].address, channel[k].type = address, kind
        done = self.native.lib.host_run(
            self.host,
            self.plant.pointer,
            ticks,
            job.decimation,
            job.background,
            channel,
            len(places),
            self.native.doubles(out) if out.size else self.native.ffi.NULL,
            self.native.ffi.cast("int32_t *", self.native.ffi.from_buffer(progress)),
        )
        out = out[: self.host.rows]
        found: dict[str, Array] = {}
        first = 0
        for name, width in columns.items():
            block = out[:, first : first + width]
            found[name] = np.ascontiguousarray(block[:, 0] if width == 1 else block)
            first += width
        outside = int(self.host.io.outside)
        return Outcome(
            found, units, self._parameters(), done, ticks, self._reached(), outside
        )

    def _reached(self) -> tuple[Reached, ...]:
        host, limits = self.host, self.plant.config.limit
        limited = [k < self.plant.joints and limits[k] > 0.0 for k in range(8)]
        return tuple(
            Reached(
                host.low_q[k], host.high_q[k], host.most_aout[k] / host.io.mv_per_torque[k],
                host.io.torque_max[k] if limited[k] else 0.0, host.beyond[k],
            )
            for k in range(8)
        )

    def _ticks(self, job: Job) -> int:
        if job.seconds is not None:
            return max(1, round(job.seconds / self.plant.period))
        approach = self._value("approach_time") if "approach_time" in self.variables else 0.0
        rows = max((len(t) for t in job.tables.values()), default=0)
        length = rows / float(job.defaults.get("row_rate", 1.0 / self.plant.period))
        ticks = (
            round((approach + length + 0.5) / self.plant.period)
            if rows
            else round(10.0 / self.plant.period)
        )
        return min(ticks, self.plant.samples)

    def _pointer(self, name: str) -> Any:
        v = self.entries[name]
        return self.native.ffi.cast(_TYPES[v.type][0], v.address)

    def _value(self, name: str) -> float:
        return float(self._pointer(name)[0])

    def _parameters(self) -> dict[str, Assignable]:
        out: dict[str, Assignable] = {}
        for name, v in self.variables.items():
            if v.kind == _PARAMETER:
                pointer = self._pointer(name)
                values = [pointer[k] for k in range(v.length)]
                rows = [values[k : k + v.columns] for k in range(0, v.length, v.columns)]
                out[name] = values[0] if v.length == 1 else rows if v.columns > 1 else values
        return out

    def _load_table(self, name: str, rows: Array) -> None:
        v = self.variables[name]
        rows = np.ascontiguousarray(np.asarray(rows, dtype=np.float64).reshape(len(rows), -1))
        if rows.shape[1] != v.columns:
            raise VariableError(
                f"{name}: the program's table has {counted(v.columns, 'column')}, the reference"
                f" {rows.shape[1]}"
            )
        if len(rows) > v.length:
            raise VariableError(
                f"{name}: {len(rows)} rows; the program's table holds at most {v.length}"
            )
        self.keep.append(rows)
        entry = self.native.ffi.cast("isr_table *", self.entries[name].address)
        entry.data = self.native.doubles(rows)
        entry.rows = len(rows)
        entry.version = entry.version + 1

    def _write(self, given: Mapping[str, Assignable]) -> None:
        wrong = []
        for name, value in given.items():
            try:
                base, element = self._split(name)  # J[0], say
            except AcquisitionError as error:
                wrong.append(str(error).replace("no channel", "no parameter", 1))
                continue
            v = self.variables.get(base)
            if v is None or v.kind == _SIGNAL:
                known = ", ".join(n for n, w in self.variables.items() if w.kind == _PARAMETER)
                wrong.append(
                    f"{name}: {'a signal, not a parameter' if v else 'no such parameter'}; the"
                    f" program has {known}"
                )
                continue
            if element is not None and not 0 <= element < (0 if v.kind == _TABLE else v.length):
                wrong.append(f"{name}: {base} has {counted(v.length, 'element')}, the first is 0")
                continue
            if v.kind == _TABLE:
                self._load_table(name, np.asarray(value, dtype=np.float64))
                continue
            wrong += self._write_one(name, v, value, element)
        if wrong:
            raise VariableError("\n".join(wrong))

    def _write_one(
        self, name: str, v: Variable, value: Any, element: int | None
    ) -> list[str]:
        """Write a parameter, or one of its elements; return what is wrong with the value."""
        first, length = (0, v.length) if element is None else (element, 1)
        entry = self.entries[v.name]
        try:
            numbers = np.ravel(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError):
            return [f"{name}: {value!r} is not a number"]
        if entry.type != _BOOL and np.asarray(value).dtype.kind == "b":
            return [
                f"{name}: {value!r} is true or false, not a number; write 1 or 0 if that is meant"
            ]
        if len(numbers) != length:
            return [f"{name}: {len(numbers)} numbers given, it has {length}"]
        bad = ~((numbers >= entry.minimum) & (numbers <= entry.maximum))
        if bad.any():
            unit = units_of(v.unit, v.length)[first + int(np.argmax(bad))]
            return [
                f"{name}: {numbers[bad][0]:g} is outside {entry.minimum:g} … {entry.maximum:g}"
                f" {unit}".rstrip()
            ]
        if entry.type in (_INT32, _BOOL) and (numbers != np.round(numbers)).any():
            return [f"{name}: {numbers[0]:g} is not a whole number"]
        pointer = self._pointer(v.name)
        kind = {_INT32: int, _BOOL: bool}.get(entry.type, float)
        for k, x in enumerate(numbers):
            pointer[first + k] = kind(x)
        return []

    def _channels(
        self, wanted: Sequence[str] | None
    ) -> tuple[dict[str, int], dict[str, str], list[tuple[Any, int]]]:
        ffi, host, n = self.native.ffi, self.host, self.plant.joints
        q, qd, tau = (joint_units(u, self.joints, n) for u in ("{q}", "{q}/s", "{tau}"))
        own: dict[str, tuple[Any, int, str]] = {
            "tick": (ffi.addressof(host, "tick"), 1, ""),
            "t": (ffi.addressof(host, "t"), 1, "s"),
            "enc": (host.enc, n, "counts"),
            "aout": (host.io.aout, n, "mV"),
            "measured": (host.measured, n, q),
            "plant_q": (host.q, n, q),
            "plant_qd": (host.qd, n, qd),
            "plant_torque": (host.torque, n, tau),
        }
        names = (
            list(wanted)
            if wanted is not None
            else [v.name for v in self.variables.values() if v.kind == _SIGNAL]
        )
        columns: dict[str, int] = {}
        units: dict[str, str] = {}
        places: list[tuple[Any, int]] = []
        for name in names:
            base, element = self._split(name)
            if base in self.variables and self.variables[base].kind != _TABLE:
                v = self.variables[base]
                kind = self.entries[base].type
                start = int(ffi.cast("uintptr_t", self.entries[base].address))
                size = _TYPES[kind][1]
                length = v.length
                unit = v.unit
            elif base in own:
                pointer, length, unit = own[base]
                start, size, kind = int(ffi.cast("uintptr_t", pointer)), 8, 1
            else:
                known = ", ".join(
                    [*(k for k, v in self.variables.items() if v.kind != _TABLE), *own]
                )
                raise AcquisitionError(f"no channel {name!r}; there are {known}")
            if element is not None and not 0 <= element < length:
                raise AcquisitionError(f"no channel {name!r}: {base} has {length} elements")
            picked = range(length) if element is None else [element]
            places += [(ffi.cast("void *", start + size * k), kind) for k in picked]
            columns[name] = len(picked)
            units[name] = unit if element is None else units_of(unit, length)[element]
        return columns, units, places

    def _split(self, name: str) -> tuple[str, int | None]:
        """A variable and its element: ``q[1]``, or of a matrix ``K[1,2]``."""
        match = re.fullmatch(r"(.+)\[(\d+)(?:, ?(\d+))?\]", name)
        if match is None:
            return name, None
        base, first = match[1], int(match[2])
        if match[3] is None:
            return base, first
        v = self.variables.get(base)
        inside = v is not None and int(match[3]) < v.columns
        if v is None or not inside:
            shape = f"{v.length // v.columns} rows of {v.columns}" if v else "no columns"
            raise AcquisitionError(f"no channel {name!r}: {base} has {shape}")
        return base, first * v.columns + int(match[3])
