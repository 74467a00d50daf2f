"""Amplitude spectral density of what the scope shows."""

from __future__ import annotations

import threading

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
LEAST = 32  # rows below which there is no spectrum worth the name
PIECES = 4  # of the picture to average over; each overlaps the next by half


_loading: list[threading.Thread] = []


def ready() -> bool:
    """Whether a spectrum can be computed at once. If not, SciPy is loaded in the background.

    That takes half a second, on a busy computer many: the screen must not stand still.
    """
    if not _loading:
        _loading.append(threading.Thread(target=_load, name="spectrum", daemon=True))
        _loading[0].start()
    return not _loading[0].is_alive()


def _load() -> None:
    import scipy.signal  # noqa: F401


def density(t: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Frequencies and amplitude spectral densities, by Welch's method.

    Rows that never arrived leave a gap; the longest part without a gap is used. The mean of each
    segment is removed; segments are weighted by a Hann window and overlap by half.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s, evenly spaced but for gaps.
    y : ndarray, shape (n, channels)

    Returns
    -------
    f : ndarray, shape (m,)
        Hz, above zero.
    amplitude : ndarray, shape (m, channels)
        Unit of the channel per √Hz: the square root of the one-sided power spectral density. Both
        are empty where there is too little.
    """
    seen = np.isfinite(y)
    silent = ~seen.any(axis=0)  # a curve without any value must not hide the others
    part = _longest(np.asarray(seen.any(axis=1) & (seen | silent).all(axis=1)))
    t, y = t[part], y[part]
    nothing = np.zeros(0), np.zeros((0, y.shape[1]))
    if len(t) < LEAST or not t[-1] > t[0]:
        return nothing
    from scipy.signal import welch

    rate = (len(t) - 1) / float(t[-1] - t[0])
    piece = max(LEAST, 2 * len(t) // (PIECES + 1))
    f, power = welch(y, fs=rate, nperseg=piece, detrend="constant", axis=0)
    return np.asarray(f[1:]), np.sqrt(np.asarray(power[1:]))


def _longest(good: npt.NDArray[np.bool_]) -> slice:
    """The longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], good, [False])).astype(np.int8)))
    if len(edges) == 0:
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    return slice(int(begins[k]), int(ends[k]))
