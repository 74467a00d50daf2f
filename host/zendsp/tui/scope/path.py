"""A curve in the plane, with equal scales on both axes: the path of a tip, or velocity over
position.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.strip import Strip
from textual.widget import Widget

from zendsp.tui.colours import TraceColours, trace_colours
from zendsp.tui.scope.raster import DOTS_X, DOTS_Y, braille, encode
from zendsp.tui.scope.ticks import beside, label, log_ticks, ticks

Floats = npt.NDArray[np.float64]
GUTTER = 9
LEAST_FOR_NAME = 8  # lines of a plot that has one for the name of its x axis


@dataclass(frozen=True)
class Curve:
    """The points of a curve; ``trace`` is its colour number, −1 is faint."""

    name: str
    xy: Floats  # (n, 2)
    trace: int = 0
    style: str = "line"  # joined by straight lines; or "dots", or "marks", which stand out of dots


def draw_line(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set the dots along a polyline given in dot coordinates. Parts outside, and NaN, are left out.
    """
    rows, columns = dots.shape
    x, y = _moving(x, y)
    dx, dy = np.diff(x), np.diff(y)
    length = np.maximum(np.abs(dx), np.abs(dy))
    good = np.flatnonzero(np.isfinite(length))
    count = np.minimum(length[good], 4.0 * (rows + columns)).astype(np.int64) + 2
    segment = np.repeat(good, count)
    first = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(segment)) - first) / (np.repeat(count, count) - 1)
    _set(dots, x[segment] + share * dx[segment], y[segment] + share * dy[segment])


def _moving(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The points that fall on another dot than the one before; on a slow path most do not."""
    moves = (np.diff(np.rint(x)) != 0.0) | (np.diff(np.rint(y)) != 0.0)  # NaN is not zero either
    kept = np.ones(len(x), dtype=bool)
    kept[1:] = moves
    kept[-1:] = True
    return x[kept], y[kept]


def draw_marks(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set a small cross about each point."""
    for right, up in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        _set(dots, x + right, y + up)


def _set(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set the dots nearest to the points; those outside, and NaN, are left out."""
    rows, columns = dots.shape
    seen = np.isfinite(x) & np.isfinite(y)
    at_x, at_y = np.rint(x[seen]), np.rint(y[seen])
    inside = (at_x >= 0) & (at_x < columns) & (at_y >= 0) & (at_y < rows)
    dots[at_y[inside].astype(np.int64), at_x[inside].astype(np.int64)] = True


DRAWN = {"line": draw_line, "dots": _set, "marks": draw_marks}


@dataclass(frozen=True)
class Axes:
    """The axes around curves: names, limits and scales."""

    names: tuple[str, str] = ("x [m]", "y [m]")
    equal: bool = True  # scales of both axes are the same, so that a circle is round
    title: str = ""
    frame: tuple[float, float, float, float] | None = None  # x0, x1, y0, y1; else all that there is
    log: bool = False  # y are powers of ten
    log_x: bool = False  # x are powers of ten



def plot_lines(
    curves: Sequence[Curve], axes: Axes, size: tuple[int, int], pens: TraceColours, back: Style
) -> list[Strip]:
    """The lines of a plot in the plane, with a legend above and both axes.

    Parameters
    ----------
    size : (width, height)
        Of everything, in characters.
    back : Style
        Of the background.

    Returns
    -------
    list of Strip
        From top to bottom, ``height`` of them.
    """
    full, tall = size
    width = max(full - GUTTER, 2)
    for below in (1, 2):  # lines
        height = max(tall - 1 - below, 1)
        x0, x1, y0, y1 = _frame(curves, axes, width, height)
        feet = _x_axis(axes, (x0, x1), width, full)
        if len(feet) <= below or tall < LEAST_FOR_NAME:
            break
    faint = back + Style(color=pens.grid)
    codes = np.zeros((height, width), dtype=np.uint8)
    owner = np.full((height, width), -1)
    for curve in _in_order(curves):
        dots = np.zeros((height * DOTS_Y, width * DOTS_X), dtype=bool)
        x = (curve.xy[:, 0] - x0) / (x1 - x0) * (width * DOTS_X - 1)
        y = (y1 - curve.xy[:, 1]) / (y1 - y0) * (height * DOTS_Y - 1)
        DRAWN[curve.style](dots, x, y)
        cells = encode(dots)
        codes |= cells
        owner[cells > 0] = curve.trace

    def pen(trace: int) -> Style:
        return faint if trace < 0 else back + Style(color=pens.traces[trace])

    lines = [Strip(_legend(curves, axes, pen, faint, full)).adjust_cell_length(full, back)]
    y_ticks = {
        int((y1 - v) / (y1 - y0) * height): text
        for v, text in _numbers(y0, y1, max(height // 4, 4), axes.log)
    }
    for r in range(height):
        text = y_ticks.get(r, "")
        row = braille(codes[r])
        borders = [0, *(np.flatnonzero(owner[r][1:] != owner[r][:-1]) + 1).tolist(), width]
        parts = [Segment(beside(text, GUTTER - 1) + "▏", faint)]
        parts += [Segment(row[a:b], pen(int(owner[r][a]))) for a, b in itertools.pairwise(borders)]
        lines.append(Strip(parts, full))
    feet = [*feet, ""][:below]
    lines += [Strip([Segment(foot, faint)]).adjust_cell_length(full, back) for foot in feet]
    return lines


def _legend(
    curves: Sequence[Curve], axes: Axes, pen: Callable[[int], Style], faint: Style, full: int
) -> list[Segment]:
    """The name of the y axis, the title and the names of the curves, each cut where there is no
    room for all.
    """
    above = f" {axes.names[1]}".ljust(GUTTER)
    title = f" {axes.title} " if axes.title else ""
    named = [c for c in curves if c.name]
    room = max(full - len(above) - len(title), 0)
    most = room // max(len(named), 1) - len(" ▐  ")
    if sum(len(f" ▐ {c.name} ") for c in named) <= room:
        most = room
    parts = [Segment(above, faint)]
    if title:
        parts.append(Segment(title, Style(bgcolor=faint.bgcolor, bold=True)))
    for c in named:
        name = c.name if len(c.name) <= most else f"{c.name[: max(most - 1, 0)]}…"
        parts.append(Segment(f" ▐ {name} ", pen(c.trace)))
    return parts


def _x_axis(axes: Axes, ends: tuple[float, float], width: int, full: int) -> list[str]:
    """The numbers below the plot, with the name of the axis after the last one or on a second line.
    """
    x0, x1 = ends
    line = [" "] * full
    for v, text in _numbers(x0, x1, max(width // 12, 4), axes.log_x):
        at = GUTTER + int((v - x0) / (x1 - x0) * width) - len(text) // 2
        if at >= GUTTER - 2 and at + len(text) <= len(line):
            line[at : at + len(text)] = list(text)
    numbers, name = "".join(line).rstrip(), axes.names[0]
    if len(numbers) + 1 + len(name) <= full:
        return [numbers + name.rjust(full - len(numbers))]
    return [numbers, name.rjust(full)]


def _frame(
    curves: Sequence[Curve], axes: Axes, width: int, height: int
) -> tuple[float, float, float, float]:
    """The limits x0, x1, y0, y1 within which all curves lie."""
    if axes.frame is not None:
        return axes.frame
    low, high = extent(curves)
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0 * 1.08, 1e-12)
    # a braille dot is square in most fonts: two by four in a cell of one by two
    if axes.equal:
        scale = max(half[0] / (width * DOTS_X), half[1] / (height * DOTS_Y))
        half = np.array([scale * width * DOTS_X, scale * height * DOTS_Y])
    return middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1]


def _in_order(curves: Sequence[Curve]) -> list[Curve]:
    """The curves in the order of drawing: faint ones first; dots, then marks, then lines."""
    level = {"dots": 0, "marks": 1, "line": 2}
    return sorted(curves, key=lambda c: (c.trace >= 0, level[c.style], c.trace))


def _numbers(bottom: float, top: float, most: int, log: bool) -> list[tuple[float, str]]:
    """The positions and the texts of an axis's numbers."""
    if log:
        return [(v, _power(10.0**v)) for v in log_ticks(bottom, top, most)]
    values = ticks(bottom, top, most)
    step = abs(values[1] - values[0]) if len(values) > 1 else 1.0
    return [(v, label(v, step)) for v in values]


def _power(value: float) -> str:
    if 1e-3 <= value < 1e5:
        return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"
    return f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e").replace(".0", "")


class PathPlot(Widget):
    """Curves in the plane."""

    DEFAULT_CSS = "PathPlot { height: 1fr; }"

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._curves: tuple[Curve, ...] = ()
        self._axes = Axes()
        self._lines: list[Strip] = []

    @property
    def curves(self) -> tuple[Curve, ...]:
        """What is drawn."""
        return self._curves

    def show(self, curves: Sequence[Curve], axes: Axes | None = None) -> None:
        """Draw other curves."""
        self._curves, self._axes = tuple(curves), axes or Axes()
        self._lines = []
        self.refresh()

    def on_resize(self, event: events.Resize) -> None:
        self._lines = []

    def on_mount(self) -> None:
        self.app.theme_changed_signal.subscribe(self, lambda _: self.show(self._curves, self._axes))

    def _draw(self) -> None:
        back = Style(bgcolor=self.background_colors[1].rich_color)
        colours = trace_colours(self.app.current_theme)
        size = (self.size.width, self.size.height)
        self._lines = plot_lines(self._curves, self._axes, size, colours, back)

    def render_line(self, y: int) -> Strip:
        if not self._lines and self.size.width > GUTTER + 8 and self.size.height > 2:
            self._draw()
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width, Style())


def extent(curves: Sequence[Curve]) -> tuple[Floats, Floats]:
    """The lower left and the upper right corner of all points."""
    points = np.concatenate([c.xy for c in curves]) if curves else np.zeros((1, 2))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        points = np.zeros((1, 2))
    return points.min(axis=0), points.max(axis=0)
