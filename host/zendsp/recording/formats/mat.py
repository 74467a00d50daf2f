"""MATLAB files: version 5 written through SciPy and read by ``mat5`` or SciPy, version 7.3 (HDF5)
read through h5py.

A recording is written as ``data``, a matrix with one column per signal, time first; ``names`` and
``units``, cell arrays with one entry per column; and ``zendsp``, the metadata as JSON text.
In foreign files, structures and cells are walked: the fields become names such as
``Theta1.signals.values`` and ``Y_id{1}``. Several signals of a Simulink scope are named by their
labels. What dSPACE's ControlDesk exports has columns by the names of its variables, and the column
``time``.
"""

from __future__ import annotations

import math
import posixpath
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.clocks import Series, on_one_clock
from zendsp.recording.formats.hdf5 import ELSEWHERE, leads_out
from zendsp.recording.formats.mat5 import read_plain
from zendsp.recording.formats.raw import COMPLEX, Raw, check_room, upright

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

KEY = "zendsp"
SHARED = 10  # times that a part of a file may be met, in the mean, and FEW more: MATLAB shares few
FEW = 1000
WIDE = ("double", "single", "int64", "uint64", "int32", "uint32")  # as columns 8 bytes a number
OWN = ("data", "names", "units", KEY)
OBJECT = ("s0", "s1", "s2", "arr")  # the fields of what SciPy returns for one
AN_OBJECT = "is an object of MATLAB"
OBJECTS = {  # how its numbers are had in MATLAB, by how the name of its class ends
    "timeseries": "t = {0}.Time; q = {0}.Data",
    "timetable": "by writetable(timetable2table({0}), 'run.csv')",
    "table": "by writetable({0}, 'run.csv')",
    "Dataset": "of each signal: q = {0}.get(1).Values.Data, with t = {0}.get(1).Values.Time",
}
CLOCK = re.compile(r"\.(time|t)$", re.IGNORECASE)  # of a structure: Simulink's and timeseries'
SERIES = "values"  # the field of Simulink's structures that holds a signal; others say how it looks


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording`` as MAT v5, which MATLAB and Octave both open."""
    import scipy.io

    names = ["t", *recording.columns]
    units = ["s", *recording.column_units]
    contents = {
        "data": np.column_stack([recording.t, recording.data]),
        "names": _cells(names),
        "units": _cells(units),
        # MAT v5 characters are UTF-16: text outside ASCII is escaped by JSON, so any reader gets it
        # whole.
        KEY: metadata,
    }
    scipy.io.savemat(str(path), contents, appendmat=False, format="5", do_compression=True)


def _cells(texts: list[str]) -> npt.NDArray[np.object_]:
    cells = np.empty((1, len(texts)), dtype=object)
    cells[0, :] = texts
    return cells


def read(path: Path) -> Raw:
    """Read a MAT file of version 5 or 7.3."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be opened ({error.strerror})") from error
    if head.startswith((b"\x89HDF", b"MATLAB 7.3")):
        contents = _read_hdf5(path)
    else:
        contents = _read_v5(path)
    if all(name in contents for name in OWN):
        return _own(path, contents)
    found = Raw({})
    for name, value in contents.items():
        _walk(name, value, found)
    if series := _series(found):
        found = on_one_clock(path, series, found.refused, prefix=False)
    left_out = tuple(
        f"{name}: left out: it {why}"
        for name, why in found.refused.items()
        if why.startswith(AN_OBJECT) or why == COMPLEX
    )
    return replace(found, notes=found.notes + left_out)


def _series(found: Raw) -> list[Series]:
    """The structures that have each a time of their own, where their rows differ in number: logs of
    several rates. Empty where a column is in none of them.
    """
    columns = {name: upright(values) for name, values in found.columns.items()}
    times = {name for name in columns if CLOCK.search(name) and columns[name].ndim == 1}
    if len({len(values) for values in columns.values()}) < 2 or len(times) < 2:
        return []
    clocks = {CLOCK.sub(".", name): Series(name, columns[name], {}) for name in sorted(times)}
    for name in columns.keys() - times:
        of = max((p for p in clocks if name.startswith(p)), key=len, default="")
        if not of or len(columns[name]) != len(clocks[of].t):
            return []
        parts = columns[name].reshape(len(columns[name]), -1).T
        names = [name] if len(parts) == 1 else [f"{name}[{k}]" for k in range(len(parts))]
        clocks[of].columns.update(zip(names, parts, strict=True))
    return list(clocks.values())


def _read_v5(path: Path) -> dict[str, Any]:
    plain = read_plain(path)
    if plain is not None:
        return dict(plain)
    import scipy.io

    try:
        sizes = [8 * math.prod(shape) for _, shape, kind in scipy.io.whosmat(path) if kind in WIDE]
        check_room(path, sum(sizes))
        contents = scipy.io.loadmat(path, squeeze_me=False, chars_as_strings=True)
    except RecordingError:
        raise
    # SciPy raises whatever its parser stumbles over (struct, zlib, Type, Value, Key, NotImplemented
    # …).
    except Exception as error:
        raise RecordingError(
            f"{path}: is not a readable MAT file, or it is cut short ({error})"
        ) from error
    return {name: value for name, value in contents.items() if not name.startswith("__")}


def _read_hdf5(path: Path) -> dict[str, Any]:
    h5py = need("h5py", "hdf5", "a MAT file of version 7.3", RecordingError)
    try:
        with h5py.File(path, "r") as file:
            sizes: list[int] = []
            file.visititems(lambda _, item: sizes.append(getattr(item, "nbytes", 0)))
            check_room(path, sum(sizes))
            return _Parts(h5py, file, SHARED * len(sizes) + FEW).of(file)
    except RecordingError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        raise RecordingError(
            f"{path}: is not a readable MAT 7.3 file, or it is cut short ({error})"
        ) from error


class _Parts:
    """Turns the HDF5 objects that MATLAB writes into what SciPy returns for version 5."""

    def __init__(self, h5py: Any, file: Any, most: int) -> None:
        self.h5py, self.file, self.left = h5py, file, most

    def of(self, group: Any) -> dict[str, Any]:
        """The parts of a structure; MATLAB keeps those of cells under names with a #."""
        found = {}
        for name in group:
            if leads_out(self.h5py, group, name):
                raise ValueError(f"{posixpath.join(group.name, name)} {ELSEWHERE}")
            if not name.startswith("#") and name in group:
                found[name] = self._value(group[name])
        return found

    def _value(self, item: Any) -> Any:
        self.left -= 1
        if self.left < 0:
            raise ValueError("it has cells that hold one another")
        if isinstance(item, self.h5py.Group):
            return self.of(item)
        kind = item.attrs.get("MATLAB_class", b"")
        if "MATLAB_object_decode" in item.attrs:  # what it holds stands elsewhere, undocumented
            words = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
            return _opaque(item.name.rpartition("/")[2], words)
        if item.attrs.get("MATLAB_empty", 0):
            return np.empty((0, 0))
        values = item[()]
        if isinstance(values, np.ndarray) and values.dtype == self.h5py.ref_dtype:
            cells = np.empty(values.T.shape, dtype=object)
            for index, reference in np.ndenumerate(values.T):
                cells[index] = self._value(self.file[reference])
            return cells
        if kind == b"char":
            return np.array(["".join(map(chr, np.asarray(values).T.reshape(-1, order="C")))])
        # MATLAB stores by columns and HDF5 by rows: every matrix arrives transposed.
        return np.atleast_2d(np.asarray(values)).T


def _walk(name: str, value: Any, found: Raw) -> None:
    """Collect numeric vectors, matrices and scalars from nested structures and cells."""
    if isinstance(value, Mapping):
        _structure(name, value, found)
    elif not isinstance(value, np.ndarray):
        found.refused[name] = f"holds {type(value).__name__}, not numbers"
    elif value.dtype.names == OBJECT:
        for record in value.reshape(-1):
            own, kind = ("".join(_texts(record[key])) for key in ("s0", "s2"))
            found.refused[own] = _which(own, kind)
    elif value.dtype.names:
        records = () if _labelled(name, value, found) else value.reshape(-1)
        for index, record in enumerate(records):
            place = name if value.size == 1 else f"{name}({index + 1})"
            if not _of_dspace(record, found):
                _structure(place, {key: record[key] for key in value.dtype.names}, found)
    elif value.dtype == object:
        for index, item in enumerate(value.reshape(-1, order="F")):
            _walk(f"{name}{{{index + 1}}}", item, found)
    else:
        found.sort(name, value)


def _opaque(name: str, kind: str) -> npt.NDArray[Any]:
    """An object of version 7.3 as SciPy returns those of version 5."""
    found = np.empty(1, dtype=[(key, object) for key in OBJECT])
    found[0] = name, "MCOS", kind, None
    return found


def _which(name: str, kind: str) -> str:
    """What to do with an object of MATLAB, whose numbers the file keeps in a form of its own."""
    way = next((words for end, words in OBJECTS.items() if kind.endswith(end)), "")
    save = way.format(name) if way else "as arrays"
    return f"{AN_OBJECT} ({kind}), which MATLAB alone reads: save its numbers, {save}"


def _labelled(name: str, value: npt.NDArray[Any], found: Raw) -> bool:
    """Whether it is several signals of a Simulink scope, each with a label of its own. They are
    taken by these names then.
    """
    if value.size < 2 or not {SERIES, "label"} <= set(value.dtype.names or ()):
        return False
    records = value.reshape(-1)
    labels = ["".join(_texts(record["label"])) for record in records]
    if not all(labels) or len(set(labels)) < len(labels):
        return False
    for label, record in zip(labels, records, strict=True):
        found.sort(f"{name.removesuffix('.signals')}.{label}", record[SERIES])
    return True


def _structure(place: str, fields: Mapping[str, Any], found: Raw) -> None:
    """The fields of a structure. Beside a signal of Simulink, what has not its rows describes it,
    as ``plotStyle`` does.
    """
    rows = max(np.shape(fields.get(SERIES, ())), default=0)
    for key, item in fields.items():
        if rows and np.size(item) > 1 and rows not in np.shape(item) and item.dtype.kind in "fiub":
            found.refused[f"{place}.{key}"] = f"describes {place}.{SERIES}"
        else:
            _walk(f"{place}.{key}", item, found)


def _of_dspace(record: Any, found: Raw) -> bool:
    """Whether a structure is what ControlDesk exports: ``X`` with the time, and in ``Y`` a variable
    each by Name, Data and Unit. Its columns are then found.
    """
    if not {"X", "Y"} <= set(record.dtype.names):
        return False
    x, y = (np.asarray(record[key]).reshape(-1) for key in "XY")
    fields = set(y.dtype.names or ())
    if "Data" not in (x.dtype.names or ()) or not {"Name", "Data"} <= fields:
        return False
    paths = ["".join(_texts(variable["Name"])).replace('"', "") for variable in y]
    names = [path.rpartition("/")[2] for path in paths]
    for path, name, variable in zip(paths, names, y, strict=True):
        column = name if names.count(name) == 1 else path
        found.sort(column, variable["Data"])
        found.units[column] = "".join(_texts(variable["Unit"])) if "Unit" in fields else ""
    for k, clock in enumerate(x, start=1):  # one for each raster
        column = "time" if len(x) == 1 else f"time{k}"
        found.sort(column, clock["Data"])
        found.units[column] = "s"
    return True


def _own(path: Path, contents: dict[str, Any]) -> Raw:
    names, units = (_texts(contents[key]) for key in ("names", "units"))
    data = np.asarray(contents["data"], dtype=np.float64)
    if data.ndim != 2 or not len(names) == len(units) == data.shape[1]:
        raise RecordingError(
            f"{path}: data has shape {data.shape}, names {len(names)} and units {len(units)}"
            " entries; they must agree"
        )
    columns = {name: np.ascontiguousarray(data[:, k]) for k, name in enumerate(names)}
    return Raw(columns, dict(zip(names, units, strict=True)), {}, "".join(_texts(contents[KEY])))


def _texts(cells: Any) -> list[str]:
    return [
        str(np.asarray(cell).reshape(-1)[0]) if np.size(cell) else ""
        for cell in np.asarray(cells).reshape(-1)
    ]
