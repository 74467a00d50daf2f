"""Phases with which a sum of sines has small peaks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.reference.core import Array

SWAPS = 300  # rounds; the best seen is kept


def crest_factor(x: Array) -> float:
    """Largest magnitude over root mean square; 1.414 for a sine.

    Parameters
    ----------
    x : ndarray, shape (N,)

    Returns
    -------
    float

    Examples
    --------
    >>> import numpy as np
    >>> round(crest_factor(np.sin(2 * np.pi * np.arange(1000) / 1000)), 3)
    1.414
    """
    return float(np.max(np.abs(x)) / np.sqrt(np.mean(x**2)))


def low_crest_phases(lines: npt.NDArray[np.int64], amplitudes: Array) -> Array:
    """Phases of a multisine that keep its peaks low.

    Schroeder's phases first (Schroeder 1970), then time–frequency swapping (Van der Ouderaa,
    Schoukens, Renneboog 1988): clip the signal a little below its peak, keep the phases of what
    that gives, restore the amplitudes, repeat. Schroeder: phi_n = -2 pi sum_{l<n} (n - l) p_l, with
    p_l the share of line l in the power.

    Parameters
    ----------
    lines : ndarray of int, shape (F,)
        Harmonic numbers, each at least 1.
    amplitudes : ndarray, shape (F,)
        Amplitude of each line.

    Returns
    -------
    ndarray, shape (F,)
        Phases of cosines, rad: the best seen.

    Examples
    --------
    >>> import numpy as np
    >>> lines = np.arange(1, 21)
    >>> phases = low_crest_phases(lines, np.ones(20))
    >>> x = np.cos(2 * np.pi * np.outer(np.arange(1000) / 1000, lines) + phases).sum(axis=1)
    >>> crest_factor(x) < 1.6
    True
    """
    share = amplitudes**2 / np.sum(amplitudes**2)
    index = np.arange(len(lines))
    phases = -2 * np.pi * np.array([np.sum((n - index[:n]) * share[:n]) for n in index])
    points = 2 ** int(np.ceil(np.log2(16 * lines[-1])))
    best, lowest = phases, np.inf
    for swap in range(SWAPS):
        spectrum = np.zeros(points // 2 + 1, dtype=np.complex128)
        spectrum[lines] = 0.5 * points * amplitudes * np.exp(1j * phases)
        x = np.fft.irfft(spectrum, points)
        crest = crest_factor(x)
        if crest < lowest:
            best, lowest = phases, crest
        level = (0.75 + 0.22 * swap / SWAPS) * np.max(np.abs(x))
        phases = np.asarray(
            np.angle(np.fft.rfft(np.clip(x, -level, level))[lines]), dtype=np.float64
        )
    return np.asarray(best)
