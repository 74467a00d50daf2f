"""Recordings of targets that were killed: their rows stay in shared memory, for the same user on
the same computer.
"""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from zendsp.errors import AcquisitionError
from zendsp_protocol import kept
from zendsp_protocol.lazily import Lazily

if TYPE_CHECKING:
    import numpy as np

    from zendsp.recording import Recording
    from zendsp.recording.names import FloatArray
else:
    np = Lazily("numpy")

SETTLE_S = 5.0  # for a loop that outlives its monitor by a moment
LOG_LOST = (
    "changes of parameters made while it recorded are not known; the values are those when it began"
)


@dataclass(frozen=True)
class Salvage:
    """The last recording of one killed target.

    Attributes
    ----------
    target, machine : str
    begun : float, Unix s
    rows, columns : int
    folder : Path
        In shared memory; it is freed by `drop`.
    """

    target: str
    machine: str
    begun: float
    rows: int
    columns: int
    folder: Path

    def load(self, note: str = "") -> Recording:
        """Return the recording; it stays in shared memory until `drop`.

        Parameters
        ----------
        note : str
            Kept in the recording.

        Raises
        ------
        AcquisitionError
            It is gone.
        """
        from zendsp.link.metadata import host_version, join_channels, ticks_of
        from zendsp.link.variables import plain
        from zendsp.recording import Recording
        from zendsp.recording.notes import Extra
        from zendsp_protocol.values import from_wire

        found = kept.read(self.folder)
        if found is None:
            raise AcquisitionError(
                f"the recording of {self.target!r} is gone: it was dropped, or removed by a later"
                " start"
            )
        first, data = _rows(self.folder, found)
        about, program = found.about, found.about.program
        begin = found.word(self.folder, found.start_at)
        ticks = ticks_of(first, len(data), begin, found.decimation, found.gaps(self.folder))
        fired = found.word(self.folder, found.fired_at)
        return Recording(
            t=ticks / about.rate_hz,
            data=data,
            channels=join_channels(found.columns, found.units),
            sample_time=found.decimation / about.rate_hz,
            start_tick=int(ticks[0]) if len(ticks) else begin,
            decimation=found.decimation,
            trigger_row=fired - first if fired >= 0 else -1,
            lost=found.word(self.folder, found.missed_at),
            parameters={name: plain(from_wire(value)) for name, value in about.parameters.items()},
            sources=dict(program.sources),
            compiler=program.compiler,
            flags=tuple(program.flags),
            machine=about.machine,
            target=about.target,
            versions={**about.versions, "host": host_version()},
            created=about.begun,
            note=note,
            extra=cast(Extra, {**about.extra, "salvaged": LOG_LOST}),
        )

    def drop(self) -> None:
        """Free the memory; a recording that was not loaded and saved is lost."""
        shutil.rmtree(self.folder, ignore_errors=True)


def find_salvage(target: str = "") -> tuple[Salvage, ...]:
    """The recordings of this user's targets that were killed, newest first.

    A target keeps its latest recording in shared memory until the target ends normally. If it is
    killed, the rows stay until they are dropped or the computer is switched off; only those of the
    last three killed targets are kept.

    Parameters
    ----------
    target : str
        Only of targets of this name; default: of all.

    Examples
    --------
    >>> for one in find_salvage("a target that was never killed"):
    ...     one.load().save("run.mat")
    ...     one.drop()
    """
    found: list[tuple[float, Salvage]] = []
    with kept.abandoned() as folders:
        for folder in folders:
            note = kept.read(folder)
            if note is not None and target in ("", note.about.target):
                about = note.about
                first, count = _range(folder, note)
                one = Salvage(
                    about.target, about.machine, about.begun, count - first, len(note.columns),
                    folder,
                )
                found.append((about.since_start, one))
    return tuple(one for _, one in sorted(found, key=lambda each: each[0], reverse=True))


def _range(folder: Path, note: kept.Kept) -> tuple[int, int]:
    """The first row that is there, and the first that was no longer written."""
    count, fired = note.count(folder), note.word(folder, note.fired_at)
    return kept.first_row(count, fired, note.rows, note.pre, note.ring, note.triggered), count


def _rows(folder: Path, note: kept.Kept) -> tuple[int, FloatArray]:
    width = len(note.columns)
    deadline = time.monotonic() + SETTLE_S
    while True:
        first, count = _range(folder, note)
        held = np.memmap(folder / note.file, np.float64, "r", note.rows_at, (note.capacity, width))
        data = np.array(held[np.arange(first, count) % note.capacity])
        if note.count(folder) == count:
            return first, data
        if time.monotonic() > deadline:
            raise AcquisitionError(
                f"the loop of {note.about.target!r} still writes rows: end it, or look whether the"
                " target lives"
            )
