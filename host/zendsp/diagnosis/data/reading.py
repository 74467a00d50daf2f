"""Recordings as signals in joint coordinates, checked before any physics is blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from zendsp.diagnosis.data.sensors import SENSED, judged, read_sensed
from zendsp.errors import RecordingError
from zendsp.physics.effects import library
from zendsp.physics.fit import Data
from zendsp.physics.model import Model, per_joint
from zendsp.physics.signals import find_resolution, measure, noise_beside_quantisation, smooth
from zendsp.recording import Recording, Table, read_table
from zendsp.recording.units import to_si

Array = npt.NDArray[np.float64]

MIN_SAMPLES = 300
TARGET_RATE = 1000.0  # Hz: faster recordings are averaged down to about this
# samples times joints of a recording above which it is averaged down further, to SLOWEST_RATE at
# least: the fastest observer has 10 Hz
BUDGET = 150_000
SLOWEST_RATE = 250.0  # Hz


@dataclass(frozen=True)
class Signals:
    """One recording in joint coordinates: arrays (n, joints), SI; ``notes`` say what was done to
    the data.
    """

    name: str
    time: Array
    sample_time: float
    position: Array
    command: Array  # torque or command units, after the actuator's matrix
    reference: Array | None
    resolution: Array  # (joints,)
    notes: tuple[str, ...] = ()
    extra: dict[str, Array] = field(default_factory=dict)
    raw: Signals | None = None  # before averaging down, where that was done
    # (joints,): what a filter or averaging leaves of the quantiser's noise, however still a joint
    # stands
    least_noise: Array | None = None

    def part(self, start: int, stop: int, name: str) -> Signals:
        """Rows start … stop - 1 as a recording of their own."""
        cut = slice(start, stop)
        return replace(
            self,
            name=name,
            time=self.time[cut],
            position=self.position[cut],
            command=self.command[cut],
            reference=None if self.reference is None else self.reference[cut],
            extra={key: value[cut] for key, value in self.extra.items()},
            raw=None,
        )


@dataclass(frozen=True)
class Parts:
    """The three parts of the data: what models are fitted to, what choices are made by, and what
    neither has touched.
    """

    fit: Data
    choose: Data
    test: Data

    @property
    def each(self) -> tuple[Data, ...]:
        """The different parts."""
        return tuple({id(part): part for part in (self.fit, self.choose, self.test)}.values())

    @property
    def held(self) -> Data:
        """Everything that no model is fitted to."""
        if self.choose is self.test:
            return self.test
        return replace(self.test, records=(*self.choose.records, *self.test.records))


def read_signals(source: str | Path | Recording | Table, model: Model) -> Signals:
    """Read a recording by the column names of a model.

    Parameters
    ----------
    source : path, Recording or Table
    model : Model

    Returns
    -------
    Signals

    Raises
    ------
    RecordingError
        With the file, the column and what was expected.
    """
    columns = model.columns or {"time": "t", "position": "q", "command": "u"}
    for key in ("position",):
        if key not in columns:
            raise RecordingError(
                f"the model's [columns] lacks {key!r}: which column holds the position?"
            )
    name, get, done = _getter(source)
    joints = model.joints
    get, repeated = _without_repeats(get, columns)
    position = _matrix(name, "position", get, columns["position"], joints)
    n = len(position)
    if "command" in columns:
        command = _matrix(name, "command", get, columns["command"], joints)
    else:
        command = np.zeros_like(position)
    for label, values in (("position", position), ("command", command)):
        if len(values) != n:
            raise RecordingError(f"{name}: {label} has {len(values)} rows, position {n}")
        bad = ~np.isfinite(values)
        if bad.any():
            row, column = (int(i[0]) for i in np.nonzero(bad))
            raise RecordingError(
                f"{name}: {label} {_column_name(columns[label], column)!r} has {int(bad.sum())}"
                f" values that are not finite numbers (first in row {row + 1}); expected none"
            )
    if n < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: has {n} rows; a diagnosis needs at least {MIN_SAMPLES} samples"
        )
    reference = (
        _matrix(name, "reference", get, columns["reference"], joints)
        if "reference" in columns and _has(get, columns["reference"])
        else None
    )
    time, sample_time, notes, grid = _clock(name, get, columns, model, n)
    wanted = {
        role
        for effect in library().values()
        for role in effect.reads
        if role in columns and _has(get, columns[role])
    }
    extra = {role: _optional(name, role, get, columns[role], n, joints) for role in sorted(wanted)}
    for role in SENSED:
        if role in columns:
            if _has(get, [item for item in _names(columns[role]) if item]):
                shape = (n, joints)
                extra[role] = read_sensed(name, role, get, columns[role], shape)
            else:
                notes.append(f"{name}: {role} was not used: no column {columns[role]!r}")
    if repeated:
        notes.append(f"{name}: {repeated} rows repeat the row before, its time included; left out")
    resolution = np.array(
        [_resolution(name, columns, j, position, command, model, notes) for j in range(joints)]
    )
    position, held = _read_anew(position, resolution)
    if held:
        notes.append(
            f"{name}: {held} positions repeat the one before in the midst of a motion, so the"
            " sensor was not read; the line between their neighbours stands there"
        )
    if grid is not None:
        position = _lattice(_resample(grid, time, position), position[0], resolution)
        command = _resample_held(grid, time, command)
        reference = None if reference is None else _resample(grid, time, reference)
        extra = {role: _resample(grid, time, values) for role, values in extra.items()}
        time = grid
    if model.sensor.matrix:
        matrix = np.array(model.sensor.matrix)
        position = position @ matrix.T
        reference = None if reference is None else reference @ matrix.T
        resolution = np.sqrt((matrix**2) @ resolution**2)
    if model.sensor.offset:
        offset = np.array([per_joint(model.sensor.offset, j + 1, 0.0) for j in range(joints)])
        position = position + offset
    if model.actuator.matrix:
        command = command @ np.array(model.actuator.matrix).T
    if model.robot.servos:
        command, told = _through_servos(name, command, position, resolution, sample_time, model)
        notes += told
    for role in [role for role in SENSED if role in extra]:
        extra[role], said = judged(role, extra[role], position, command, sample_time)
        notes += [f"{name}: {words}" for words in said]
    # what rounding did at low frequencies stays where a filter took the lattice away
    stated = [per_joint(model.sensor.resolution, j + 1, 0.0) for j in range(joints)]
    rounded = np.where(resolution > 0, 0.0, np.maximum(stated, 0.0) / np.sqrt(12))
    signals = Signals(
        name, time, sample_time, position, command, reference, resolution, (*done, *notes), extra,
        least_noise=rounded,
    )
    return _decimate(signals)


def _through_servos(
    name: str, command: Array, position: Array, resolution: Array, sample_time: float, model: Model
) -> tuple[Array, list[str]]:
    """Torques that servos gave along the measured motion, from what they were told, and a note."""
    out, joints = command.copy(), []
    for j, drive in enumerate(model.robot.servos):
        if drive is None:
            continue
        y = np.ascontiguousarray(position[:, j])
        step = float(resolution[j])
        measured = measure(y, sample_time, step, noise_beside_quantisation(y, step))
        q, qd, _ = smooth(measured, sample_time, np.zeros(len(y))).states
        out[:, j] = drive.applied(command[:, j], q, qd, sample_time)
        joints.append(str(j + 1))
    return out, [
        f"{name}: joint {', '.join(joints)}: the command is the set value of a servo; taken as the"
        f" torque that the servo of {Path(model.file).name} gives along the measured motion"
    ]


def with_same_columns(
    signals: Sequence[Signals], others: Sequence[Signals]
) -> tuple[list[Signals], list[Signals]]:
    """The recordings with those optional columns that all of them have."""
    all_of_them = (*signals, *others)
    roles = {
        role for s in all_of_them for role in s.extra if all(role in x.extra for x in all_of_them)
    }

    def kept(s: Signals) -> Signals:
        return replace(s, extra={role: values for role, values in s.extra.items() if role in roles})

    return [kept(s) for s in signals], [kept(s) for s in others]


def joint_columns(signals: Signals, joint: int) -> dict[str, Array]:
    """The optional columns that one joint (from 0) has, by their role, (n,) each."""
    return {
        role: np.ascontiguousarray(values[:, joint])
        for role, values in signals.extra.items()
        if np.isfinite(values[:, joint]).all()
    }


def unused_effects(signals: Sequence[Signals], model: Model) -> list[str]:
    """A note for each effect that a recording lacks a column for.

    Parameters
    ----------
    signals : sequence of Signals
    model : Model

    Returns
    -------
    list of str
    """
    notes = []
    for effect in library().values():
        for role in effect.reads:
            lacking = [s.name for s in signals if role not in s.extra]
            if lacking:
                where = (
                    f"{', '.join(lacking)}: no column"
                    if role in model.columns
                    else "the model's [columns] names no column"
                )
                notes.append(f"{effect.name} was not considered: {where} of {role}")
    return notes


def _optional(name: str, role: str, get: Any, spec: Any, n: int, joints: int) -> Array:
    """An optional column, one number for all joints or one each, (n, joints)."""
    parts = [
        np.asarray(get(str(item)), float) for item in (spec if isinstance(spec, list) else [spec])
    ]
    values = np.concatenate([part[:, None] if part.ndim == 1 else part for part in parts], axis=1)
    if values.shape[1] not in (1, joints) or len(values) != n:
        raise RecordingError(
            f"{name}: {role} {spec!r} has shape {values.shape}; expected {n} rows and 1 or {joints}"
            " columns"
        )
    bad = ~np.isfinite(values)
    if bad.any():
        raise RecordingError(
            f"{name}: {role} {spec!r} has {int(bad.sum())} values that are not finite numbers"
            f" (first in row {int(np.argwhere(bad)[0, 0]) + 1}); expected none"
        )
    return np.array(np.broadcast_to(values, (n, joints)))


def _getter(source: Any) -> tuple[str, Any, tuple[str, ...]]:
    """Its name, a function from a column's name to its numbers in SI, and what was done to get
    these.
    """
    if isinstance(source, Recording):
        names = set(source.names)

        def from_recording(column: str) -> Array:
            if column in ("t", "time") and column not in names:
                return np.asarray(source.t, float)
            try:
                known = to_si(source.units.get(column.partition("[")[0], ""))
                return np.asarray(source[column], float) * (known[0] if known else 1.0)
            except (KeyError, RecordingError):
                raise RecordingError(
                    f"the recording has no channel {column!r}; it has {', '.join(source.names)}"
                ) from None

        return "recording", from_recording, ()
    table = source if isinstance(source, Table) else read_table(source)
    return str(table.path), lambda column: table[column], table.notes


def _without_repeats(get: Any, columns: Any) -> tuple[Any, int]:
    """A getter without the rows whose time and positions are those of the row before, and how many
    there are.
    """
    if "time" not in columns or not _has(get, columns["time"]):
        return get, 0
    time = np.asarray(get(str(columns["time"])))
    spec = columns["position"]
    parts = [np.asarray(get(str(item))) for item in (spec if isinstance(spec, list) else [spec])]
    if time.ndim != 1 or len(time) < 2 or any(len(p) != len(time) for p in parts):
        return get, 0
    again = np.r_[False, np.diff(time) == 0]
    for p in parts:
        again[1:] &= (p[1:] == p[:-1]).reshape(len(time) - 1, -1).all(axis=1)
    if not again.any():
        return get, 0
    keep = ~again
    return lambda column: np.asarray(get(column))[keep], int(again.sum())


def _read_anew(position: Array, resolution: Array) -> tuple[Array, int]:
    """Positions (n, joints) without those that a logger only repeated, and how many there were.

    A joint does not stand still for one sample and make up for it in the next: the value before
    stands there again, the step before it is several counts, and the step after it is two.
    """
    out, count = position.copy(), 0
    step = np.diff(position, axis=0)
    for j in range(position.shape[1]):
        before, none, after = step[:-2, j], step[1:-1, j], step[2:, j]
        fast = 0.1 * float(np.abs(step[:, j]).max())  # slower, such a row is next to no error
        several = np.abs(before) > max(4.0 * resolution[j], fast)
        double = np.abs(after - 2.0 * before) < 0.5 * np.abs(before)
        rows = 2 + np.flatnonzero((none == 0) & several & double)
        out[rows, j] = 0.5 * (position[rows - 1, j] + position[rows + 1, j])
        count += len(rows)
    return out, count


def _has(get: Any, column: Any) -> bool:
    try:
        for item in column if isinstance(column, list) else [column]:
            get(item)
    except RecordingError:
        return False
    return True


def _names(spec: Any) -> list[str]:
    """The names of a column specification."""
    return [str(item) for item in spec] if isinstance(spec, list) else [str(spec)]


def _column_name(spec: Any, index: int) -> str:
    return str(spec[index]) if isinstance(spec, list) else str(spec)


def _matrix(name: str, label: str, get: Any, spec: Any, joints: int) -> Array:
    if isinstance(spec, list):
        parts = [np.asarray(get(str(item)), float) for item in spec]
        for item, part in zip(spec, parts, strict=True):
            if part.ndim != 1:
                raise RecordingError(
                    f"{name}: column {item!r} has shape {part.shape}; expected one number a row"
                )
        values = np.stack(parts, axis=1)
    else:
        values = np.asarray(get(str(spec)), float)
        values = values[:, None] if values.ndim == 1 else values
    if values.shape[1] != joints:
        raise RecordingError(
            f"{name}: {label} {spec!r} has {values.shape[1]} columns; the model has {joints} joints"
        )
    return values


def _clock(
    name: str, get: Any, columns: Any, model: Model, n: int
) -> tuple[Array, float, list[str], Array | None]:
    notes: list[str] = []
    if "time" not in columns or not _has(get, columns["time"]):
        if model.sample_time is None:
            raise RecordingError(
                f"{name}: has no time column {columns.get('time', 't')!r} and the model no"
                " sample_time"
            )
        return np.arange(n, dtype=np.float64) * model.sample_time, model.sample_time, notes, None
    time: Array = np.asarray(get(str(columns["time"])), dtype=np.float64)
    if time.ndim != 1 or not np.isfinite(time).all():
        raise RecordingError(
            f"{name}: time column {columns['time']!r} holds values that are not finite numbers"
        )
    step = np.diff(time)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 2
        raise RecordingError(
            f"{name}: time runs backwards or stands still at row {row}: are two runs glued"
            " together? Give them as two files"
        )
    period = float(np.median(step))
    if period > 0.1:
        raise RecordingError(
            f"{name}: samples are {period:.4g} s apart; a diagnosis needs at least 10 a second: is"
            f" the time column {columns['time']!r} in seconds?"
        )
    if model.sample_time and abs(period / model.sample_time - 1) > 0.2:
        raise RecordingError(
            f"{name}: samples are {period:.6g} s apart, the model says sample_time ="
            f" {model.sample_time:.6g} s: check the unit of the time column"
        )
    if (
        model.sample_time
        and abs(np.mean(step) / model.sample_time - 1) < 1e-3
        and abs(period / model.sample_time - 1) < 0.05
    ):
        period = model.sample_time
    jitter = float(np.max(np.abs(step - period))) / period
    if jitter < 0.02:
        return time, float((time[-1] - time[0]) / (n - 1)), notes, None
    if float(np.max(step)) > max(50 * period, 0.1):
        k = int(np.argmax(step))
        raise RecordingError(
            f"{name}: a gap of {step[k]:.3g} s at t = {time[k]:.4g} s: are two runs glued together?"
            " Give them as two files"
        )
    spread = float(np.std(step)) / period
    notes.append(
        f"{name}: time stamps jitter by {100 * spread:.1f} % of the sample time (largest step"
        f" {np.max(step) / period:.1f} samples); resampled uniformly"
    )
    return time, period, notes, np.arange(time[0], time[-1], period)


def _resolution(
    name: str,
    columns: Any,
    joint: int,
    position: Array,
    command: Array,
    model: Model,
    notes: list[str],
) -> float:
    """Step of a position column: as the model says, checked against the lattice that its numbers
    lie on.
    """
    stated = per_joint(model.sensor.resolution, joint + 1, 0.0)
    y = position[:, joint]
    found = find_resolution(y)
    if stated <= 0:
        return found
    if _on_lattice(y, stated):
        return stated
    where = f"{name}: position {_column_name(columns['position'], joint)!r}"
    if found > 0:
        for factor, words in ((180 / np.pi, "degrees, not radians"), (1e3, "milli-units")):
            if abs(found / stated / factor - 1) < 0.02:
                raise RecordingError(
                    f"{where}: its smallest step is {found:.6g}, {found / stated:.4g} times the"
                    f" model's position_resolution of {stated:.6g}: the column is in {words}"
                )
    if any(_on_lattice(y, stated / part) for part in (2, 4, 8, 5, 10)):
        return stated  # whole fractions of a count: interpolated or averaged by the drive
    if "command" in columns and _on_lattice(command[:, joint], stated, least=100):
        raise RecordingError(
            f"{where}: the command column has the sensor's resolution of {stated:.6g} and the"
            " position column has not: position and command are swapped"
        )
    notes.append(
        f"{where} does not lie on the model's position_resolution of {stated:.4g}; "
        + (f"its smallest step is {found:.4g}" if found else "no lattice is seen")
    )
    return found


def _on_lattice(y: Array, step: float, least: int = 0) -> bool:
    """Whether differences are whole steps, as far as the numbers' own digits allow; ``least``: so
    many must show it.
    """
    ratio = np.abs(np.diff(y)) / step
    ratio = ratio[(ratio > 0.02) & (ratio < 300)]
    if len(ratio) < 10 or len(ratio) < least:
        return least == 0
    return float(np.mean(np.abs(ratio - np.round(ratio)) < 0.05)) > 0.95


def _lattice(values: Array, origin: Array, resolution: Array) -> Array:
    """Interpolated positions put back on the sensor's counts: the quantiser's model holds for
    counts, not for means of them.
    """
    step = np.where(resolution > 0, resolution, 1.0)
    counts: Array = np.where(
        resolution > 0, origin + step * np.round((values - origin) / step), values
    )
    return counts


def _resample(grid: Array, time: Array, values: Array) -> Array:
    """Straight lines between the rows, at the instants of a uniform grid, (n, columns)."""
    return np.stack([np.interp(grid, time, column) for column in values.T], axis=1)


def _resample_held(grid: Array, time: Array, values: Array) -> Array:
    """The mean over each step of a uniform grid of what is held from row to row, (n, columns).

    The command before an instant would come half a sample late, where stamps lie on both sides of
    the grid.
    """
    period = float(grid[1] - grid[0])
    edges = np.append(grid, grid[-1] + period)
    ends = np.append(time, max(edges[-1], time[-1]) + period)
    out = []
    for column in values.T:
        sums = np.concatenate([[0.0], np.cumsum(column * np.diff(ends))])
        out.append(np.diff(np.interp(edges, ends, sums)) / period)
    return np.stack(out, axis=1)


def _decimate(signals: Signals) -> Signals:
    seconds = len(signals.time) * signals.sample_time
    affordable = BUDGET / (seconds * signals.position.shape[1])
    rate = min(TARGET_RATE, max(SLOWEST_RATE, affordable))
    factor = int(1.0 / (signals.sample_time * rate) + 0.2)
    if factor < 2:
        return signals
    n = (len(signals.time) // factor) * factor
    half = (factor - 1) // 2  # windows that overlap would make the noise of neighbours alike

    def centred(values: Array) -> Array:  # mean over the samples around each kept sample
        padded = np.concatenate(
            [np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], factor, axis=0)]
        )
        sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), padded]), axis=0)
        start = np.arange(0, n, factor)
        width = 2 * half + 1
        mean: Array = (sums[start + width] - sums[start]) / width
        return mean

    held = signals.command[:n].reshape(-1, factor, signals.command.shape[1]).mean(axis=1)
    # means of many counts within a sample are better than one of them; of a few, which at low speed
    # are all the same, they hide the counts
    few = half == 0 or 1 / signals.sample_time < 1.5 * TARGET_RATE
    counts = (signals.resolution > 0) & few
    white = signals.resolution / np.sqrt(12 * (2 * half + 1))
    least = np.zeros_like(white) if signals.least_noise is None else signals.least_noise
    note = (
        f"{signals.name}: {1 / signals.sample_time:.0f} Hz averaged down to"
        f" {1 / signals.sample_time / factor:.0f} Hz"
    )
    return replace(
        signals,
        time=signals.time[:n:factor],
        sample_time=signals.sample_time * factor,
        position=np.where(counts, signals.position[:n:factor], centred(signals.position)),
        command=held,
        reference=None if signals.reference is None else signals.reference[:n:factor],
        resolution=np.where(counts, signals.resolution, 0.0),
        least_noise=np.maximum(least, np.where(counts, 0.0, white)),
        extra={role: centred(values) for role, values in signals.extra.items()},
        notes=(*signals.notes, note),
        raw=signals,
    )


def split(signals: Sequence[Signals]) -> tuple[list[Signals], list[Signals], list[str]]:
    """Hold out the last third of each recording's motion.

    Returns
    -------
    train, test, notes
    """
    train, test, notes = [], [], []
    for s in signals:
        n = len(s.time)
        cut = int(
            np.clip(
                np.searchsorted(_way(s), 2 / 3),
                min(MIN_SAMPLES, n // 2),
                n - min(MIN_SAMPLES, n // 3),
            )
        )
        from_time = f"{s.time[cut] - s.time[0]:.3g} s"
        notes.append(
            f"{s.name}: no other recording given to judge on; held out from {from_time} on, the"
            " last third of its motion"
        )
        train.append(s.part(0, cut, f"{s.name} (first part)"))
        test.append(s.part(cut, len(s.time), f"{s.name} (last part)"))
    return train, test, notes


def halves(held: Sequence[Signals]) -> tuple[list[Signals], list[Signals], list[str]]:
    """Recordings to choose by and recordings to test on: whole ones where there are several, else
    the halves of the one.

    Returns
    -------
    choose, test, notes
    """
    if len(held) > 1:
        middle = len(held) // 2
        return list(held[:middle]), list(held[middle:]), []
    (s,) = held
    n = len(s.time)
    if n < 2 * MIN_SAMPLES:
        note = (
            f"{s.name}: too short to be divided: what was chosen by it is tested on it too, so the"
            " tested figures flatter"
        )
        return [s], [s], [note]
    way = _way(s)
    cut = int(np.clip(np.searchsorted(way, 0.5), MIN_SAMPLES, n - MIN_SAMPLES))
    return (
        [s.part(0, cut, f"{s.name} (to choose by)")],
        [s.part(cut, n, f"{s.name} (to test on)")],
        [],
    )


def _way(s: Signals) -> Array:
    """Share of the way that is behind at each row, (n,), the mean over the joints; what a sensor
    trembles is averaged out.
    """
    block = max(1, round(0.02 / s.sample_time))
    means = uniform_filter1d(s.position, block, axis=0, mode="nearest")[::block]
    way = np.cumsum(np.abs(np.diff(means, axis=0, prepend=means[:1])), axis=0)
    way = way[:, way[-1] > 0]
    share = np.mean(way / way[-1], axis=1) if way.shape[1] else np.linspace(0.0, 1.0, len(means))
    out: Array = np.interp(np.arange(len(s.time)), np.arange(len(means)) * block, share)
    return out
