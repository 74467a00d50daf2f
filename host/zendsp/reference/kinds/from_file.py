"""A reference from a table: MAT, CSV, NPZ, with columns q (or q1, q2, …) and optionally t, qd, qdd,
tau.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference
from zendsp.reference.files import FORMAT, load_reference, read_columns
from zendsp.reference.kind import Kind, Parameter
from zendsp.reference.machine import Machine


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
        ``.mat``, ``.csv`` or ``.npz``; see docs/references.md for the columns.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        As it was saved, or kind "from_file".

    Raises
    ------
    ReferenceError_
        No such file, no position in it, wrong number of joints.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from zendsp.reference import load_machine
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "way.csv"
    >>> _ = file.write_text("t,q\\n0,0\\n0.001,0.1\\n0.002,0.2\\n")
    >>> make_from_file(load_machine("pendulum"), path=str(file)).q.ravel().tolist()
    [0.0, 0.1, 0.2]
    """
    dt = sample_time or machine.sample_time
    columns = read_columns(Path(path))
    if str(columns.pop("format", "")) == FORMAT:
        saved = load_reference(Path(path))
        if abs(saved.sample_time - dt) < 1e-9 and saved.joints == machine.joints:
            return saved
    arrays: dict[str, Array] = {
        k: np.asarray(columns[k], dtype=np.float64)
        for k in ("q", "qd", "qdd", "tau")
        if k in columns
    }
    if "q" not in arrays:
        raise ReferenceError_(
            f"{path}: no column q (or q1, q2, …); found {', '.join(sorted(columns)) or 'nothing'}"
        )
    if arrays["q"].shape[1] != machine.joints:
        raise ReferenceError_(
            f"{path}: {arrays['q'].shape[1]} position column(s), {machine.name} has"
            f" {machine.joints} joint(s)"
        )
    if "t" in columns:
        arrays = _resample(np.ravel(columns["t"]).astype(np.float64), arrays, dt)
    return Reference(
        arrays["q"], dt, arrays.get("qd"), arrays.get("qdd"), arrays.get("tau"),  # type: ignore[arg-type]
        kind="from_file", parameters={"path": str(path)}, machine=machine.name,
    )  # fmt: skip


KIND = Kind(
    "from_file",
    "From a file",
    "A table with columns t, q1, q2, … (CSV, MAT, NPZ), resampled to the machine.",
    (Parameter("path", "path", "", "", "The file."),),
    make_from_file,
)
