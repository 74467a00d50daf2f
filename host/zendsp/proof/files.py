"""Writes recordings and model files of the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zendsp.extras import need
from zendsp.proof.draft import Array
from zendsp.proof.model_table import Columns, ModelTable
from zendsp.proof.reality import Run

FORMATS = ("csv", "npz", "mat", "parquet", "h5")
NAMES = (
    {"time": "t", "position": "q", "command": "u", "reference": "q_ref"},
    {"time": "time", "position": "pos", "command": "cmd", "reference": "ref"},
    {"time": "Time", "position": "theta", "command": "tau_cmd", "reference": "theta_d"},
)


def columns_of(names: dict[str, str], joints: int, split: bool) -> Columns:
    """The ``[columns]`` table: one name, or one a joint where vectors are split."""
    if joints == 1 or not split:
        return dict(names)
    return {
        k: v if k == "time" else [f"{v}{i + 1}" for i in range(joints)] for k, v in names.items()
    }


def recording(run: Run, columns: Columns) -> dict[str, Array]:
    """Column name -> array, of what a laboratory would have."""
    data = {"position": run.measured, "command": run.command, "reference": run.reference}
    out: dict[str, Array] = {str(columns["time"]): run.time}
    for key, value in data.items():
        if key not in columns:
            continue
        name = columns[key]
        if isinstance(name, list):
            out.update({n: value[:, i] for i, n in enumerate(name)})
        else:
            out[name] = value[:, 0] if value.shape[1] == 1 else value
    return out


def write_recording(path: Path, table: dict[str, Array]) -> None:
    """Write `table` in the format that the suffix names; ``.mat`` is v5 here, see
    :func:`write_hdf`.
    """
    if path.suffix == ".npz":
        np.savez_compressed(path, **table)  # type: ignore[arg-type]
    elif path.suffix == ".mat":
        from scipy.io import savemat

        savemat(path, table, do_compression=True, oned_as="column")
        with path.open(
            "r+b"
        ) as raw:  # the header carries the hour of writing; the same seed shall give the same bytes
            raw.write(b"MATLAB 5.0 MAT-file, zendsp.proof".ljust(116))
    elif path.suffix == ".parquet":
        pa = need("pyarrow", "parquet", "a Parquet file")
        pq = need("pyarrow.parquet", "parquet", "a Parquet file")

        pq.write_table(pa.table({k: pa.array(v) for k, v in table.items()}), path)
    else:
        head = ",".join(table)
        values = np.stack(list(table.values()), 1)
        # a clock that counts from 1970 needs its sixteen digits; the first column is the time
        np.savetxt(
            path,
            values,
            fmt=["%.16g"] + ["%.10g"] * (values.shape[1] - 1),
            delimiter=",",
            header=head,
            comments="",
        )


def write_hdf(path: Path, table: dict[str, Array]) -> None:
    """MAT v7.3: HDF5 with MATLAB's transposed arrays and its header block of 512 bytes."""
    h5py = need("h5py", "hdf5", "a MAT file of version 7.3")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in table.items():
            array = np.asarray(value, float)
            data = file.create_dataset(name, data=np.atleast_2d(array.T))
            data.attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(head)


def save(folder: Path, stem: str, form: str, run: Run, columns: Columns) -> Path:
    """Write one run under `folder`; returns the path."""
    table = recording(run, columns)
    path = folder / f"{stem}.{'mat' if form == 'h5' else form}"
    if form == "h5":
        write_hdf(path, table)
    else:
        write_recording(path, table)
    return path


def scalar(value: Any) -> str:
    """One TOML value."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value) if "e" in repr(value) or "." in repr(value) else f"{value!r}.0"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list):
        return "[" + ", ".join(scalar(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {scalar(v)}" for k, v in value.items()) + " }"
    return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'


def toml(table: ModelTable) -> str:
    """The given model as TOML text: tables one level deep, parameters as inline tables."""
    lines = [
        f"{k} = {scalar(plain(v))}" for k, v in table.items() if not isinstance(v, dict | list)
    ]
    for key, value in table.items():
        if isinstance(value, dict):
            inner = {k: v for k, v in value.items() if k != "parameters"}
            lines += ["", f"[{key}]"] + [f"{k} = {scalar(plain(v))}" for k, v in inner.items()]
            if "parameters" in value:
                lines += ["", f"[{key}.parameters]"]
                lines += [f"{k} = {scalar(plain(v))}" for k, v in value["parameters"].items()]
        elif isinstance(value, list):
            for item in value:
                lines += ["", f"[[{key}]]"] + [f"{k} = {scalar(plain(v))}" for k, v in item.items()]
    return "\n".join(lines) + "\n"


def plain(value: Any) -> Any:
    """NumPy numbers as Python's, floats with twelve digits."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, bool | str | int):
        return value
    return float(f"{float(value):.12g}")


def format_for(rng: np.random.Generator) -> tuple[str, bool]:
    """A file format and whether vectors are split into columns (tables of columns must be)."""
    form = str(rng.choice(FORMATS))
    return form, form in ("csv", "parquet") or bool(rng.random() < 0.5)
