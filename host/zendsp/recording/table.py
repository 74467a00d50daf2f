"""Plain tables of numbers, from files of any program."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats import Raw
from zendsp.recording.formats.raw import Share, upright
from zendsp.recording.names import (
    FloatArray,
    gather_vectors,
    listing,
    pick,
    qualified,
    split_heads,
    split_unit,
    told,
    units_in,
)
from zendsp.recording.own import checked
from zendsp.recording.units import in_si
from zendsp_protocol.texts import counted

READERS = {  # suffix: module of zendsp.recording.formats
    ".csv": "csv",
    ".tsv": "csv",
    ".txt": "csv",
    ".log": "csv",
    ".csv.gz": "csv",
    ".tsv.gz": "csv",
    ".mat": "mat",
    ".npz": "npz",
    ".parquet": "parquet",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".mcap": "mcap",
    ".db3": "ros",
    ".bag": "ros",
    ".mf4": "mdf",
    ".mdf": "mdf",
    ".tdms": "tdms",
}
BAG = "metadata.yaml"  # what makes a folder a bag of rosbag2
OF_RUN = "recording.mat"  # the recording in the folder of a run
SAID = 160  # characters of what another library said of a damaged file
FILES = 5  # of a folder, in a message
REPR = 80  # characters of names that a prompt shows
ROBOTS = (".urdf", ".xacro", ".xml", ".mjcf")
_PANDAS = 'python -c "import pandas, sys; pandas.'
_TO_CSV = '(sys.argv[1]).to_csv(sys.argv[2], index=False)" {path} {csv}'
CONVERSIONS = {  # suffixes of what is not read: the command that makes something of it that is
    ".xlsx": "libreoffice --headless --convert-to csv {path}",
    ".xls": "libreoffice --headless --convert-to csv {path}",
    ".ods": "libreoffice --headless --convert-to csv {path}",
    ".ulg": "pip install pyulog && ulog2csv {path}",
    ".blf": "pip install asammdf[gui] && asammdf  (Open, then Bus logging, then Save as .mf4)",
    ".feather": f"{_PANDAS}read_feather{_TO_CSV}",
    ".pkl": f"{_PANDAS}read_pickle{_TO_CSV}  (only where you trust its author: a pickle runs code)",
    ".json": f"{_PANDAS}read_json{_TO_CSV}",
    ".sldata": 'matlab -batch "load {path} -mat; save {mat} -v7.3"',
    ".zip": "unzip {path}",
    ".gz": "gunzip {path}",
    ".zst": "unzstd {path}",
}


class Frame(Protocol):
    """What pandas and polars have in common."""

    @property
    def columns(self) -> Any:
        """The names of the columns."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


Columns = Frame | Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length, read from a file.

    Attributes
    ----------
    columns : mapping of name to ndarray, shape (N,) or (N, m), float64
        Gaps in the file are NaN.
    units : mapping of name to str
        Empty where the file states none.
    constants : mapping of name to float
        Numbers that stand beside the columns (a MAT file's ``kp``, ``dt``, …).
    path : Path
        Where it came from.
    notes : tuple of str
        What was done to the numbers: units converted, clocks joined.
    """

    columns: Mapping[str, FloatArray]
    units: Mapping[str, str] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    path: Path = Path()
    notes: tuple[str, ...] = ()

    @classmethod
    def from_columns(cls, columns: Columns, name: str = "recording") -> Table:
        """A table made of arrays, in SI units, such as a pandas or polars DataFrame.

        Parameters
        ----------
        columns : DataFrame, or mapping of name to array, shape (N,) or (N, m)
            Names may state units, as the heads of a CSV do: ``"angle [deg]"``.
        name : str
            By which messages call it.

        Raises
        ------
        RecordingError
            No column of numbers, or columns of different lengths.

        Examples
        --------
        >>> table = Table.from_columns({"t [ms]": [0.0, 1.0], "q": [0.0, 2.0]})
        >>> table["t"], table.units["t"], table.notes
        (array([0.   , 0.001]), 's', ('t: ms converted to s',))
        """
        units = dict(getattr(columns, "attrs", {}).get("units", {}))  # as to_pandas has it
        if getattr(getattr(columns, "index", None), "name", None) is not None:
            columns = columns.reset_index()  # type: ignore[union-attr]
        heads = list(columns if isinstance(columns, Mapping) else columns.columns)
        raw = Raw({})
        for head, (bare, unit) in zip(heads, split_heads([str(h) for h in heads]), strict=True):
            values = np.asarray(columns[head])
            if values.dtype.kind in "mM":  # times, and times since another
                values, unit = (values - values[:1]) / np.timedelta64(1, "s"), "s"
            raw.sort(bare, values)
            raw.units[bare] = unit or units.get(head, "")
        return _checked(Path(name), raw, None)

    def __repr__(self) -> str:
        names = [f"{n} [{self.units[n]}]" if self.units.get(n) else n for n in self.columns]
        shown = ", ".join(names)
        if len(shown) > REPR:
            shown = f"{len(names)} columns: {', '.join(names[:3])}, …"
        rows = len(next(iter(self.columns.values()), ()))
        return f"<{f'Table {self.path.name}'.rstrip()}: {shown}; {counted(rows, 'row')}>"

    def __getitem__(self, name: str) -> FloatArray:
        """A column; ``"q[1]"`` is one column of a vector, ``"q1 [rad]"`` is ``"q1"``.

        Raises
        ------
        RecordingError
            No such column; the message names the file and lists the columns there are.
        """
        values = pick(self.columns, name)
        if values is None:
            values = pick(self.columns, split_unit(name)[0])
        if values is None:
            raise RecordingError(
                f"{self.path}: has no column {name!r}; it has {listing(told(self.columns))}"
            )
        return values

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (
            pick(self.columns, name) is not None
            or pick(self.columns, split_unit(name)[0]) is not None
        )

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def read_table(
    path: str | Path, columns: Sequence[str] | None = None, progress: Share | None = None
) -> Table:
    """Read a table of numbers in SI units from a file of any of the kinds below, zendsp's own or
    foreign.

    CSV and TSV, MAT (v5, v7.3), NPZ, Parquet, HDF5, MDF, TDMS, MCAP and bags of ROS. What is in
    degrees, milliseconds, rpm, mN m … by a header, a row of units, the file's own unit, or a name
    such as ``theta_deg`` is converted.

    Parameters
    ----------
    path : path
        Its suffix says what it is; a folder is a bag of rosbag2, or holds one recording.
    columns : sequence of str, optional
        Read and check these only; the others may then be of any length or kind.
    progress : callable, optional
        Takes the share that is read, from 0 to 1, of a CSV of more than 16 MB.

    Returns
    -------
    Table
        Vectors may come as columns ``q[0], q[1]`` or as one array; both become one ``(N, m)``
        column ``q``.

    Raises
    ------
    RecordingError
        Naming the file, the column, and what was expected: missing or damaged file, no numbers,
        unequal lengths; or numbers of zendsp that do not match their checksum.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> file = pathlib.Path(tempfile.mkdtemp(), "run.csv")
    >>> _ = file.write_text("t [s],q [rad]\\n0,1\\n0.1,2\\n")
    >>> table = read_table(file)
    >>> table["q"], table.units["q"]
    (array([1., 2.]), 'rad')
    """
    path = Path(path).expanduser()
    raw = read_raw(path, progress)
    if raw.metadata:
        body, *_ = checked(path, raw)
        time = body["extra"].get("time_column", "t")  # by which a model file knows it
        raw = replace(
            raw, columns={time if n == "t" else n: v for n, v in raw.columns.items()},
            units={time if n == "t" else n: v for n, v in raw.units.items()},
        )  # fmt: skip
    return _checked(path, raw, columns)


def read_raw(path: Path, tell: Share | None = None) -> Raw:
    """The contents of a file, read by its suffix, not yet interpreted; see `read_table`."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if path.is_dir() and not (path / BAG).exists():
        path = _within(path)
    suffix = _suffix(path)
    if path.is_dir():
        suffix = ".db3"
    elif path.stat().st_size == 0:
        raise RecordingError(f"{path}: is empty (0 bytes)")
    if suffix not in READERS:
        raise RecordingError(
            f"{path}: unknown kind of file {suffix or path.name!r}; {_convert(path)}"
        )
    reader = import_module(f"zendsp.recording.formats.{READERS[suffix]}")
    try:
        raw: Raw = reader.read(path, tell) if READERS[suffix] == "csv" else reader.read(path)
    except RecordingError:
        raise
    except MemoryError as error:
        raise RecordingError(
            f"{path}: needs more memory than there is ({str(error) or 'none is left'}): it is"
            " damaged, or needs to be cut into parts"
        ) from error
    except OSError as error:
        if error.errno is not None:
            raise RecordingError(f"{path}: cannot be opened ({error.strerror})") from error
        raise _damaged(path, error) from error
    except Exception as error:  # on damaged bytes the libraries raise whatever they ran into
        raise _damaged(path, error) from error
    return raw


def _within(folder: Path) -> Path:
    """The one recording in a folder: of a run, or the only file of a kind that is read."""
    there = sorted(file for file in folder.iterdir() if _suffix(file) in READERS)
    of_run = [file for file in there if file.name == OF_RUN]
    if len(of_run or there) == 1:
        return (of_run or there)[0]
    names = ", ".join(file.name for file in there[:FILES]) + ", …" * (len(there) > FILES)
    raise RecordingError(
        f"{folder}: is a folder with {counted(len(there), 'recording')}"
        + (f" ({names}): give one of them" if there else "")
        + f"; one with a single file ({', '.join(READERS)}), or a bag of rosbag2 ({BAG} is in it),"
        " is read"
    )


def _suffix(path: Path) -> str:
    return (
        "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    )


def _convert(path: Path) -> str:
    if path.suffix.lower() in ROBOTS:
        kind = "mjcf" if path.suffix.lower() in (".xml", ".mjcf") else "urdf"
        return (
            "it looks like the description of a robot, and a recording of it is wanted. A model"
            f' file names it: [mechanism] kind = "{kind}", file = "{path.name}" (docs/models.md);'
            f" 'zendsp target --machine {path}' runs it, to be recorded"
        )
    command = CONVERSIONS.get(path.suffix.lower())
    if command is None:
        return f"expected {', '.join(READERS)}"
    names = {"path": path, "csv": path.with_suffix(".csv"), "mat": path.with_suffix(".mat")}
    quoted = {key: shlex.quote(str(name)) for key, name in names.items()}
    return f"convert it: {command.format(**quoted)}"


def _damaged(path: Path, error: Exception) -> RecordingError:
    kind = "bag of ROS" if path.is_dir() else f"{_suffix(path)} file"
    said = " ".join(str(error).split())
    said = said if len(said) <= SAID else f"{said[:SAID]} …"
    return RecordingError(
        f"{path}: is damaged, cut short, or no {kind}: it cannot be read"
        f" ({type(error).__name__}: {said})"
    )


def _checked(path: Path, raw: Raw, wanted: Sequence[str] | None) -> Table:
    if wanted is not None:
        for name in wanted:
            bare = split_unit(name)[0]
            if bare in raw.refused:
                raise RecordingError(f"{path}: column {name!r} {raw.refused[bare]}")
    columns, in_units, notes = in_si(
        {name: upright(values) for name, values in raw.columns.items()}, raw.units
    )
    said = tuple(
        f"{name}: {qualified(name)!r} is no unit: it is read as part of the name, and the column in"
        " SI units"
        for name in raw.columns if qualified(name) and not raw.units.get(name)
    )  # fmt: skip
    notes = raw.notes + said + notes
    joined, units = gather_vectors(columns, in_units) if _equal(columns) else (columns, in_units)
    table = Table(joined, units, raw.constants, path, notes)
    if wanted is not None:
        chosen = {name: table[name] for name in wanted}
        return Table(
            _same_length(path, chosen), {n: _unit(units, n) for n in chosen}, raw.constants, path,
            notes,
        )
    if not joined:
        why = "; ".join(f"{name} {reason}" for name, reason in list(raw.refused.items())[:3])
        raise RecordingError(f"{path}: holds no column of numbers{f' ({why})' if why else ''}")
    return Table(_same_length(path, joined), units, raw.constants, path, notes)


def _unit(units: Mapping[str, str], name: str) -> str:
    return units.get(name) or ", ".join(units_in(units, name))


def _equal(columns: Mapping[str, FloatArray]) -> bool:
    return len({len(values) for values in columns.values()}) <= 1


def _same_length(path: Path, columns: Mapping[str, FloatArray]) -> Mapping[str, FloatArray]:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        longest = max(lengths, key=lambda name: lengths[name])
        other = next(name for name in lengths if lengths[name] != lengths[longest])
        raise RecordingError(
            f"{path}: columns differ in length: {longest!r} has {lengths[longest]} rows, {other!r}"
            f" has {lengths[other]}; every column needs one value per sample"
        )
    return columns
