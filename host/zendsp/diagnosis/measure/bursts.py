"""Lacking torque that comes and goes with time, or repeats itself, whatever the joint does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_closing, median_filter
from scipy.special import ndtr, ndtri  # scipy.stats would take half a second to import

from zendsp.diagnosis.measure.discrepancy import kept, lacking, mean_square
from zendsp.diagnosis.measure.structure import unit
from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

BRIEF = 0.4  # of the time at most: what acts for longer is no disturbance that comes and goes
# of the energy outside of that time, against what a random torque that is normally distributed has
# there
CONCENTRATED = 0.4
BURST, OF_PEAK = 10.0, 0.05  # times the median of the energy, and of its largest: a burst
REVISITED = 0.3  # of that time, in states that the joint is in at other times too, without it
CHANCE = 1e-3  # that the largest of a noise's spectral lines stands out so far
AROUND = 20  # neighbours on either side, whose median says how large noise is there
MANY, FEW = 12, 3  # intervals: in recordings that no model was fitted to, and in the others


@dataclass(frozen=True)
class Bursts:
    """Times (s) in which nearly all of a lacking torque acts, though the joint is in the same
    states at other times.

    ``share`` is their part of its energy, ``peak`` the largest torque (N m or N), ``rms`` its RMS
    within them.
    """

    intervals: tuple[tuple[float, float], ...]
    share: float
    peak: float
    rms: float


def _states(
    rec: Sequence[JointRecord], joint: int, use: slice, q: Array, v: Array
) -> list[npt.NDArray[np.float64]]:
    """Cells of the states that a joint is in, (n,) each: place, direction and speed; the way since
    it last turned round; the place of each neighbour, with the direction.
    """

    def places(x: Array, count: int) -> Array:
        return np.floor((count - 0.01) * unit(x, (float(x.min()), float(x.max()))))

    fast = np.minimum(2, np.floor(np.abs(v) / max(float(np.std(v)), 1e-300)))
    forward = (v > 0).astype(float)
    turns = np.flatnonzero(np.diff(forward)) + 1
    since = np.zeros(len(q), int)
    since[turns] = turns
    way = np.abs(q - q[np.maximum.accumulate(since)])
    cells = [6 * places(q, 20) + 3 * forward + fast, 2 * places(way, 20) + forward]
    for other in (joint - 1, joint + 1):
        if 1 <= other <= len(rec):
            cells.append(2 * places(rec[other - 1].motion.states[0][use], 20) + forward)
    return cells


def bursts(
    data: Data, model: Model, joint: int, band: float = 32.0, many: int = MANY
) -> Bursts | None:
    """Find the times outside of which a model lacks next to nothing; None where there are none
    such.

    Parameters
    ----------
    data : Data
    model : Model
    joint : int
        1-based.
    band : float
        Of the observer, rad/s.
    many : int
        Intervals; more come and go with something else than time.

    Returns
    -------
    Bursts or None
    """
    found = lacking(data, model, joint, band)
    spans: list[tuple[float, float]] = []
    inside = outside = peak = 0.0
    count = covered = met = 0
    levels, masks = [], []
    for lack, rec in zip(found, data.records, strict=True):
        record = rec[joint - 1]
        use = kept(record, band)
        width = max(3, round(3.0 / band / record.sample_time))
        levels.append(np.convolve(lack**2, np.ones(width) / width, mode="same")[use])
    quiet = float(np.quantile(np.concatenate(levels), 0.5))
    for level, lack, rec in zip(levels, found, data.records, strict=True):
        record = rec[joint - 1]
        use = kept(record, band)
        high = level > max(BURST * quiet, OF_PEAK * float(level.max()))
        high = binary_closing(np.pad(high, 1), iterations=max(1, round(0.25 / record.sample_time)))[
            1:-1
        ]
        masks.append(high)
        q, v = record.motion.states[0][use], record.motion.states[1][use]
        seen = [np.isin(c, np.unique(c[~high])) for c in _states(rec, joint, use, q, v)]
        met += int(np.all(seen, axis=0)[high].sum())
        energy = lack[use] ** 2
        inside += float(energy[high].sum())
        outside += float(energy[~high].sum())
        count += len(high)
        covered += int(high.sum())
        change = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
        start = record.t0 + use.start * record.sample_time
        spans += [
            (start + a * record.sample_time, start + (b - 1) * record.sample_time)
            for a, b in zip(change[::2].tolist(), change[1::2].tolist(), strict=True)
        ]
        # a smooth peak: single samples are noise, and the observer's own ringing at the edges
        if high.any():
            width = max(3, round(3.0 / band / record.sample_time))
            smooth = np.convolve(lack[use], np.ones(width) / width, mode="same")
            peak = max(peak, float(np.quantile(np.abs(smooth[high]), 0.95)))
    share = inside / max(inside + outside, 1e-300)
    if not spans or covered > BRIEF * count or met < REVISITED * covered or len(spans) > many:
        return None
    z = -float(ndtri(0.5 * covered / count))
    # of a random torque's energy, in its largest values for so long
    by_chance = 2.0 * (z * float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)) + float(ndtr(-z)))
    if 1.0 - share > CONCENTRATED * (1.0 - by_chance):
        return None
    return Bursts(tuple(spans), share, peak, float(np.sqrt(inside / max(covered, 1))))


def periodic(data: Data, model: Model, joint: int, band: float = 64.0) -> float:
    """RMS of the one sine that stands out of what a model lacks, as a part of the RMS torque; 0
    where none does in each recording (Fisher 1929, with the noise of the neighbouring lines).
    """
    sizes, places = [], []
    scale = np.sqrt(mean_square(data, joint))
    for lack, rec in zip(lacking(data, model, joint, band), data.records, strict=True):
        record = rec[joint - 1]
        here = lack[kept(record, band)]
        window, seconds = np.hanning(len(here)), len(here) * record.sample_time
        power = np.abs(np.fft.rfft((here - here.mean()) * window)) ** 2
        level = median_filter(power, 2 * AROUND + 1, mode="nearest") / np.log(2)
        out = power[2:] / np.maximum(level[2:], 1e-300)
        peak = int(np.argmax(out))
        if len(out) * np.exp(-float(out[peak])) > CHANCE:
            return 0.0
        lines = power[peak : peak + 5].sum()
        sizes.append(float(np.sqrt(2 * lines / len(here) / (window**2).sum())) / scale)
        places.append(((peak + 2) / seconds, 2 / seconds))
    if max(f for f, _ in places) - min(f for f, _ in places) > max(d for _, d in places):
        return 0.0
    return float(np.median(sizes))
