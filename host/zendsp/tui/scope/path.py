"""A curve in the plane with equal scales on both axes: the path of a tip, or position against
velocity.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.strip import Strip
from textual.widget import Widget

from zendsp.tui.colours import trace_colours
from zendsp.tui.scope.raster import DOTS_X, DOTS_Y, braille, encode
from zendsp.tui.scope.ticks import label, ticks

Floats = npt.NDArray[np.float64]
GUTTER = 8


@dataclass(frozen=True)
class Curve:
    """Points; ``trace`` is the colour number, −1 is faint."""

    name: str
    xy: Floats  # (n, 2)
    trace: int = 0
    style: str = "line"  # joined by straight lines; or "dots", or "marks", which stand out of dots


def draw_line(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set the dots along a polyline given in dot coordinates; parts outside, and NaN, are left out.
    """
    rows, columns = dots.shape
    dx, dy = np.diff(x), np.diff(y)
    length = np.maximum(np.abs(dx), np.abs(dy))
    good = np.flatnonzero(np.isfinite(length))
    count = np.minimum(length[good], 4.0 * (rows + columns)).astype(np.int64) + 2
    segment = np.repeat(good, count)
    first = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(segment)) - first) / (np.repeat(count, count) - 1)
    _set(dots, x[segment] + share * dx[segment], y[segment] + share * dy[segment])


def draw_marks(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set a small cross about each point."""
    for right, up in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        _set(dots, x + right, y + up)


def _set(dots: npt.NDArray[np.bool_], x: Floats, y: Floats) -> None:
    """Set the dots nearest to some points; what is outside, and NaN, is left out."""
    rows, columns = dots.shape
    seen = np.isfinite(x) & np.isfinite(y)
    at_x, at_y = np.rint(x[seen]), np.rint(y[seen])
    inside = (at_x >= 0) & (at_x < columns) & (at_y >= 0) & (at_y < rows)
    dots[at_y[inside].astype(np.int64), at_x[inside].astype(np.int64)] = True


DRAWN = {"line": draw_line, "dots": _set, "marks": draw_marks}


@dataclass(frozen=True)
class Axes:
    """How curves are framed."""

    names: tuple[str, str] = ("x [m]", "y [m]")
    equal: bool = True  # scales of both axes are the same, so that a circle is round
    title: str = ""
    frame: tuple[float, float, float, float] | None = None  # x0, x1, y0, y1; else all that there is
    log: bool = False  # y are powers of ten


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
        self.app.theme_changed_signal.subscribe(
            self, lambda _: self.show(self._curves, self._axes)
        )

    def _frame(self, width: int, height: int) -> tuple[float, float, float, float]:
        """Return x0, x1, y0, y1 that hold every curve."""
        if self._axes.frame is not None:
            return self._axes.frame
        low, high = extent(self._curves)
        middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0 * 1.08, 1e-12)
        # a braille dot is square in most fonts: two by four in a cell of one by two
        if self._axes.equal:
            scale = max(half[0] / (width * DOTS_X), half[1] / (height * DOTS_Y))
            half = np.array([scale * width * DOTS_X, scale * height * DOTS_Y])
        return middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1]

    def _draw(self) -> None:
        width, height = max(self.size.width - GUTTER, 2), max(self.size.height - 2, 1)
        x0, x1, y0, y1 = self._frame(width, height)
        colours = trace_colours(self.app.current_theme)
        back = Style(bgcolor=self.background_colors[1].rich_color)
        faint = back + Style(color=colours.grid)
        codes = np.zeros((height, width), dtype=np.uint8)
        owner = np.full((height, width), -1)
        for curve in self._in_order():
            dots = np.zeros((height * DOTS_Y, width * DOTS_X), dtype=bool)
            x = (curve.xy[:, 0] - x0) / (x1 - x0) * (width * DOTS_X - 1)
            y = (y1 - curve.xy[:, 1]) / (y1 - y0) * (height * DOTS_Y - 1)
            DRAWN[curve.style](dots, x, y)
            cells = encode(dots)
            codes |= cells
            owner[cells > 0] = curve.trace
        y_ticks = {
            int((y1 - v) / (y1 - y0) * height): v for v in ticks(y0, y1, max(height // 4, 4))
        }
        x_ticks = ticks(x0, x1, max(width // 12, 4))
        names = self._axes.names
        legend = [Segment(f" {names[1]}".ljust(GUTTER), faint)]
        if self._axes.title:
            legend.append(Segment(f" {self._axes.title} ", back + Style(bold=True)))
        for c in self._curves:
            if c.name:
                legend.append(
                    Segment(
                        f" ▐ {c.name} ",
                        faint if c.trace < 0 else back + Style(color=colours.traces[c.trace]),
                    )
                )
        lines = [Strip(legend).adjust_cell_length(self.size.width, back)]
        step = abs(x_ticks[1] - x_ticks[0]) if len(x_ticks) > 1 else 1.0
        values = list(y_ticks.values())
        step_y = abs(values[1] - values[0]) if len(values) > 1 else 1.0
        for r in range(height):
            text = self._y_label(y_ticks[r], step_y) if r in y_ticks else ""
            row = braille(codes[r])
            borders = [0, *(np.flatnonzero(owner[r][1:] != owner[r][:-1]) + 1).tolist(), width]
            parts = [Segment(text.rjust(GUTTER - 1)[: GUTTER - 1] + "▏", faint)]
            for a, b in itertools.pairwise(borders):
                k = int(owner[r][a])
                parts.append(
                    Segment(row[a:b], faint if k < 0 else back + Style(color=colours.traces[k]))
                )
            lines.append(Strip(parts, self.size.width))
        axis = [" "] * (self.size.width - len(names[0]) - 1)
        for v in x_ticks:
            text = label(v, step)
            at = GUTTER + int((v - x0) / (x1 - x0) * width) - len(text) // 2
            if at >= GUTTER - 2 and at + len(text) <= len(axis):
                axis[at : at + len(text)] = list(text)
        lines.append(
            Strip([Segment("".join(axis) + names[0], faint)]).adjust_cell_length(
                self.size.width, back
            )
        )
        self._lines = lines

    def _in_order(self) -> list[Curve]:
        """From the faint ones up; a line over the marks, the marks over the dots."""
        level = {"dots": 0, "marks": 1, "line": 2}
        return sorted(self._curves, key=lambda c: (c.trace >= 0, level[c.style], c.trace))

    def _y_label(self, value: float, step: float) -> str:
        if not self._axes.log:
            return label(value, step)
        return f"{10.0**value:.1e}".replace("e-0", "e-").replace("e+0", "e").replace(".0", "")

    def render_line(self, y: int) -> Strip:
        if not self._lines and self.size.width > GUTTER + 8 and self.size.height > 2:
            self._draw()
        return self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width)


def extent(curves: Sequence[Curve]) -> tuple[Floats, Floats]:
    """Return the lower left and upper right corner of all points."""
    points = np.concatenate([c.xy for c in curves]) if curves else np.zeros((1, 2))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        points = np.zeros((1, 2))
    return points.min(axis=0), points.max(axis=0)
