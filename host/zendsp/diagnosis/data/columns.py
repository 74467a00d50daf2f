"""The columns of a recording, found by the names in a model."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.physics.model import CALLED, TREES, Model
from zendsp.recording import Recording, Table
from zendsp.recording.names import split_unit, units_in
from zendsp.recording.units import dimension, not_known, to_si
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]
Getter = Callable[[str], Array]  # from a column's name to its numbers in SI
Columns = Mapping[str, str | list[str]]  # a model's [columns]: a name, or a list of them, by role


IN_MEMORY = "recording"  # name of a recording that is no file
LARGEST = 1e100  # of a value: its square is still finite


def no_number(values: Array) -> npt.NDArray[np.bool_]:
    """The mask of values that are NaN, infinite, or too large to compute with."""
    return ~(np.abs(values) < LARGEST)


def optional(name: str, role: str, get: Getter, spec: Any, n: int, joints: int) -> Array:
    """An optional column, (n, joints), from one column for all joints or one for each."""
    parts = [
        np.asarray(get(str(item)), float) for item in (spec if isinstance(spec, list) else [spec])
    ]
    values = np.concatenate([part[:, None] if part.ndim == 1 else part for part in parts], axis=1)
    if values.shape[1] not in (1, joints) or len(values) != n:
        raise RecordingError(
            f"{name}: {role} {spec!r} has shape {values.shape}; expected {n} rows and 1 or {joints}"
            " columns"
        )
    refuse_no_number(name, f"{role} {spec!r}", column_name(spec, 0), values)
    return np.array(np.broadcast_to(values, (n, joints)))


def cutting(name: str, *options: str) -> str:
    """The command that cuts the recording of this name, in quotes."""
    file = "RECORDING" if name == IN_MEMORY else name  # to be saved first
    return f"'{shlex.join(['zendsp', 'cut', file, *options])}'"


def refuse_no_number(name: str, what: str, column: str, values: Array) -> None:
    """Refuse columns with values that are no numbers, with the place and what to do."""
    bad = no_number(values)
    if not bad.any():
        return
    row, k = (int(i[0]) for i in np.nonzero(bad))
    count = int(bad.sum())
    words = "values that are not finite numbers" if count > 1 else "value that is no finite number"
    what_to_do = (
        f"Leave the rows out ({cutting(name, '--finite', column, '-o', 'cut.csv')}): a short gap is"
        " bridged"
    )
    if bad.any(axis=1).all():  # no row would be left
        what_to_do = "No row is left without: is it the right column of the model's [columns]?"
    raise RecordingError(
        f"{name}: {what} has {count} {words} below {LARGEST:g} (first in row {row + 1}:"
        f" {values[row, k]:g}). {what_to_do}"
    )


# the unit of each role of a column, for a joint that turns and one that slides
ANGLE, SPEED, FORCE = ("rad", "m"), ("rad/s", "m/s"), ("N m", "N")
MEASURED_IN = {
    "time": ("s", "s"), "position": ANGLE, "reference": ANGLE, "position_load": ANGLE,
    "velocity": SPEED, "torque_measured": FORCE,
}  # fmt: skip


def check_units(name: str, source: Recording | Table, columns: Columns, model: Model) -> None:
    """Refuse a column of the model whose unit is unknown, or of another kind than the model's.

    A command may be in any unit, unless the model names one. So may positions that the model's
    matrix converts.
    """
    told = bool(model.joint_kinds) or model.kind not in (*CALLED, *TREES)
    for role, spec in columns.items():
        own = (model.actuator.unit,) * 2 if role == "command" else MEASURED_IN.get(role, ())
        if role == "position" and model.sensor.matrix:
            own = ()
        each = [(c, unit) for c in names_of(spec) for unit in units_in(source.units, c)]
        for k, (column, unit) in enumerate(each):
            bare, kind = split_unit(column)[0], dimension(unit) if unit else None
            mixed = role == "position" and bool(model.sensor.matrix)
            if unit and kind is None and role != "command" and not mixed:
                raise RecordingError(
                    f"{name}: {role} {bare!r}: {not_known(unit)}. Write one of them in the head of"
                    f" the column ('{bare} [deg]', for example), or no brackets for SI units"
                    f"{_by_matrix(role, unit)}"
                )
            slides = model.joint_kind(k + 1 if len(each) == model.joints else 1) == "linear"
            wanted = list(own[slides : slides + 1] if told else own)
            wanted = [u for u in wanted if dimension(u) is not None]
            if kind is None or not wanted or kind in [dimension(u) for u in wanted]:
                continue
            other = f"the column in [columns], or the model: a {role} is in {' or '.join(wanted)}"
            if role == "command":
                other = (
                    f"the model, whose [actuator] unit is {wanted[0]}: its unit, and its gain"
                    f" (torque per {unit})"
                )
            raise RecordingError(
                f"{name}: {role} {bare!r} is in {unit}: correct the unit in the head of the column,"
                f" or {other}{_by_matrix(role, unit)}"
            )


def _by_matrix(role: str, unit: str) -> str:
    """The advice for a model file where a position stays in its own unit."""
    if role != "position":
        return ""
    return f"; or leave it, and write into the model: [sensor] matrix = [[rad (m) per {unit}]]"


def getter(source: Recording | Table) -> tuple[str, Getter, tuple[str, ...]]:
    """The recording's name, a function from a column's name to its numbers in SI, and notes on the
    conversion.
    """
    if isinstance(source, Recording):
        names = set(source.names)

        def from_recording(column: str) -> Array:
            if column in ("t", "time", source.extra.get("time_column")) and column not in names:
                return np.asarray(source.t, float)
            try:
                known = [to_si(unit) for unit in units_in(source.units, column)]
                factors = np.array([one[0] if one else 1.0 for one in known])
                values: Array = np.asarray(source[column], float) * factors
                return values
            except (KeyError, RecordingError):
                raise RecordingError(
                    f"the recording has no channel {column!r}; it has {', '.join(source.names)}"
                ) from None

        return IN_MEMORY, from_recording, ()
    return str(source.path), lambda column: source[column], source.notes


def without_repeats(get: Getter, columns: Columns) -> tuple[Getter, int]:
    """A getter without rows that repeat time and positions of the row before, and their number."""
    if "time" not in columns or not has(get, columns["time"]):
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


def has(get: Getter, column: Any) -> bool:
    """Whether a recording has a column, or each of a list of columns."""
    try:
        for item in column if isinstance(column, list) else [column]:
            get(item)
    except RecordingError:
        return False
    return True


def names_of(spec: Any) -> list[str]:
    """The names of a column specification."""
    return [str(item) for item in spec] if isinstance(spec, list) else [str(spec)]


def column_name(spec: Any, index: int) -> str:
    """The name of one joint's column; ``index`` from 0."""
    return str(spec[index]) if isinstance(spec, list) else str(spec)


def matrix(name: str, label: str, get: Getter, spec: Any, joints: int) -> Array:
    """The raw values of a column specification, (rows, joints); ``label`` names their role in
    errors.

    Raises
    ------
    RecordingError
        A column is missing or has not one number per row, or the columns do not match the joints.
    """
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
        more = (
            ". Several joints that act on one another are a model of kind planar2r (two), urdf or"
            f" mjcf (any number); one joint alone is named by its column: {label} ="
            f' "{names_of(spec)[0].partition("[")[0]}[0]"'
        )
        raise RecordingError(
            f"{name}: {label} {spec!r} has {counted(values.shape[1], 'column')}; the model has"
            f" {counted(joints, 'joint')}{more if values.shape[1] > joints else ''}"
        )
    return values
