"""The Recording: samples of chosen signals on one time base, with all that is needed to repeat the
run.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.recording.names import FloatArray, element_names, listing, pick
from zendsp_protocol.views import curves, sentence

SHOWN = 400  # blocks of rows whose lowest and highest values a notebook draws

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Channel:
    """One recorded signal: a scalar (width 1) or a vector of ``width`` columns."""

    name: str
    unit: str = ""
    width: int = 1


@dataclass(frozen=True)
class ParameterChange:
    """One line of the parameter log: what changed, at which sample, when by the clock of the
    target, and by whom.
    """

    tick: int
    host_time: float  # Unix s
    name: str
    old: Any  # bool, int, float, or a list of these
    new: Any
    author: str


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of signals on one time base, and the circumstances under which they were taken.

    Attributes
    ----------
    t : ndarray, shape (N,), s
        Time of each row since the start of the program.
    data : ndarray, shape (N, columns)
        One column for each element of each channel, in the order of ``channels``.
    channels : tuple of Channel
        Names, units and widths.
    sample_time : float, s
        Between rows (the period of the loop times the decimation).
    start_tick, decimation : int
        Row k was taken at tick ``start_tick + k * decimation`` of the ISR.
    trigger_row : int
        Row at which the trigger fired, -1 where there was none.
    lost : int
        Rows that the target could not keep; 0 is the promise.
    timing : mapping
        Timing statistics of the loop, ns (see ``docs/protocol.md``).
    log : tuple of ParameterChange
        Changes of parameters made since the program was loaded, up to the end of the recording.
    parameters : mapping
        Value of every parameter when the recording ended.
    sources : mapping of file name to C text
        The program, with ``source_hash``, ``compiler`` and ``flags``.
    machine, target : str
        What was driven, by which target.
    versions : mapping
        Of zendsp, the protocol, Python and the machine's kernel.
    created : float, Unix s
    note : str
        The user's own words.
    extra : mapping
        Anything else that JSON can hold, kept unread.

    Examples
    --------
    >>> import numpy as np
    >>> rec = Recording.from_columns({"q": np.zeros((100, 2)), "u": np.ones(100)}, sample_time=0.001)
    >>> rec["q"].shape, rec["q[1]"].shape, rec.columns
    ((100, 2), (100,), ('q[0]', 'q[1]', 'u'))
    """  # noqa: E501

    t: FloatArray
    data: FloatArray
    channels: tuple[Channel, ...]
    sample_time: float
    start_tick: int = 0
    decimation: int = 1
    trigger_row: int = -1
    lost: int = 0
    timing: Mapping[str, Any] = field(default_factory=dict)
    log: tuple[ParameterChange, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    compiler: str = ""
    flags: tuple[str, ...] = ()
    machine: str = ""
    target: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    created: float = 0.0
    note: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        width = sum(channel.width for channel in self.channels)
        if self.data.ndim != 2 or self.data.shape != (len(self.t), width):
            raise RecordingError(
                f"a recording of {len(self.t)} rows and {width} columns was given data of shape"
                f" {self.data.shape}"
            )
        names = [channel.name for channel in self.channels]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise RecordingError(f"channel names must differ; these occur twice: {listing(twice)}")

    @classmethod
    def from_columns(
        cls,
        columns: Mapping[str, npt.ArrayLike],
        sample_time: float | None = None,
        t: npt.ArrayLike | None = None,
        units: Mapping[str, str] | None = None,
        **circumstances: Any,
    ) -> Recording:
        """Make a recording of arrays, for example of a simulation.

        Parameters
        ----------
        columns : mapping of name to array, shape (N,) or (N, m)
        sample_time : float, s
            Needed unless ``t`` is given.
        t : array, shape (N,), s
            Default: 0, sample_time, 2 sample_time, …
        units : mapping of name to unit
        **circumstances
            Any other attribute of :class:`Recording`.

        Raises
        ------
        RecordingError
            Columns of different lengths, or neither ``t`` nor ``sample_time``.
        """
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
        if not arrays:
            raise RecordingError("a recording needs at least one column")
        lengths = {
            name: values.shape[0] if values.ndim in (1, 2) else -1
            for name, values in arrays.items()
        }
        if len(set(lengths.values())) != 1 or -1 in lengths.values():
            shown = ", ".join(f"{name} {values.shape}" for name, values in arrays.items())
            raise RecordingError(
                f"columns must have equal length and one or two dimensions; given: {shown}"
            )
        rows = next(iter(lengths.values()))
        if t is None and sample_time is None:
            raise RecordingError("give sample_time or t: a recording needs a time base")
        time: FloatArray = np.asarray(
            np.arange(rows) * (sample_time or 0.0) if t is None else t, dtype=np.float64
        )
        if sample_time is None:
            sample_time = float(np.median(np.diff(time))) if rows > 1 else 0.0
        matrices = [values.reshape(rows, -1) for values in arrays.values()]
        channels = tuple(
            Channel(name, (units or {}).get(name, ""), matrix.shape[1])
            for name, matrix in zip(arrays, matrices, strict=True)
        )
        return cls(time, np.hstack(matrices), channels, float(sample_time), **circumstances)

    @cached_property
    def signals(self) -> dict[str, FloatArray]:
        """Views of the data by channel name, each ``(N,)`` or ``(N, m)``."""
        views: dict[str, FloatArray] = {}
        first = 0
        for channel in self.channels:
            block = self.data[:, first : first + channel.width]
            views[channel.name] = block[:, 0] if channel.width == 1 else block
            first += channel.width
        return views

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names, in order."""
        return tuple(channel.name for channel in self.channels)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of ``data``, in order."""
        return tuple(name for c in self.channels for name in element_names(c.name, c.width))

    @property
    def column_units(self) -> tuple[str, ...]:
        """Units of the columns of ``data``, in order."""
        return tuple(c.unit for c in self.channels for _ in range(c.width))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel by name."""
        return {channel.name: channel.unit for channel in self.channels}

    @property
    def source_hash(self) -> str:
        """SHA-256 over the names and texts of the sources, empty where the recording carries none.
        """
        if not self.sources:
            return ""
        digest = hashlib.sha256()
        for name in sorted(self.sources):
            digest.update(f"{name}\0{self.sources[name]}\0".encode())
        return digest.hexdigest()

    def __getitem__(self, name: str) -> FloatArray:
        """Return channel ``name``, or element ``"q[1]"`` of a vector channel; ``"t"`` is the time
        base.

        Raises
        ------
        RecordingError
            No such channel; the message lists those there are.
        """
        values = pick(self.signals, name)
        if values is None and name == "t":
            return self.t
        if values is None:
            raise RecordingError(
                f"the recording has no channel {name!r}; it has {listing(self.names)}"
            )
        return values

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name == "t" or pick(self.signals, name) is not None)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return (
            f"<Recording {listing(self.names)}; {len(self)} rows, {self.sample_time * 1e3:g} ms, "
            f"{len(self) * self.sample_time:g} s, {self.lost} lost>"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows: the first curves, with every spike, and a sentence."""
        step = max(1, len(self) // SHOWN)
        rows = len(self) // step * step
        blocks = self.data[:rows].reshape(-1, step, self.data.shape[1])
        ends = np.stack((blocks.min(axis=1), blocks.max(axis=1)), axis=1)  # of each block
        shown = ends.reshape(-1, self.data.shape[1]) if step > 1 else self.data
        t = np.repeat(self.t[:rows:step], 2) if step > 1 else self.t
        names = [
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(self.columns, self.column_units, strict=True)
        ]
        columns = [(name, shown[:, k].tolist()) for k, name in enumerate(names)]
        note = sentence(self.note) if self.note else ""
        return curves(t.tolist(), columns) + sentence(repr(self)[1:-1]) + note

    def save(self, path: str | Path) -> Path:
        """Write the recording; the suffix chooses: ``.mat`` (v5), ``.npz``, ``.parquet``, ``.csv``,
        ``.mcap`` or ``.mf4``.

        The file appears complete or not at all (written beside, then renamed).
        """
        from zendsp.recording.files import save

        return save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Read a recording written by :meth:`save`, or any table with a column of time, in SI
        units.

        Raises
        ------
        RecordingError
            The file is missing, damaged, or no table with a time base.
        """
        from zendsp.recording.files import load

        return load(Path(path))

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas DataFrame, one column per element, indexed by ``t`` (needs
        ``zendsp[frames]``).
        """
        from zendsp.recording.frames import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray Dataset with units as attributes (needs ``zendsp[frames]``)."""
        from zendsp.recording.frames import to_xarray

        return to_xarray(self)

    def plot(self, names: Sequence[str] | None = None, path: str | Path | None = None) -> Figure:
        """Draw channels over time, one panel per unit.

        Parameters
        ----------
        names : sequence of str, optional
            Channels or elements; default all.
        path : path, optional
            Also write the figure there (PNG, SVG, PDF by suffix).
        """
        from zendsp.recording.plot import plot

        return plot(self, names, path)
