"""Where a torque that a model lacks acts: its energy over an observer's memory, and the times at
which that is far above a median.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.discrepancy import correction_lag, kept, lacking
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.kernel.smooth import widened
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

LACKING_BAND = 32.0  # rad/s, of the observer that shows the missing torque
BURST, OF_PEAK = 10.0, 0.05  # times the median energy, and of the largest: a burst has more


@dataclass(frozen=True)
class Lacking:
    """The missing torque of a joint: per recording its energy over the observer's memory (n,), the
    torque, the same by counts of the sensor, the torque smoothed over that memory, and the samples
    that count.
    """

    data: Data
    levels: tuple[Array, ...]
    lacks: tuple[Array, ...]
    counted: tuple[Array, ...]
    smooth: tuple[Array, ...]
    used: tuple[slice, ...]


@dataclass(frozen=True)
class Acting:
    """Where a missing torque is large: per recording a mask (n,). ``least``: the energy above which
    it is.
    """

    of: Lacking
    masks: tuple[npt.NDArray[np.bool_], ...]
    least: float


def lacks_of(data: Data, model: Model, joint: int) -> Lacking:
    """The missing torque of a model along recordings."""
    levels: list[Array] = []
    lacks: list[Array] = []
    counted: list[Array] = []
    smooth: list[Array] = []
    used = []
    for lack, rec in zip(lacking(data, model, joint, LACKING_BAND), data.records, strict=True):
        record = rec[joint - 1]
        use = kept(record, LACKING_BAND)
        width = max(3, round(3.0 / LACKING_BAND / record.sample_time))
        window = np.ones(width) / width
        levels.append(np.asarray(np.convolve(lack**2, window, mode="same")[use], float))
        lacks.append(lack[use])
        counted.append(_by_count(lack, record, width)[use])
        smooth.append(np.asarray(np.convolve(lack[use], window, mode="same"), float))
        used.append(use)
    return Lacking(
        data, tuple(levels), tuple(lacks), tuple(counted), tuple(smooth), tuple(used)
    )


def _by_count(lack: Array, record: JointRecord, most: int) -> Array:
    """A torque, (n,), N m or N, as its mean over the time between two counts of the sensor, over
    ``most`` samples at most. Where a joint takes several samples for a count, the observer corrects
    the model in one of them: these spikes would pass for ringing.
    """
    lag = correction_lag(record, LACKING_BAND)
    counts = np.flatnonzero(np.diff(record.position)) + 1 - lag
    begins = np.unique(np.r_[0, counts[counts > 0]])
    sizes = np.diff(begins, append=len(lack))
    long = zip(begins[sizes > most], sizes[sizes > most], strict=True)
    within = [np.arange(a + most, a + n, most) for a, n in long]
    begins = np.sort(np.concatenate([begins, *within]))
    sizes = np.diff(begins, append=len(lack))
    return np.repeat(np.add.reduceat(lack, begins) / sizes, sizes)


def quiet_energy(parts: Sequence[Lacking]) -> float:
    """The median energy in the quietest part of the data; a push may fill most of the others."""
    return min(float(np.median(np.concatenate(part.levels))) for part in parts)


def acting_of(part: Lacking, joint: int, quiet: float, least: float | None = None) -> Acting:
    """The samples at which the energy of the missing torque is far above a median, and above
    ``least`` or, without it, a part of its own peak.
    """
    peak = max(float(level.max()) for level in part.levels)
    above = max(BURST * quiet, OF_PEAK * peak if least is None else least)
    masks = []
    for level, rec in zip(part.levels, part.data.records, strict=True):
        gap = max(1, round(0.25 / rec[joint - 1].sample_time))
        # gaps between are filled, and nothing is lost at the ends of a recording
        high = widened(np.pad(level > above, 2 * gap), gap)
        masks.append(~widened(~high, gap)[2 * gap : -2 * gap])
    return Acting(part, tuple(masks), above)


def largest(within: Array) -> float:
    """A high quantile of the energy; the very largest is ringing of the observer at the edges."""
    return float(np.quantile(np.abs(within), 0.95)) if len(within) else 0.0


def peak_of(acting: Acting) -> float:
    """The largest acting torque, N m or N."""
    parts = zip(acting.of.smooth, acting.masks, strict=True)
    return largest(np.concatenate([smooth[high] for smooth, high in parts]))
