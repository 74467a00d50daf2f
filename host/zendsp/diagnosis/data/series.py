"""The number of independent samples in a correlated series, and the stretches of a mask."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

WITHIN = 0.25  # s: longest lag of the correlation


def repeats(r: npt.NDArray[np.float64], sample_time: float) -> float:
    """The number of samples that count as one independent sample, 1 or more, from the correlation
    within 0.25 s.
    """
    most = min(len(r) // 4, round(WITHIN / sample_time))
    energy = float(r @ r)
    if most < 2 or energy <= 0:
        return 1.0
    size = 1 << int(np.ceil(np.log2(2 * len(r))))
    correlation = np.fft.irfft(np.abs(np.fft.rfft(r, size)) ** 2, size)[1:most] / energy
    end = int(np.argmax(correlation < 0)) if (correlation < 0).any() else len(correlation)
    return max(1.0, 1.0 + 2.0 * float(np.sum(correlation[:end])))


def stretches(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The stretches of a mask, (n,), that hold: first sample, and the one after the last.

    Examples
    --------
    >>> stretches(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    change = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int))).tolist()
    return list(zip(change[::2], change[1::2], strict=True))
