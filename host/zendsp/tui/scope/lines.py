"""The text of the scope: its legend, the numbers of its axes, and the cells of its picture as
lines.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from zendsp.tui.scope.picture import EMPTY, GRID, Picture
from zendsp.tui.scope.raster import braille
from zendsp.tui.scope.ticks import beside, label, ticks

GUTTER = 9  # columns of the y axis
LEGEND_ROWS = 3  # at the most: what is below is the picture


def legend_lines(
    texts: Sequence[Sequence[str]], width: int, taken: int
) -> list[list[tuple[int, str]]]:
    """The rows of a legend in which every curve has a place: number and text of each.

    Parameters
    ----------
    texts : sequence of sequence of str
        Of each curve, from the longest to the shortest; as many for each. The longest are taken
        that fit; where none do, the shortest are cut.
    width : int
        Columns.
    taken : int
        Columns at the end of the first row that are not free.
    """
    for form in zip(*texts, strict=True):
        lines = _broken(form, width, taken)
        if len(lines) <= LEGEND_ROWS:
            return lines
    each = max(1, -(-len(texts) // LEGEND_ROWS))
    room = max((width - taken) // each, 1)
    cut = [f"{t[-1].rstrip()[: room - 2]}… " if len(t[-1]) > room else t[-1] for t in texts]
    return _broken(cut, width, taken)[:LEGEND_ROWS]


def _broken(texts: Sequence[str], width: int, taken: int) -> list[list[tuple[int, str]]]:
    lines: list[list[tuple[int, str]]] = [[]]
    room = width - taken
    for k, text in enumerate(texts):
        if len(text) > room and lines[-1]:
            lines.append([])
            room = width
        lines[-1].append((k, text))
        room -= len(text)
    return lines


def plot_rows(
    picture: Picture,
    numbers: Mapping[int, tuple[str, Style]],
    pens: Mapping[int, Style],
    width: int,
    note: str = "",
) -> list[Strip]:
    """The rows of the picture with the numbers of the y axes, and a note in the middle."""
    strips = []
    owners = _pens_held(picture.owner)
    columns = owners.shape[1]
    cells = braille(picture.codes.ravel())
    for r, owner in enumerate(owners):
        text, style = numbers.get(r, ("", pens[GRID]))
        segments = [Segment(beside(text, GUTTER - 1) + "▏", style)]
        line = cells[r * columns : (r + 1) * columns]
        if note and r == len(owners) // 2:
            segments.append(Segment(note.center(len(line))[: len(line)], pens[GRID]))
        else:
            borders = [0, *(np.flatnonzero(owner[1:] != owner[:-1]) + 1).tolist(), len(line)]
            segments += [
                Segment(line[a:b], pens[int(owner[a])]) for a, b in itertools.pairwise(borders)
            ]
        strips.append(Strip(segments, width))
    return strips


def _pens_held(owner: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    """Give empty cells the pen of the cell to their left: each change of pen costs time here and
    bytes on the terminal.
    """
    at = np.where(owner == EMPTY, 0, np.arange(owner.shape[1]))
    return np.take_along_axis(owner, np.maximum.accumulate(at, axis=1), axis=1)


def y_numbers(
    picture: Picture, selected: int, pens: Mapping[int, Style]
) -> dict[int, tuple[str, Style]]:
    """The numbers beside the plot, by row; a lane's unit stands in its first row."""
    lanes = picture.lanes
    if len(lanes) > 1 and lanes[0].row == lanes[1].row:
        lanes = tuple(lane for lane in lanes if selected in lane.channels)
    labels: dict[int, tuple[str, Style]] = {}
    for lane in lanes:
        style = pens[lane.channels[0]] if len(lane.channels) == 1 else pens[GRID]
        values = ticks(lane.bottom, lane.top, max(lane.rows // 3, 2))
        step = values[1] - values[0] if len(values) > 1 else lane.top - lane.bottom
        for value in values:
            row = min(int(lane.at(value)), lane.row + lane.rows - 1)
            labels[row] = (label(value, step), style)
        if lane.unit and lane.row not in labels:
            labels[lane.row] = (lane.unit, style)
        elif lane.unit and lane.row in labels:
            labels.setdefault(lane.row + 1, (lane.unit, style))
    return labels


def time_axis(picture: Picture, width: int, pen: Style) -> Strip:
    """The numbers below the plot."""
    line = [" "] * width
    columns = width - GUTTER
    marks = picture.time_ticks
    step = marks[1] - marks[0] if len(marks) > 1 else picture.end - picture.start
    for value in marks:
        text = label(value - picture.zero, step)
        at = (
            GUTTER
            + int((value - picture.start) / (picture.end - picture.start) * columns)
            - len(text) // 2
        )
        if at >= GUTTER - 2 and at + len(text) <= width - 3:
            line[at : at + len(text)] = list(text)
    line[-1] = "s"
    return Strip([Segment("".join(line), pen)], width)
