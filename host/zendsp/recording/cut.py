"""Cuts a recording: ranges of time, parts between gaps, and rows without numbers left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.files import load_said
from zendsp.recording.recording import Recording

LONG, SLOW = 50, 0.1  # sample times, s: a longer step of time is a gap that is not bridged


def read_parts(
    path: str | Path,
    begin: float = 0.0,
    end: float = np.inf,
    finite: Sequence[str] = (),
    time: str = "",
    without: Sequence[tuple[float, float]] = (),
) -> list[Recording]:
    """The parts of a recording that have no gap in time, as ``zendsp cut`` writes them.

    Parameters
    ----------
    path : path
        Any file that zendsp reads.
    begin, end : float, s
        From the first row on; rows outside are left out.
    finite : sequence of str
        Columns: rows in which one of them is no finite number are left out.
    time : str
        Column of time; default: `t`, `time`, or what looks like it.
    without : sequence of (float, float), s
        Ranges from the first row on that are left out: what is before one and what is after it are
        parts.

    Returns
    -------
    list of Recording
        One where there is no gap. Two runs that were glued together are two: where time runs
        backwards too. A parameter has the value that it had at the part's last row.

    Raises
    ------
    RecordingError
        The file cannot be read, has no such column, or nothing is left.

    Examples
    --------
    >>> from zendsp.recording.cut import read_parts
    >>> for k, part in enumerate(read_parts("run.csv", begin=1.5)):  # doctest: +SKIP
    ...     part.save(f"run_{k}.csv")
    """
    return read_cut(path, begin, end, finite, time, without)[0]


def read_cut(
    path: str | Path,
    begin: float = 0.0,
    end: float = np.inf,
    finite: Sequence[str] = (),
    time: str = "",
    without: Sequence[tuple[float, float]] = (),
) -> tuple[list[Recording], tuple[str, ...]]:
    """What `read_parts` returns, and what was done to the columns on the way: units converted,
    columns of words left out.
    """
    rec, said = load_said(Path(path).expanduser(), Recording, time)
    t = rec.t - rec.t[0] if len(rec) else rec.t
    keep = (t >= begin) & (t < end)
    for name in finite:
        values = rec[name]
        keep &= np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    for first, last in without:
        keep &= (t < first) | (t >= last)
    rows = np.flatnonzero(keep)
    if not len(rows):
        if begin >= end:
            raise RecordingError(f"{path}: from {begin:g} s to {end:g} s is no time: exchange them")
        raise RecordingError(
            f"{path}: no row is left of {len(rec)}; it is {t[-1] if len(t) else 0.0:.6g} s long"
        )
    step = np.diff(rec.t[rows])
    usual = float(np.median(step)) if len(step) else 0.0
    apart = (step > max(LONG * usual, SLOW)) | (step < 0)
    for first, last in without:
        apart |= (t[rows[:-1]] < first) & (t[rows[1:]] >= last)
    breaks = np.flatnonzero(apart) + 1
    return [_part(rec, chosen) for chosen in np.split(rows, breaks)], said


def _part(rec: Recording, rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Recording:
    """The recording that consists of some rows of another, with the metadata that hold for these.
    """
    if len(rows) == len(rec):
        return rec
    t, parameters = rec.t[rows], dict(rec.parameters)
    ticks = np.rint((t[[0, -1]] - rec.t[0]) / (rec.sample_time or np.inf)).astype(int)
    first, last = (rec.start_tick + rec.decimation * int(k) for k in ticks)
    for change in reversed(rec.log):
        if change.tick > last and change.name in parameters:
            parameters[change.name] = change.old
    at = np.flatnonzero(rows == rec.trigger_row)
    return replace(
        rec, t=t, data=rec.data[rows], start_tick=first, trigger_row=int(at[0]) if len(at) else -1,
        log=tuple(change for change in rec.log if change.tick <= last), parameters=parameters,
    )  # fmt: skip
