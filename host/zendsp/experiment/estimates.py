"""Estimates whose uncertainties hold: value ± 1.96 standard deviations covers the truth 95 times of
100, however few measurements there were (`benchmarks/experiments.py` counts it).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from zendsp.experiment.result import Estimate
from zendsp.physics.kernel.smooth import polynomial

Array = npt.NDArray[np.float64]
NORMAL = 1.96  # half width of 95 % in standard deviations
FITTED = 1e-8  # of what is left of a row, and less: it says nothing, the fit goes through it


def smoothed(
    x: Array, window: int, sample_time: float = 1.0, order: int = 0, *, degree: int = 2,
    ends: Literal["interp", "wrap"] = "interp",
) -> Array:
    """A signal, or its derivative of an order, from the polynomial through ``window`` samples
    around each sample (Savitzky and Golay 1964), along time; (n,) or (n, joints).
    """
    return polynomial(x, window, degree, order, sample_time, ends)


def bump_means(x: Array, sample_time: float) -> tuple[float, float, float]:
    """Means of a signal, its rate and its second derivative over one piece.

    They are weighted by a bump w that is flat at both ends, so that means of derivatives are those
    of the signal under -w' and w'': no noise is differentiated (integration by parts). The order of
    the bump makes sums over samples integrals, to 5e-5 for 41 samples and 1e-6 for 101.
    """
    n = len(x)
    s = np.linspace(-1.0, 1.0, n)
    w, dw = (1 - s**2) ** 5, -10 * s * (1 - s**2) ** 4
    ddw = -10 * (1 - s**2) ** 4 + 80 * s**2 * (1 - s**2) ** 3
    ddw -= w * (ddw.sum() / w.sum())  # a constant has no second derivative
    per = 2.0 / ((n - 1) * sample_time)  # ds/dt
    here, total = x - x[0], w.sum()
    return (
        float(x[0] + w @ here / total),
        float(-per * (dw @ here) / total),
        float(per**2 * (ddw @ here) / total),
    )


def half_width(std: float | Array, free: float) -> Array:
    """Half width of the 95 % interval (Student) of an estimate with ``free`` degrees of freedom."""
    from scipy.special import stdtrit  # scipy.stats would take a second to import

    return np.asarray(std) * (stdtrit(free, 0.975) if free > 0 else np.inf)


def mean_of(
    values: Sequence[float], unit: str, systematic: float = 0.0, beside: Sequence[float] = ()
) -> Estimate:
    """The mean of repeated measurements, with its standard deviation.

    Parameters
    ----------
    values : sequence of float
        At least two.
    systematic : float
        Standard deviation of what all of them share and their spread does not show.
    beside : sequence of float
        Others, of another mean, that scatter in the same proportion to it.
    """
    mean = float(np.mean(values))
    squares, free = float(np.sum((np.asarray(values) - mean) ** 2)), len(values) - 1
    if len(beside):
        other = np.asarray(beside) * (mean / float(np.mean(beside)))
        squares, free = squares + float(np.sum((other - mean) ** 2)), free + len(beside) - 1
    half = float(half_width(float(np.sqrt(squares / free / len(values))), free))
    return Estimate(mean, float(np.hypot(half / NORMAL, systematic)), unit)


def least_squares(A: Array, b: Array) -> tuple[Array, Array, Array]:
    """Solution of A x = b, 95 % half widths, and the covariance over the residual's variance."""
    solution = np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], np.float64)
    free = len(b) - A.shape[1]
    inverse = np.asarray(np.linalg.inv(A.T @ A), np.float64)
    if free < 1:
        return solution, np.full(A.shape[1], np.inf), inverse
    variance = float(np.sum((b - A @ solution) ** 2)) / free
    return solution, half_width(np.sqrt(variance * np.diag(inverse)), free), inverse


def widest(
    A: Array,
    left: Array,
    inverse: Array,
    ways: Array,
    alike: Sequence[tuple[npt.NDArray[np.int64], int]],
) -> Array:
    """95 % half widths of combinations (rows of ``ways``) of a least-squares solution.

    Each is the larger of two: that for independent rows, and that for rows which are alike in
    groups (Liang and Zeger 1986). ``alike`` has, for each way of grouping, the group of each row
    and the degrees of freedom of that many groups.
    """
    free = len(left) - A.shape[1]
    plain = np.sum(ways @ inverse * ways, axis=1) * float(left @ left) / max(free, 1)
    out = half_width(np.sqrt(plain), free)
    scores = A * left[:, None]
    for group, free in alike:
        names = np.unique(group)
        sums = ways @ inverse @ np.stack([scores[group == k].sum(axis=0) for k in names], axis=1)
        std = np.sqrt(np.sum(sums**2, axis=1) * len(names) / max(free, 1))
        out = np.maximum(out, half_width(std, free))
    return np.asarray(out)


def widest_of_few(
    A: Array,
    left: Array,
    inverse: Array,
    ways: Array,
    alike: Sequence[npt.NDArray[np.int64]],
) -> Array:
    """`widest` of a few groups: what is left of each is made as large as the fit made it small, and
    the degrees of freedom are those of the groups' own leverages (Bell and McCaffrey 2002). Those
    of `widest` are alike for all that is asked for: of a line of 12 groups 92 % of the intervals of
    slopes hold then, and 99 % of those of levels.
    """
    n = len(left)
    out = widest(A, left, inverse, ways, [])
    rest = np.eye(n) - A @ inverse @ A.T
    for group in alike:
        sums, shapes = [], []
        for rows in (group == k for k in np.unique(group)):
            size, turn = np.linalg.eigh(rest[np.ix_(rows, rows)])
            grown = np.where(size > FITTED, np.maximum(size, FITTED) ** -0.5, 0.0)
            told = (turn * grown) @ turn.T @ A[rows] @ inverse @ ways.T
            sums.append(left[rows] @ told)
            shapes.append(rest[:, rows] @ told)
        std = np.linalg.norm(sums, axis=0)
        for k in np.flatnonzero(std):
            shape = np.stack([x[:, k] for x in shapes])
            spread = shape @ shape.T
            free = float(np.trace(spread)) ** 2 / float(np.sum(spread**2))
            out[k] = max(out[k], float(half_width(std[k], free)))
    return out


def line_fit(speed: Array, torque: Array) -> tuple[Array, Array, float]:
    """|torque| = level + viscous |speed|: both coefficients, their 95 % half widths, and their
    correlation.
    """
    A = np.stack([np.ones(len(speed)), np.abs(speed)], axis=1)
    solution, half, inverse = least_squares(A, np.abs(torque))
    correlation = float(inverse[0, 1] / np.sqrt(inverse[0, 0] * inverse[1, 1]))
    return solution, half, correlation
