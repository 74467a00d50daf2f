"""The Recording: samples of chosen signals on one time base, with everything needed to repeat the
run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from zendsp.recording.samples import Channel, ParameterChange, Samples
from zendsp_protocol.views import curves, sentence

SHOWN = 400  # blocks of rows whose lowest and highest values a notebook draws

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

__all__ = ["Channel", "ParameterChange", "Recording"]


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Samples):
    """Samples of signals on one time base, and what they were taken with.

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
        Row 0 was taken at tick ``start_tick`` of the ISR, and every ``decimation``-th sample gives
        a row. Where samples were left out rows are missing: ``t`` has a gap there.
    trigger_row : int
        Row at which the trigger fired, -1 where there was none.
    lost : int
        Rows that the target could not keep; 0 is the promise.
    timing : LoopTiming
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
    extra : Extra
        What is said beside (`zendsp.recording.notes.Extra`), and anything else that JSON can hold,
        kept unread.

    Examples
    --------
    >>> import numpy as np
    >>> rec = Recording.from_columns({"q": np.zeros((100, 2)), "u": np.ones(100)}, sample_time=0.001)
    >>> rec["q"].shape, rec["q[1]"].shape, rec.columns
    ((100, 2), (100,), ('q[0]', 'q[1]', 'u'))
    """  # noqa: E501

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

        The file appears complete or not at all (written beside, then renamed). A folder that is
        not there is made, and ``~`` is your home folder, as with everything that zendsp writes. In
        MATLAB a ``.mat`` has ``data``, a column per signal with the time
        first, and ``names`` and ``units``, a cell per column.
        """
        from zendsp.recording.files import save

        return save(self, Path(path).expanduser())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a recording written by `save`, or any table with a column of time, in SI
        units.

        Raises
        ------
        RecordingError
            The file is missing, damaged, or no table with a time base.
        """
        from zendsp.recording.files import load

        return load(Path(path).expanduser(), cls)

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas DataFrame, one column for each element, indexed by ``t`` (needs
        ``zendsp[frames]``).
        """
        from zendsp.recording.frames import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> xarray.Dataset:
        """An xarray Dataset with units as attributes (needs ``zendsp[frames]``)."""
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
