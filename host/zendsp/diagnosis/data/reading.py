"""Reads recordings as signals in joint coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.columns import (
    Columns,
    Getter,
    check_units,
    column_name,
    getter,
    has,
    matrix,
    names_of,
    no_number,
    optional,
    refuse_no_number,
    without_repeats,
)
from zendsp.diagnosis.data.jumps import counter_range, without_spikes
from zendsp.diagnosis.data.sampling import (
    between_rows,
    between_stamps,
    by_motion,
    clock,
    decimated,
    left_by_lines,
    on_counts,
    read_anew,
    resample,
    resample_held,
    resolution_of,
    turned_on,
)
from zendsp.diagnosis.data.sensors import SENSED, judged, read_sensed
from zendsp.diagnosis.data.signals import MIN_SAMPLES, Signals
from zendsp.errors import RecordingError
from zendsp.physics.effects import library
from zendsp.physics.kernel.signals import measure, noise_beside_quantisation, smooth
from zendsp.physics.model import TREES, Model, per_joint
from zendsp.physics.robots.robot import robot_path
from zendsp.recording import Recording, Table, read_table
from zendsp.recording.names import units_in
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]
Source = str | Path | Recording | Table
Told = Callable[[str | Path, float], None]


def read_signals(source: Source, model: Model, tell: Told | None = None) -> Signals:
    """The signals of a recording, read by the column names of a model. ``tell`` takes the file and
    the share of it that is read, where that takes a while.

    Raises
    ------
    RecordingError
        With the file, the column and what was expected.
    """
    columns = {"time": "t", **(model.columns or {"position": "q", "command": "u"})}
    if "position" not in columns:
        raise RecordingError(
            "the model's [columns] lacks 'position': which column holds the position?"
            + (" A velocity alone is not diagnosed" if "velocity" in columns else "")
        )
    if isinstance(source, str | Path):
        source = read_table(source, progress=None if tell is None else partial(tell, source))
    name, get, done = getter(source)
    if model.kind in TREES:
        robot_path(model)  # without that file the number of joints is unknown
    joints = model.joints
    check_units(name, source, columns, model)
    get, repeated = without_repeats(get, columns)
    position, command, reference = _main_columns(name, get, columns, joints)
    of = clock(name, get, columns, model, len(position))
    notes: list[str] = []
    extra, said = _further_columns(name, get, columns, position.shape)
    notes += [*said, *_each_alone(model, joints)]
    if "command" not in columns:
        notes.append(f"{name}: [columns] names no command: the motion is taken as driven by none")
    if repeated:
        notes.append(f"{name}: {repeated} rows repeat the row before, its time included; left out")
    turns = np.array([model.joint_kind(j + 1) == "rotary" for j in range(joints)])
    position, reference, on = turned_on(position, reference, turns)
    for column in (column_name(columns["position"], j) for j in on):
        notes.append(f"{name}: {column!r} begins anew at a full turn; the turns are put together")
    resolution = np.array(
        [resolution_of(name, columns, j, position, command, model, notes) for j in range(joints)]
    )
    position, reference, said = _mended(name, columns, position, reference, resolution)
    notes += said
    position, held = read_anew(position, resolution)
    if held:
        notes.append(
            f"{name}: {counted(held, 'position')} repeated in the midst of a motion, as where the"
            " sensor was not read; the curve through the neighbours stands there"
        )
    rows = position
    of = by_motion(of, name, position)
    time, sample_time, grid = of.time, of.period, of.grid
    if grid is not None:
        position = on_counts(resample(grid, time, position), position[0], resolution)
        command = resample_held(grid, time, command)
        reference = None if reference is None else resample(grid, time, reference)
        extra = {role: resample(grid, time, values) for role, values in extra.items()}
        stamps, time = time, grid
    read = Signals(
        name, time, sample_time, position, command, reference, resolution, extra=extra,
        origin=float(time[0]), unit_stated=_unit_stated(source, columns, model),
    )  # fmt: skip
    signals, said = _of_joints(read, model)
    signals = replace(signals, notes=(*done, *of.notes, *notes, *said))
    signals = decimated(between_rows(signals, model.actuator.hold or sample_time))
    if grid is None or signals.raw is not None:  # neighbouring means share no row
        return signals
    if model.sensor.matrix:
        rows = rows @ np.array(model.sensor.matrix).T
    return _as_noisy_as_read(signals, rows, stamps)


def _unit_stated(source: Recording | Table, columns: Columns, model: Model) -> bool:
    """Whether the heads of all positions state their unit, and no matrix makes another of it."""
    heads = [unit for c in names_of(columns["position"]) for unit in units_in(source.units, c)]
    return all(heads) and not model.sensor.matrix


def _mended(
    name: str, columns: Columns, position: Array, reference: Array | None, resolution: Array
) -> tuple[Array, Array | None, list[str]]:
    """Positions and references, (n, joints), without rows that stand out and with the ranges of a
    counter put together; and notes.
    """
    position, notes = position.copy(), []
    reference = None if reference is None else reference.copy()
    for j, count in enumerate(resolution.tolist()):
        column = f"{name}: {column_name(columns['position'], j)!r}"
        mended, rows = without_spikes(position[:, j], count)
        if rows:
            most = float(np.max(np.abs(mended - position[:, j])))
            notes.append(
                f"{column} is off for {counted(len(rows), 'single row')}, by up to {most:.3g}"
                f" (first in row {rows[0] + 1}): the line between the neighbours stands there"
            )
            position[:, j] = mended
        if anew := counter_range(position[:, j], count):
            read = position[:, j].copy()
            position[:, j] = np.unwrap(read, period=anew)
            if reference is not None:
                reference[:, j] = np.unwrap(reference[:, j], period=anew)
                reference[:, j] += anew * np.round((read - reference[:, j])[0] / anew)
            notes.append(f"{column} begins anew after a range of {anew:.7g}; they are put together")
    return position, reference, notes


def _as_noisy_as_read(s: Signals, rows: Array, stamps: Array) -> Signals:
    """A recording with at least the sensor noise of its ``rows`` (n, joints) before interpolation,
    which reduced the variance seen at high frequencies but not at those of the motion. Where the
    rows themselves show less noise, theirs is used (in fast motion the interpolated ones show
    jitter too), plus the rounding of values between two rows where the joint moves by half a count.
    """
    steps, left = s.resolution, left_by_lines(s.time, stamps)

    def variance(position: Array) -> Array:
        both = zip(position.T, steps, strict=True)
        return np.array([noise_beside_quantisation(y, float(step)) ** 2 for y, step in both])

    before, after = variance(rows), variance(s.position) / left
    moves = np.abs(np.diff(s.position, axis=0)) >= 0.5 * steps
    between = between_stamps(s.time, stamps)[1:, np.newaxis]
    rounded = before + np.mean(moves & between, axis=0) * steps**2 / 12
    least = np.sqrt(np.maximum(after, np.where(before <= after, rounded, 0.0)))
    return replace(s, least_noise=least if s.least_noise is None else np.fmax(s.least_noise, least))


def _each_alone(model: Model, joints: int) -> list[str]:
    """The notes on a model of several joints without links between them."""
    if joints < 2 or model.kind not in ("rotary", "linear"):
        return []
    return [
        f"a model of kind {model.kind} takes each joint by itself: what the links of an arm do to"
        " one another is in it only with kind planar2r, urdf or mjcf"
    ]


def _main_columns(
    name: str, get: Getter, columns: Columns, joints: int
) -> tuple[Array, Array, Array | None]:
    """Position, command (0 where there is none) and reference, (n, joints), of finite numbers."""
    position = matrix(name, "position", get, columns["position"], joints)
    n = len(position)
    if "command" in columns:
        command = matrix(name, "command", _or_zero(get, n), columns["command"], joints)
    else:
        command = np.zeros_like(position)
    for label, values in (("position", position), ("command", command)):
        if len(values) != n:
            raise RecordingError(f"{name}: {label} has {len(values)} rows, position {n}")
        bad = no_number(values)
        if bad.any():
            column = column_name(columns[label], int(np.nonzero(bad)[1][0]))
            refuse_no_number(name, f"{label} {column!r}", column, values)
    if n < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: has {counted(n, 'row')}; a diagnosis needs at least {MIN_SAMPLES} samples"
        )
    reference = (
        matrix(name, "reference", get, columns["reference"], joints)
        if "reference" in columns and has(get, columns["reference"])
        else None
    )
    return position, command, reference


def _or_zero(get: Getter, n: int) -> Getter:
    """A getter of n rows that gives zeros for the empty name: of a joint that nothing drives."""
    return lambda column: get(column) if column else np.zeros(n)


def _further_columns(
    name: str, get: Getter, columns: Columns, shape: tuple[int, ...]
) -> tuple[dict[str, Array], list[str]]:
    """The columns of effects and further sensors by role, (n, joints) each; and notes on missing
    ones.
    """
    n, joints = shape
    wanted = {
        role
        for effect in library().values()
        for role in effect.reads
        if role in columns and has(get, columns[role])
    }
    extra = {role: optional(name, role, get, columns[role], n, joints) for role in sorted(wanted)}
    notes = []
    for role in SENSED:
        if role in columns:
            if has(get, [item for item in names_of(columns[role]) if item]):
                extra[role] = read_sensed(name, role, get, columns[role], (n, joints))
            else:
                notes.append(f"{name}: {role} was not used: no column {columns[role]!r}")
    return extra, notes


def _of_joints(read: Signals, model: Model) -> tuple[Signals, list[str]]:
    """Sensor and actuator columns as positions and torques of joints; and notes."""
    name, sample_time, joints = read.name, read.sample_time, model.joints
    position, command, reference = read.position, read.command, read.reference
    resolution, extra = read.resolution, dict(read.extra)
    notes: list[str] = []
    if model.sensor.matrix:
        mixed = np.array(model.sensor.matrix)
        position = position @ mixed.T
        reference = None if reference is None else reference @ mixed.T
        resolution = np.sqrt((mixed**2) @ resolution**2)
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
    # low-frequency rounding errors stay although a filter removed the lattice
    stated = [per_joint(model.sensor.resolution, j + 1, 0.0) for j in range(joints)]
    of_joints = replace(
        read,
        least_noise=np.where(resolution > 0, 0.0, np.maximum(stated, 0.0) / np.sqrt(12)),
        position=position,
        command=command,
        reference=reference,
        resolution=resolution,
        extra=extra,
    )
    return of_joints, notes


def _through_servos(
    name: str, command: Array, position: Array, resolution: Array, sample_time: float, model: Model
) -> tuple[Array, list[str]]:
    """The torques of servos along the measured motion, from their commands, and a note."""
    out, joints = command.copy(), []
    for j, drive in enumerate(model.robot.servos):
        if drive is None:
            continue
        y = np.ascontiguousarray(position[:, j])
        step = float(resolution[j])
        measured = measure(y, sample_time, step, noise_beside_quantisation(y, step))
        q, qd, _ = smooth(measured, sample_time).states
        out[:, j] = drive.applied(command[:, j], q, qd, sample_time)
        joints.append(str(j + 1))
    return out, [
        f"{name}: joint {', '.join(joints)}: the command is the set value of a servo; taken as the"
        f" torque that the servo of {Path(model.file).name} gives along the measured motion"
    ]
