"""Time laws that the generators share: rest to rest along a path, and velocity made of straight
lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array

Law = Literal["quintic", "trapezoid"]


def make_grid(duration: float, sample_time: float) -> Array:
    """Times 0, sample_time, … up to the first sample at or after duration, s.

    Examples
    --------
    >>> make_grid(0.3, 0.1).round(3).tolist()
    [0.0, 0.1, 0.2, 0.3]
    """
    if not duration > 0.0:
        raise ReferenceError_(f"duration is {duration} s; it must be positive")
    # 1e-9 of a sample: 0.3 / 0.1 is 2.9999999999999996, and must not add a sample
    return np.arange(math.ceil(duration / sample_time - 1e-9) + 1, dtype=np.float64) * sample_time


def rest_to_rest(
    t: Array, duration: float, law: Law, blend: float = 0.25
) -> tuple[Array, Array, Array]:
    """Path fraction s from 0 to 1, at rest at both ends, with its first two derivatives.

    quintic: s = 10 x^3 - 15 x^4 + 6 x^5, x = t/duration (minimum jerk; Flash and Hogan 1985).
    trapezoid: constant acceleration over ``blend``·duration, cruise, the same deceleration.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times, s; s stays at 0 before and at 1 after.
    duration : float
        s.
    law : {"quintic", "trapezoid"}
        Time law.
    blend : float
        Share of the duration for each ramp of the trapezoid, 0 to 0.5.

    Returns
    -------
    s, sd, sdd : ndarray, shape (N,)
        1, 1/s, 1/s^2.

    Examples
    --------
    >>> import numpy as np
    >>> s, sd, sdd = rest_to_rest(np.array([0.0, 0.5, 1.0]), 1.0, "quintic")
    >>> s.tolist(), sd.tolist()
    ([0.0, 0.5, 1.0], [0.0, 1.875, 0.0])
    """
    if law == "trapezoid":
        if not 0.0 < blend <= 0.5:
            raise ReferenceError_(
                f"blend is {blend}; a trapezoid ramps over more than 0 and at most 0.5 of its"
                " duration"
            )
        ramp = blend * duration
        speed = 1.0 / (duration - ramp)
        return integrate_velocity(
            t, [0.0, ramp, duration - ramp, duration], [0.0, speed, speed, 0.0]
        )
    if law != "quintic":
        raise ReferenceError_(f'time law "{law}" is unknown; expected "quintic" or "trapezoid"')
    x = np.clip(t / duration, 0.0, 1.0)
    s = x**3 * (10 - 15 * x + 6 * x**2)
    sd = 30 * x**2 * (1 - x) ** 2 / duration
    sdd = 60 * x * (1 - x) * (1 - 2 * x) / duration**2
    return s, sd, sdd


def integrate_velocity(
    t: Array, knots: Sequence[float], speeds: Sequence[float]
) -> tuple[Array, Array, Array]:
    """Exact position, velocity and acceleration of a velocity that is straight between knots.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times, s; before the first and after the last knot nothing moves.
    knots : sequence of float
        Increasing times, s.
    speeds : sequence of float
        Velocity at each knot; the first and last should be 0.

    Returns
    -------
    x, v, a : ndarray, shape (N,)
        Position from 0, velocity, acceleration (of the segment that begins at the sample).

    Examples
    --------
    >>> import numpy as np
    >>> x, v, a = integrate_velocity(np.array([0.0, 1.0, 2.0]), [0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
    >>> x.tolist(), v.tolist(), a.tolist()
    ([0.0, 0.5, 1.0], [0.0, 1.0, 0.0], [1.0, -1.0, 0.0])
    """
    k, w = np.asarray(knots, dtype=np.float64), np.asarray(speeds, dtype=np.float64)
    if np.any(np.diff(k) < -1e-9):
        early = int(np.argmin(np.diff(k)))
        raise ReferenceError_(
            f"velocity knots are not in order of time: {k[early]:g} s is followed by"
            f" {k[early + 1]:g} s"
        )
    k = np.maximum.accumulate(k)
    # a ramp of no length (a triangle's cruise) is dropped
    keep = np.concatenate([[True], np.diff(k) > 1e-12])
    k, w = k[keep], w[keep]
    slope = np.diff(w) / np.diff(k)
    start = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(k))])
    inside = np.clip(t, k[0], k[-1])
    # 1e-9 s: a sample that falls on a knot but for rounding belongs to the segment that begins
    # there
    i = np.clip(np.searchsorted(k, inside + 1e-9, side="right") - 1, 0, len(slope) - 1)
    h = inside - k[i]
    moving = (t >= k[0]) & (t < k[-1] - 1e-9)
    x = start[i] + w[i] * h + 0.5 * slope[i] * h**2
    return x, np.where(moving, w[i] + slope[i] * h, 0.0), np.where(moving, slope[i], 0.0)


def fade(t: Array, duration: float, ramp: float) -> tuple[Array, Array, Array]:
    """Window that rises from 0 to 1 over ``ramp`` seconds, stays, and falls again, with two
    derivatives.

    Examples
    --------
    >>> import numpy as np
    >>> fade(np.array([0.0, 0.5, 1.0]), 1.0, 0.2)[0].tolist()
    [0.0, 1.0, 0.0]
    """
    if ramp <= 0.0:
        one = np.ones_like(t)
        return one, 0.0 * one, 0.0 * one
    if 2.0 * ramp > duration:
        raise ReferenceError_(
            f"fade of {ramp} s at each end does not fit into {duration} s; at most"
            f" {duration / 2:.4g} s"
        )
    rise, rise_d, rise_dd = rest_to_rest(t, ramp, "quintic")
    fall, fall_d, fall_dd = rest_to_rest(duration - t, ramp, "quintic")
    first = t < duration / 2
    return (
        np.where(first, rise, fall),
        np.where(first, rise_d, -fall_d),
        np.where(first, rise_dd, fall_dd),
    )
