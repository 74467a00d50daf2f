"""Composes one picture of the scope (lanes, grid, curves, trigger and cursors) as arrays of cells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.tui.scope.raster import DOTS_X, DOTS_Y, encode, fill
from zendsp.tui.scope.settings import Channel, Scale, ScopeSettings
from zendsp.tui.scope.ticks import ticks

Floats = npt.NDArray[np.float64]
GRID, CURSOR, EMPTY, LIMIT = 100, 101, 102, 103  # owners of a cell beside the channel numbers 0 … 7
TICK = 8  # characters from one number of the time axis to the next, at the least
LOWEST_LANE = 4  # character rows below which lanes are drawn over one another


@dataclass(frozen=True)
class Lane:
    """A block of rows with one y axis."""

    key: str  # tells one lane from another: a unit, or the curve or number that has its own
    unit: str  # "" where its curves have several
    channels: tuple[int, ...]
    row: int  # first character row
    rows: int
    bottom: float = -1.0  # value at the lowest dot
    top: float = 1.0

    def at(self, value: float) -> float:
        """The character row (fractional) at which ``value`` is drawn."""
        return self.row + (self.top - value) / (self.top - self.bottom) * self.rows


@dataclass(frozen=True)
class Picture:
    """Cells of the plot area and what the axes need."""

    codes: npt.NDArray[np.uint8]  # (height, width) braille codes
    owner: npt.NDArray[np.int8]  # (height, width) channel number, or GRID, CURSOR, EMPTY
    lanes: tuple[Lane, ...]
    start: float  # s at the left border
    end: float
    zero: float  # time that the labels count from, s
    time_ticks: tuple[float, ...]


def blank(view: tuple[float, float, float]) -> Picture:
    """An empty picture, with its limits and zero in time."""
    codes = np.zeros((0, 0), dtype=np.uint8)
    return Picture(codes, codes.astype(np.int8), (), *view, ())


def arrange(channels: Sequence[Channel], settings: ScopeSettings, height: int) -> list[Lane]:
    """The lanes: one for each unit, or for each curve, where there is room; else one of the whole
    height.
    """
    groups: dict[str, list[int]] = {}
    for k, channel in enumerate(channels):
        groups.setdefault(_lane_of(channel, settings), []).append(k)
    if not groups:
        return []
    parts = [(key, _common_unit(channels, found), tuple(found)) for key, found in groups.items()]
    each = height // len(parts)
    if settings.lanes == "over" or each < LOWEST_LANE:
        return [Lane(key, unit, members, 0, height) for key, unit, members in parts]
    spare = height - each * len(parts)
    lanes, row = [], 0
    for k, (key, unit, members) in enumerate(parts):
        rows = each + (1 if k < spare else 0)
        lanes.append(Lane(key, unit, members, row, rows))
        row += rows
    return lanes


def _lane_of(channel: Channel, settings: ScopeSettings) -> str:
    scale = settings.scales.get(channel.name, Scale())
    if scale.lane:
        return f"lane {scale.lane}"
    own = settings.lanes == "curve" or scale.low is not None or scale.high is not None
    return f"curve {channel.name}" if own else channel.unit


def _common_unit(channels: Sequence[Channel], members: Sequence[int]) -> str:
    units = {channels[k].unit for k in members}
    return units.pop() if len(units) == 1 else ""


def _asked(
    found: tuple[float, float], lane: Lane, channels: Sequence[Channel], settings: ScopeSettings
) -> tuple[float, float]:
    """The range of a lane, with the limits that the user has set."""
    scales = [settings.scales.get(channels[k].name, Scale()) for k in lane.channels]
    low = next((s.low for s in scales if s.low is not None), found[0])
    high = next((s.high for s in scales if s.high is not None), found[1])
    if high > low:
        return low, high
    return (low, low + 1.0) if high == found[1] else (high - 1.0, high)


def fit_range(low: Floats, high: Floats, held: tuple[float, float] | None) -> tuple[float, float]:
    """A y range that holds all values with a margin, and that changes only when it must.

    It grows at once. It shrinks only when the curve fills less than 40 % of it, so that the axis of
    a rolling picture does not jitter.
    """
    finite_low, finite_high = low[np.isfinite(low)], high[np.isfinite(high)]
    if len(finite_low) == 0 or len(finite_high) == 0:
        return held or (-1.0, 1.0)
    a, b = float(finite_low.min()), float(finite_high.max())
    if b - a < 1e-9 * max(abs(a), abs(b)) or b == a:
        half = 0.05 * abs(a) or 1.0
        a, b = a - half, b + half
    span = b - a
    if held is not None and held[0] <= a and b <= held[1] and span >= 0.4 * (held[1] - held[0]):
        return held
    return a - 0.1 * span, b + 0.1 * span


def compose(
    bands: tuple[Floats, Floats],
    channels: Sequence[Channel],
    settings: ScopeSettings,
    view: tuple[float, float, float],
    ranges: Mapping[str, tuple[float, float]],
    size: tuple[int, int],
    limits: Mapping[str, Sequence[float]] | None = None,
) -> Picture:
    """Draw one picture.

    Parameters
    ----------
    bands : tuple of two ndarrays, shape (columns, channels)
        The lowest and the highest value of each curve in each dot column, as :func:`envelope` makes
        them.
    view : (start, end, zero)
        Borders of the picture and the time that labels count from, s.
    ranges : mapping of lane to (bottom, top)
        The y ranges drawn last; with ``settings.auto`` they are adapted, otherwise kept.
    size : (width, height)
        Of the plot area, in characters.
    limits : mapping of unit to values, optional
        Drawn as broken lines where they are within the range.
    """
    width, height = max(size[0], 1), max(size[1], 1)
    start, end, zero = view
    low, high = bands
    lanes = []
    for lane in arrange(channels, settings, height):
        members = list(lane.channels)
        held = ranges.get(lane.key)
        if settings.auto or held is None:
            held = fit_range(low[:, members], high[:, members], held)
        held = _asked(held, lane, channels, settings)
        lanes.append(replace(lane, bottom=held[0], top=held[1]))

    overlaid = len(lanes) > 1 and lanes[0].row == lanes[1].row
    shown = [lane for lane in lanes if settings.selected in lane.channels] if overlaid else lanes
    time_ticks = tuple(v + zero for v in ticks(start - zero, end - zero, max(width // TICK, 1)))
    back = np.zeros((height * DOTS_Y, width * DOTS_X), dtype=bool)
    _grid(back, shown, time_ticks, start, end)
    codes = encode(back)
    owner = np.where(codes > 0, GRID, EMPTY).astype(np.int8)
    _lay(codes, owner, _bounds(np.zeros_like(back), lanes, limits or {}), LIMIT)
    marked = _lay(codes, owner, _marks(np.zeros_like(back), lanes, settings), CURSOR)
    curves = np.zeros_like(codes)
    order = sorted(range(len(channels)), key=lambda k: k == settings.selected)
    for k in order:
        lane = next(lane for lane in lanes if k in lane.channels)
        dots = fill(low[:, k], high[:, k], lane.bottom, lane.top, lane.rows * DOTS_Y)
        cells = encode(dots)
        part = slice(lane.row, lane.row + lane.rows)
        curves[part] |= cells
        owner[part][cells > 0] = k
    codes = np.where(curves > 0, curves | marked, codes)
    return Picture(codes, owner, tuple(lanes), start, end, zero, time_ticks)


def _lay(
    codes: npt.NDArray[np.uint8],
    owner: npt.NDArray[np.int8],
    dots: npt.NDArray[np.bool_],
    pen: int,
) -> npt.NDArray[np.uint8]:
    """Put dots over what is drawn, and return the cells."""
    cells = encode(dots) if dots.any() else np.zeros_like(codes)
    codes[cells > 0] = cells[cells > 0]
    owner[cells > 0] = pen
    return cells


def _grid(
    dots: npt.NDArray[np.bool_],
    lanes: Sequence[Lane],
    time_ticks: Sequence[float],
    start: float,
    end: float,
) -> None:
    """Draw dotted lines at the round numbers of both axes."""
    rows, columns = dots.shape
    for lane in lanes:
        last = lane.rows * DOTS_Y - 1
        for value in ticks(lane.bottom, lane.top, max(lane.rows // 3, 2)):
            row = lane.row * DOTS_Y + round((lane.top - value) / (lane.top - lane.bottom) * last)
            if 0 <= row < rows:
                dots[row, ::4] = True
    for value in time_ticks:
        column = int((value - start) / (end - start) * columns)
        if 0 <= column < columns:
            dots[::4, column] = True


def _bounds(
    dots: npt.NDArray[np.bool_], lanes: Sequence[Lane], limits: Mapping[str, Sequence[float]]
) -> npt.NDArray[np.bool_]:
    """Draw the machine's limits as broken lines."""
    columns = np.arange(dots.shape[1])
    for lane in lanes:
        for value in limits.get(lane.unit, ()):
            if lane.bottom <= value <= lane.top:
                share = (lane.top - value) / (lane.top - lane.bottom)
                dots[
                    lane.row * DOTS_Y + round(share * (lane.rows * DOTS_Y - 1)), columns % 8 < 5
                ] = True
    return dots


def _marks(
    dots: npt.NDArray[np.bool_], lanes: Sequence[Lane], settings: ScopeSettings
) -> npt.NDArray[np.bool_]:
    """Draw the trigger's level and position, and the two cursors."""
    columns = dots.shape[1]
    if settings.mode == "trigger":
        dots[::3, min(int(settings.pre * columns), columns - 1)] = True
        for lane in lanes:
            if settings.source in lane.channels and lane.bottom <= settings.level <= lane.top:
                share = (lane.top - settings.level) / (lane.top - lane.bottom)
                row = lane.row * DOTS_Y + round(share * (lane.rows * DOTS_Y - 1))
                dots[row, ::3] = True
    if settings.cursors:
        dots[:, min(int(settings.cursor_a * columns), columns - 1)] = True
        dots[::2, min(int(settings.cursor_b * columns), columns - 1)] = True
    return dots
