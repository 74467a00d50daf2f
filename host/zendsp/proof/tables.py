"""Reads recordings and models of the contract for the peers, apart from the code that is judged."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from zendsp.extras import need
from zendsp.proof.draft import Array
from zendsp.proof.model_table import Columns, ModelTable


@dataclass(frozen=True)
class Table:
    """One recording: all (rows, n)."""

    time: Array
    position: Array
    command: Array


def read_columns(path: Path) -> dict[str, Array]:
    """Every column of a CSV, NPZ, Parquet or MAT (v5, v7.3) file."""
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {k: np.asarray(file[k], float) for k in file.files}
    if path.suffix == ".parquet":
        pq = need("pyarrow.parquet", "parquet", "a Parquet file")
        return {k: np.asarray(v, float) for k, v in pq.read_table(path).to_pydict().items()}
    if path.suffix == ".csv":
        with path.open(encoding="utf-8") as file:
            head = file.readline().strip().split(",")
        return dict(zip(head, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    try:
        from scipy.io import loadmat

        return {k: np.asarray(v, float) for k, v in loadmat(path).items() if not k.startswith("_")}
    except NotImplementedError:  # what SciPy says of v7.3
        h5py = need("h5py", "hdf5", "a MAT file of version 7.3")
        with h5py.File(path) as file:
            return {k: np.asarray(file[k], float).T for k in file}


def read_recording(path: Path, columns: Columns) -> Table:
    """The signals that ``[columns]`` names."""
    raw = read_columns(path)
    time = raw[str(columns["time"])].ravel()

    def signal(key: str) -> Array:
        names = columns[key]
        if isinstance(names, list):
            return np.stack([raw[n].ravel() for n in names], 1)
        value = raw[names]
        rows = time.size
        return value.reshape(rows, -1) if value.shape[0] == rows else value.T.reshape(rows, -1)

    return Table(time, signal("position"), signal("command"))


def read_case(folder: Path) -> tuple[ModelTable, list[Table], list[Table]]:
    """(given model, training recordings, held-out recordings) of a case folder."""
    listing = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    text = (folder / listing["model"]).read_text(encoding="utf-8")
    model = cast(ModelTable, tomllib.loads(text))
    load = [
        [read_recording(folder / n, model["columns"]) for n in listing[k]]
        for k in ("train", "heldout")
    ]
    return model, load[0], load[1]
