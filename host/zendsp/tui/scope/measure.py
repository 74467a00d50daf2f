"""Statistics between two cursors, as numbers and as the two lines below the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.tui.scope.picture import Picture
from zendsp.tui.scope.settings import Channel, ScopeSettings
from zendsp.tui.scope.ticks import duration, short

Floats = npt.NDArray[np.float64]
STEP_SHARE = 0.3  # of all that a curve does: a smaller way from A to B is no step
SETTLED_SHARE = 0.1  # of the way: the last tenth of a step moves no more than that


@dataclass(frozen=True)
class Measured:
    """Statistics of one curve between the cursors; NaN where there is nothing to measure."""

    mean: float = float("nan")
    rms: float = float("nan")
    deviation: float = float("nan")  # standard, about the mean
    low: float = float("nan")
    high: float = float("nan")
    rise: float = float("nan")  # s from 10 to 90 % of the step from A to B
    overshoot: float = float("nan")  # beyond the end, as a part of the step


def measure(t: Floats, y: Floats, a: float, b: float) -> Measured:
    """The statistics of one curve between two times.

    Parameters
    ----------
    t : ndarray, shape (n,)
        s, increasing.
    y : ndarray, shape (n,)
        NaN where there is no value.
    a, b : float
        s, in either order.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> round(measure(t, 2.0 * t, 0.0, 1.0).mean, 9)
    1.0
    """
    a, b = min(a, b), max(a, b)
    inside = (t >= a) & (t <= b) & np.isfinite(y)
    if int(inside.sum()) < 2:
        return Measured()
    at, part = t[inside], y[inside]
    low, high = float(part.min()), float(part.max())
    rise, overshoot = _step(at, part, high - low)
    return Measured(
        float(part.mean()),
        float(np.sqrt(np.mean(part * part))),
        float(part.std()),
        low,
        high,
        rise,
        overshoot,
    )


def _step(t: Floats, y: Floats, reach: float) -> tuple[float, float]:
    """Rise time and overshoot, where the curve ends clearly away from where it began."""
    tenth = max(len(y) // 10, 1)
    begin, end = float(y[0]), float(y[-tenth:].mean())
    way = end - begin
    settled = float(np.ptp(y[-tenth:])) <= SETTLED_SHARE * abs(way)
    if reach == 0.0 or abs(way) < STEP_SHARE * reach or not settled:
        return float("nan"), float("nan")
    share = (y - begin) / way
    first = t[int(np.argmax(share >= 0.1))]
    last = t[int(np.argmax(share >= 0.9))]
    return float(last - first), float(max(share.max() - 1.0, 0.0))


def cursor_lines(
    picture: Picture, settings: ScopeSettings, channel: Channel, t: Floats, y: Floats, width: int
) -> tuple[str, str]:
    """Two lines on what the cursors measure of the selected channel: at each cursor, and between
    them. Numbers for which there is no room are left out whole.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Of the rows of the picture, s.
    y : ndarray, shape (n, channels)
    width : int
        Columns.
    """
    span, curve = picture.end - picture.start, y[:, settings.selected]
    a, b = (picture.start + share * span for share in (settings.cursor_a, settings.cursor_b))
    ya = yb = float("nan")
    if len(t):
        ya, yb = (float(np.interp(x, t, curve, left=np.nan, right=np.nan)) for x in (a, b))
    dt = b - a
    rate = f" = 1/{short(1.0 / abs(dt))} Hz" if dt else ""
    unit = f" {channel.unit}" if channel.unit else ""
    points = (
        f"{channel.name} Δy {short(yb - ya)}{unit}  A {short(a - picture.zero)} s {short(ya)}"
        f"  B {short(b - picture.zero)} s {short(yb)}"
    )
    at = f" Δt {duration(dt)}{rate}  {points}"
    if len(at) > width:
        at = whole_words(f" Δt {duration(dt)}  {points}", width)
    if not len(t):
        return at, ""
    found = measure(t, curve, a, b)
    between = (
        f" A…B mean {short(found.mean)}  rms {short(found.rms)}  σ {short(found.deviation)}"
    )
    if np.isfinite(found.rise):  # before what is left out first
        between += f"  rise {duration(found.rise)}  over {100.0 * found.overshoot:.3g} %"
    between += f"  {short(found.low)} … {short(found.high)}"
    return at, whole_words(between, width)


def whole_words(line: str, width: int) -> str:
    """The line without the items at its end that have no room. Items are separated by double
    blanks; a number is never cut, since it would be another number.
    """
    while len(line) > width and "  " in line.strip(" …"):
        line = f"{line.rstrip(' …').rpartition('  ')[0]} …"
    return line
