"""Reference files: the MAT layout that Execute plays (docs/references.md)."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp.reference.machine import MACHINES, Machine, load_machine
from zendsp_protocol import written

FORMAT = "zendsp-reference-1"


def save_reference(
    reference: Reference, path: str | Path, machine: Machine | None = None, check: bool = True
) -> Path:
    """Check a reference against its machine and write it as MAT (v5, opens in MATLAB and Octave).

    Parameters
    ----------
    reference : Reference
        The motion.
    path : path
        ``.mat`` is added where missing.
    machine : Machine, optional
        Whose limits count; the reference's own where it names a shipped one.
    check : bool
        False writes it in spite of the limits (an experiment that means to leave them says so).

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ReferenceError_
        A limit is broken: which, by how much, when, by which joint; or the file cannot be written.
        What was there before stays.

    Examples
    --------
    >>> import tempfile, pathlib, numpy as np
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> save_reference(Reference(np.zeros(3), 0.001, machine="pendulum"), folder / "rest").name
    'rest.mat'
    """
    from scipy.io import savemat

    if machine is None and reference.machine in MACHINES:
        machine = load_machine(reference.machine)
    if check and machine is not None:
        machine.check(reference)
    target = Path(path).expanduser()
    if target.suffix != ".mat":
        target = target.with_name(target.name + ".mat")
    empty = np.zeros((0, 0))
    table = {
        "format": FORMAT,
        "kind": reference.kind,
        "machine": reference.machine,
        "mode": reference.mode,
        "unit": reference.unit,
        "cyclic": int(reference.cyclic),
        "sample_time": reference.sample_time,
        "t": reference.t[:, None],
        "q": reference.q,
        "qd": reference.qd,
        "qdd": reference.qdd,
        "tau": empty if reference.tau is None else reference.tau,
        "parameters": json.dumps(dict(reference.parameters)),
    }
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        savemat(part, table, appendmat=False, do_compression=True)
        os.replace(part, target)
    except OSError as error:
        # SciPy turns what the system said into words of its own, and keeps it as the cause
        cause = error.__context__ if isinstance(error.__context__, OSError) else error
        why = error.strerror or cause.strerror or error
        raise ReferenceError_(f"{target}: cannot be written ({why})") from error
    finally:
        with suppress(OSError):  # nothing is there where the folder is none
            part.unlink(missing_ok=True)
    return target


def load_reference(path: str | Path) -> Reference:
    """Read a reference that `save_reference` wrote.

    Parameters
    ----------
    path : path
        A ``.mat`` file.

    Returns
    -------
    Reference
        Equal to the one saved.

    Raises
    ------
    ReferenceError_
        No such file, not MAT, or not a reference.

    Examples
    --------
    >>> import tempfile, pathlib, numpy as np
    >>> file = save_reference(Reference(np.zeros(3), 0.001), pathlib.Path(tempfile.mkdtemp()) / "rest.mat")
    >>> load_reference(file).samples
    3
    """  # noqa: E501
    file = Path(path).expanduser()
    if file.is_file() and file.suffix.lower() != ".mat":
        raise ReferenceError_(
            f"{file}: a reference is a .mat file that 'zendsp reference' or Reference (F4) wrote; a"
            f" table is made one of by: zendsp reference from_file --path {file} -o motion.mat"
        )
    data = _read_mat(file)
    if str(data.get("format", "")) != FORMAT:
        raise ReferenceError_(
            f'{file}: not a reference file (format is "{data.get("format", "absent")}", expected'
            f' "{FORMAT}"); a plain table comes in as kind from_file'
        )
    try:
        tau = data["tau"]
        return Reference(
            data["q"], float(data["sample_time"]), data["qd"], data["qdd"],
            None if tau.size == 0 else tau, kind=str(data["kind"]),
            parameters=written.json(data["parameters"]), machine=str(data["machine"]),
            mode=data["mode"], cyclic=bool(data["cyclic"]), unit=str(data["unit"]),
        )
    except (KeyError, ValueError) as error:
        raise ReferenceError_(f"{file}: damaged reference file: {error}; plan it again") from error


def is_reference(path: Path) -> bool:
    """Whether a file is one that `save_reference` wrote, and no other table; its rows are not read.

    Examples
    --------
    >>> is_reference(Path("way.csv"))
    False
    """
    try:
        return path.suffix == ".mat" and _read_mat(path, ["format"]).get("format") == FORMAT
    except ReferenceError_:
        return False  # the reader of tables says what is wrong with it


def _read_mat(path: Path, names: list[str] | None = None) -> dict[str, Any]:
    """Variables of a MAT file: text as str, single numbers as float, the rest as arrays."""
    from scipy.io import loadmat

    if not path.is_file():
        raise ReferenceError_(f"{path}: no such file")
    try:
        found = loadmat(path, variable_names=names)
        return {k: _plain(v) for k, v in found.items() if not k.startswith("__")}
    except Exception as error:  # SciPy raises whatever its parser stumbles over
        raise ReferenceError_(f"{path}: cannot be read: {error}") from error


def _plain(value: Any) -> Any:
    array = np.asarray(value)
    if array.dtype.kind in "US":
        return "" if array.size == 0 else str(array.ravel()[0])
    return float(array.ravel()[0]) if array.size == 1 else array
