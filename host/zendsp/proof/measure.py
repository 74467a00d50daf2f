"""What a laboratory's logging does to a recording, after the machine has moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.proof.draft import Array
from zendsp.proof.reality import Run

Rng = np.random.Generator
# harmless, and so put on any case now and then
DRESSINGS = ("float32", "origin", "unit")
EPOCH = 1.7e9  # s, what a logger's clock shows


def _rounded(x: Array) -> Array:
    return np.asarray(x.astype(np.float32).astype(np.float64))


def repeated(run: Run, rng: Rng) -> Run:
    """One row in two hundred is written twice, stamp included."""
    count = np.ones(run.time.size, int)
    count[rng.random(run.time.size) < 0.005] = 2
    rows = np.repeat(np.arange(run.time.size), count)
    return replace(
        run, time=run.time[rows], measured=run.measured[rows], command=run.command[rows],
        reference=run.reference[rows], q=run.q[rows], v=run.v[rows],
    )  # fmt: skip


def stale(run: Run, rng: Rng) -> Run:
    """One position in two hundred was not read anew: it is the one before, with the stamp of its
    row.
    """
    rows = np.arange(run.time.size)
    rows[1:] -= rng.random(rows.size - 1) < 0.005
    return replace(run, measured=run.measured[rows])


def without_delay(x: Array) -> Array:
    """A low pass run forward and backward at an eighth of the sampling rate."""
    from scipy.signal import butter, filtfilt

    top, bottom = butter(2, 0.25)
    return np.asarray(filtfilt(top, bottom, x, axis=0))


def low_passed(x: Array, seconds: float, sample_time: float) -> Array:
    """A first-order filter of the logger, begun at rest."""
    from scipy.signal import lfilter

    keep = float(np.exp(-sample_time / seconds))
    return np.asarray(x[:1] + lfilter([1 - keep], [1, -keep], x - x[:1], axis=0))


def shifted(x: Array, rows: int) -> Array:
    """The column written `rows` rows late (early where negative)."""
    out = np.roll(x, rows, axis=0)
    if rows > 0:
        out[:rows] = x[0]
    elif rows < 0:
        out[rows:] = x[-1]
    return out


def jittered(run: Run, resolution: Array, sample_time: float, rng: Rng) -> Run:
    """Each row was read up to a quarter of a sample early or late, and its stamp says when."""
    from scipy.interpolate import CubicSpline

    late = rng.uniform(-0.25, 0.25, run.time.size) * sample_time
    late[0] = 0.0
    noise = run.measured - run.q  # of the sensor, its rounding with it
    q = CubicSpline(run.time, run.q)(run.time + late)
    return replace(
        run, time=run.time + late, measured=np.round((q + noise) / resolution) * resolution
    )


def apply_faults(run: Run, faults: Sequence[str], sample_time: float, rng: Rng) -> Run:
    """The recording as the bench's logger writes it."""
    for fault in faults:
        name, _, number = fault.partition(" ")
        if name == "float32":
            run = replace(run, measured=_rounded(run.measured), command=_rounded(run.command))
        elif name == "repeat":
            run = repeated(run, rng)
        elif name == "stale":
            run = stale(run, rng)
        elif name == "filtered":
            run = replace(run, measured=without_delay(run.measured))
        elif name == "filter":
            run = replace(run, measured=low_passed(run.measured, float(number), sample_time))
        elif name == "shift":
            run = replace(run, command=shifted(run.command, int(number)))
        elif name == "origin":
            run = replace(run, time=run.time + EPOCH)
        elif name == "unit":
            run = replace(run, command=1000.0 * run.command)
    return run


def format_of(rng: Rng) -> tuple[str, bool]:
    """A file format that keeps what the case is about, and whether vectors are split into columns.
    """
    form = str(rng.choice(("csv", "npz", "mat", "parquet")))
    return form, form in ("csv", "parquet") or bool(rng.random() < 0.5)
