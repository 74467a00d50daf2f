"""The data of a `zendsp.recording.Recording`: samples of chosen signals on one time base."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn, Self

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.recording.names import (
    FloatArray,
    element_names,
    listing,
    pick,
    split_heads,
    split_unit,
)
from zendsp.recording.notes import Extra, LoopTiming
from zendsp_protocol.texts import counted, units_of
from zendsp_protocol.values import Assignable

GAP, GAP_S = 50, 0.1  # samples, and s at least


def is_gap(step: float, period: float) -> bool:
    """Whether the time between two rows, s, is so much longer than usual that two recordings may
    have been joined there.
    """
    return step > max(GAP * period, GAP_S)


@dataclass(frozen=True)
class Channel:
    """One recorded signal.

    Attributes
    ----------
    name : str
    unit : str
        Of all columns, or one for each: ``"A, V"``. Empty where it has none.
    width : int
        Columns; 1 for a scalar.
    """

    name: str
    unit: str = ""
    width: int = 1


@dataclass(frozen=True)
class ParameterChange:
    """One line of the log of changes: what was changed, when, and by whom.

    Attributes
    ----------
    tick : int
        Sample at which it took effect.
    host_time : float, Unix s
        By the clock of the target.
    name : str
    old, new : bool, int, float, or list of these
    author : str
        Who asked.
    fade : int
        Samples over which it came; ``tick`` is then that of its end.
    """

    tick: int
    host_time: float
    name: str
    old: Any
    new: Any
    author: str
    fade: int = 0


@dataclass(frozen=True, eq=False)
class Samples:
    """The data of a `zendsp.recording.recording.Recording`, which describes each field."""

    t: FloatArray
    data: FloatArray
    channels: tuple[Channel, ...]
    sample_time: float
    start_tick: int = 0
    decimation: int = 1
    trigger_row: int = -1
    lost: int = 0
    timing: LoopTiming = field(default_factory=LoopTiming)
    log: tuple[ParameterChange, ...] = ()
    parameters: Mapping[str, Assignable] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    compiler: str = ""
    flags: tuple[str, ...] = ()
    machine: str = ""
    target: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    created: float = 0.0
    note: str = ""
    extra: Extra = field(default_factory=Extra)

    def __post_init__(self) -> None:
        width = sum(channel.width for channel in self.channels)
        if self.data.ndim != 2 or self.data.shape != (len(self.t), width):
            raise RecordingError(
                f"a recording of {counted(len(self.t), 'row')} and {counted(width, 'column')} was"
                " given data of shape"
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
        **metadata: Any,
    ) -> Self:
        """A recording made of arrays, for example of a simulation.

        Parameters
        ----------
        columns : mapping of name to array, shape (N,) or (N, m)
            Without ``units`` a name may state its own, as the head of a CSV: ``"angle [deg]"``.
        sample_time : float, s
            Needed unless ``t`` is given.
        t : array, shape (N,), s
            Default: 0, sample_time, 2 sample_time, …
        units : mapping of name to unit
        **metadata
            Any other attribute of `Recording`.

        Raises
        ------
        RecordingError
            Columns of different lengths, or neither ``t`` nor ``sample_time``.
        """
        names = [str(name) for name in columns]
        heads = split_heads(names) if units is None else [(name, "") for name in names]
        arrays = {
            name: np.asarray(columns[head], dtype=np.float64)
            for head, (name, _) in zip(columns, heads, strict=True)
        }
        said = units or {name: unit for name, unit in heads if unit}
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
            raise RecordingError(
                "a recording needs a time base: give sample_time=… or t=… beside the columns"
            )
        time: FloatArray = np.asarray(
            np.arange(rows) * (sample_time or 0.0) if t is None else t, dtype=np.float64
        )
        if sample_time is None:
            sample_time = float(np.median(np.diff(time))) if rows > 1 else 0.0
        matrices = [v.reshape(rows, v.shape[1] if v.ndim == 2 else 1) for v in arrays.values()]
        channels = tuple(
            Channel(name, said.get(name, ""), matrix.shape[1])
            for name, matrix in zip(arrays, matrices, strict=True)
        )
        return cls(time, np.hstack(matrices), channels, float(sample_time), **metadata)

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
        return tuple(unit for c in self.channels for unit in units_of(c.unit, c.width))

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
        """Channel ``name``, or element ``"q[1]"`` of a vector channel; ``"t"`` is the time base.

        Raises
        ------
        RecordingError
            No such channel; the message lists those there are.
        """
        values = pick(self.signals, name)
        if values is None and name == "t":
            return self.t
        if values is None:
            values = pick(self.signals, split_unit(name)[0])
        if values is None:
            raise RecordingError(
                f"the recording has no channel {name!r}; it has {listing(self.names)}"
            )
        return values

    def keys(self) -> list[str]:
        """``"t"`` and the name of each column, so that ``dict(rec)`` holds them all.

        Returns
        -------
        list of str
            Each for `rec[name]`, shape (N,).
        """
        return ["t", *(name for name in self.columns if name != "t")]

    def _ipython_key_completions_(self) -> list[str]:
        """Names for ``rec["<Tab>`` at a prompt."""
        return list(dict.fromkeys(["t", *self.names, *self.columns]))

    def __iter__(self) -> NoReturn:
        raise RecordingError(
            "a recording is not gone through by itself: rec.names are its channels, rec.columns its"
            " columns, dict(rec) the columns by name, rec['q'] one; pandas.DataFrame(dict(rec))"
        )

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name == "t" or pick(self.signals, name) is not None)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return (
            f"<Recording {listing(self.names)}; {len(self)} rows, {self.sample_time * 1e3:g} ms, "
            f"{len(self) * self.sample_time:g} s, {self.lost} lost>"
        )
