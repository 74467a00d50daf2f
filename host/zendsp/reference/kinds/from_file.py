"""A reference from a table of any kind that recordings are read from, with columns q (or q1, q2, …)
and optionally a time, qd, qdd, tau.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError, ReferenceError_
from zendsp.recording.names import listing
from zendsp.recording.roles import Role, role_of
from zendsp.recording.table import read_raw, read_table
from zendsp.reference.core import Array, Reference
from zendsp.reference.files import is_reference, load_reference
from zendsp.reference.fits import check_fits
from zendsp.reference.kind import Kind, Parameter
from zendsp.reference.machine import Machine

_COLUMN = re.compile(r"^(q|qd|qdd|tau)(?:_?(\d+)|\[(\d+)\])?$")  # q, q1 or q_1, q[0]
UNITS = {
    "q": ("rad", "m"),
    "qd": ("rad/s", "m/s"),
    "qdd": ("rad/s^2", "m/s^2"),
    "tau": ("N m", "N"),
}


def _resample(t: Array, columns: dict[str, Array], dt: float) -> dict[str, Array]:
    """Columns on the grid of the machine: cubic where the table is smooth, untouched where the grid
    is the same.
    """
    if np.any(np.diff(t) <= 0.0):
        row = int(np.argmax(np.diff(t) <= 0.0)) + 1
        raise ReferenceError_(
            f"time does not increase at row {row}: {t[row - 1]:g} s, then {t[row]:g} s; sort the"
            " table"
        )
    grid = np.arange(int(np.floor((t[-1] - t[0]) / dt + 1e-6)) + 1) * dt + t[0]
    if len(grid) == len(t) and np.allclose(grid, t, rtol=0.0, atol=1e-6 * dt):
        return columns
    from scipy.interpolate import CubicSpline

    made = {}
    for name, x in columns.items():
        if name == "q":
            spline = CubicSpline(t, x)
            made["q"], made["qd"], made["qdd"] = spline(grid), spline(grid, 1), spline(grid, 2)
        elif name == "tau":
            # a torque is held until its next sample
            made["tau"] = x[
                np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, len(t) - 1)
            ]
    return made


def make_from_file(machine: Machine, *, path: str, sample_time: float | None = None) -> Reference:
    """Read a reference file of zendsp, or any table with position columns, onto the machine's
    sample time.

    Parameters
    ----------
    machine : Machine
        Gives the number of joints and the sample time.
    path : str
        Any file that `zendsp.recording.read_table` reads; see docs/references.md for the
        columns.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        As it was saved, or kind "from_file".

    Raises
    ------
    ReferenceError_
        No such file, no position in it, another unit than rad or m, wrong number of joints.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from zendsp.reference import load_machine
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "way.csv"
    >>> _ = file.write_text("t;q [deg]\\n0;0\\n0,001;0,5\\n0,002;1\\n")
    >>> make_from_file(load_machine("pendulum"), path=str(file)).q.ravel().round(4).tolist()
    [0.0, 0.0087, 0.0175]
    """
    dt = sample_time or machine.sample_time
    file = Path(path)
    if is_reference(file):
        saved = load_reference(file)
        check_fits(saved, machine.name, machine.units)
        if abs(saved.sample_time - dt) < 1e-9:
            return replace(saved, machine=machine.name)
        t: Array | None = saved.t
        arrays = {"q": saved.q, "qd": saved.qd, "qdd": saved.qdd}
        if saved.tau is not None:
            arrays["tau"] = saved.tau
    else:
        t, arrays = _read(file)
    if arrays["q"].shape[1] != machine.joints:
        raise ReferenceError_(
            f"{path}: {arrays['q'].shape[1]} position column(s), {machine.name} has"
            f" {machine.joints} joint(s)"
        )
    if t is not None:
        arrays = _resample(t, arrays, dt)
    return Reference(
        arrays["q"], dt, arrays.get("qd"), arrays.get("qdd"), arrays.get("tau"),  # type: ignore[arg-type]
        kind="from_file", parameters={"path": str(path)}, machine=machine.name,
    )  # fmt: skip


def _read(file: Path) -> tuple[Array | None, dict[str, Array]]:
    """Time (None where the table has none) and the columns of a table, one array a quantity."""
    try:
        names = list(read_raw(file).columns)
        clocks = [n for n in names if role_of(n, "") is Role.TIME]
        clock = "t" if "t" in clocks else next(iter(clocks), None)
        found: dict[str, dict[int, str]] = {}
        for name in names:
            match = _COLUMN.match(name)
            if match:
                number = int(match[2]) if match[2] else int(match[3] or 0) + 1
                found.setdefault(match[1], {})[number] = name
        if "q" not in found:
            raise ReferenceError_(f"{file}: no column q (or q1, q2, …); found {listing(names)}")
        wanted = [name for columns in found.values() for name in columns.values()]
        table = read_table(file, [*wanted, *([clock] if clock else [])])
    except RecordingError as error:
        raise ReferenceError_(str(error)) from error
    arrays = {}
    for quantity, columns in found.items():
        if sorted(columns) != list(range(1, len(columns) + 1)):
            raise ReferenceError_(
                f"{file}: {listing(list(columns.values()))} are not numbered 1 to {len(columns)}"
            )
        arrays[quantity] = np.column_stack([table[columns[k]] for k in sorted(columns)])
    for name, values in table.columns.items():
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=tuple(range(1, values.ndim)))))
            raise ReferenceError_(
                f"{file}: column {name} is no finite number in row {row}: mend the file"
            )
        expected = ("s",) if name == clock else UNITS[_COLUMN.match(name)[1]]  # type: ignore[index]
        for unit in table.units.get(name, "").split(", "):
            if unit and unit.replace("²", "^2").replace("Nm", "N m") not in expected:
                raise ReferenceError_(
                    f"{file}: column {name} is in {unit}; a reference has it in"
                    f" {' or '.join(expected)}"
                )
    return None if clock is None else np.ravel(table[clock]), arrays


KIND = Kind(
    "from_file",
    "From a file",
    "A table with columns t, q1, q2, … (CSV, MAT and others), resampled to the machine.",
    (Parameter("path", "path", "", "", "The file."),),
    make_from_file,
)
