"""The scope as a Textual widget: takes what History holds thirty times a second and paints it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.app import App
from textual.geometry import Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from zendsp.tui.colours import trace_colours
from zendsp.tui.scope.history import History
from zendsp.tui.scope.measure import measure
from zendsp.tui.scope.path import plot_lines
from zendsp.tui.scope.picture import CURSOR, EMPTY, GRID, LIMIT, Picture, compose
from zendsp.tui.scope.plane import over_frequency, over_selected
from zendsp.tui.scope.raster import braille
from zendsp.tui.scope.settings import MOST_CHANNELS, VIEWS, WINDOWS, Channel, ScopeSettings
from zendsp.tui.scope.spectrum import density, ready
from zendsp.tui.scope.ticks import duration, label, number, short, ticks
from zendsp.tui.scope.trigger import last_crossing

Floats = npt.NDArray[np.float64]
GUTTER = 9  # columns of the y axis
LOADING_S = 0.2  # between looks whether the spectrum is ready
FRAME_S = 1.0 / 30.0  # where the application does not say otherwise
LEGEND_ROWS = 3  # at the most: what is below is the picture


def legend_lines(
    texts: Sequence[Sequence[str]], width: int, taken: int
) -> list[list[tuple[int, str]]]:
    """Return the rows of a legend in which every curve has its place: number and text of each.

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


class Scope(Widget, can_focus=True):
    """Up to eight live curves.

    Data come through :attr:`history`, which any thread may fill; the widget looks at it at 30 Hz
    and repaints only when there is something new. Everything the user can set is in
    :attr:`settings`.
    """

    DEFAULT_CSS = "Scope { height: 1fr; min-height: 6; }"

    class Changed(Message):
        """The settings changed by mouse or key."""

    class ScaleWanted(Message):
        """The axis of the selected curve was clicked."""

    def __init__(self, *, id: str | None = None, live: bool = True) -> None:
        super().__init__(id=id)
        self.channels: tuple[Channel, ...] = ()
        self.history = History(0)
        self.settings = ScopeSettings()
        self.paused = False
        self.limits: dict[str, list[float]] = {}  # unit -> values drawn as broken lines
        self.past = 0.0  # s that a paused picture is moved into the past
        self._single_after = float("nan")  # s; crossings before do not count
        self.single = False  # armed for one trigger, then pause
        self.picture: Picture | None = None
        self.empty_text = "no channels: press c, or mark variables with space"
        self._frozen: tuple[Floats, Floats] | None = None
        self._ranges: dict[str, tuple[float, float]] = {}
        self._strips: list[Strip] = []
        self._seen = -1
        self._drawn: tuple[Floats, Floats] = (np.zeros(0), np.zeros((0, 0)))  # of the picture
        self._last_trigger: float | None = None
        self._pens: dict[int, Style] = {}
        self._live = live
        self._labels: dict[str, str] = {}

    # -- data
    # ----------------------------------------------------------------------------------------------

    def show_channels(self, channels: Sequence[Channel], history: History | None = None) -> None:
        """Take other channels; ``history`` is made anew unless given. At most eight."""
        self.channels = tuple(channels)[:MOST_CHANNELS]
        self.history = history if history is not None else History(len(self.channels))
        selected = min(self.settings.selected, max(len(self.channels) - 1, 0))
        source = min(self.settings.source, max(len(self.channels) - 1, 0))
        self.settings = replace(self.settings, selected=selected, source=source)
        self._frozen, self.paused, self._last_trigger, self.past = None, False, None, 0.0
        self._ranges = {}
        self.redraw()

    def set(self, settings: ScopeSettings) -> None:
        """Take other settings and repaint."""
        self.settings = settings
        self.redraw()
        self.post_message(self.Changed())

    def pause(self, paused: bool) -> None:
        """Freeze the picture, or let it live again. A frozen picture keeps its data whatever
        arrives meanwhile.
        """
        self.paused = paused
        self.past = 0.0
        self._frozen = self.history.newest() if paused else None
        self.redraw()

    def arm_single(self) -> None:
        """Wait for the next crossing from now on, then freeze."""
        self._last_trigger = None
        self._single_after = self.history.latest
        self.single = True
        self.set(replace(self.settings, mode="trigger"))

    def pan(self, share: float) -> None:
        """Move a frozen picture by a share of the window; positive is into the past."""
        if not self.paused:
            self.pause(True)
        t = self._frozen[0] if self._frozen is not None else np.zeros(0)
        reach = float(t[-1] - t[0]) if len(t) else 0.0
        self.past = float(np.clip(self.past + share * self.settings.window, 0.0, max(reach, 0.0)))
        self.redraw()

    def zoom(self, steps: int) -> None:
        """Widen (+) or narrow (−) the time window by steps of 1-2-5."""
        nearest = int(np.argmin([abs(w - self.settings.window) for w in WINDOWS]))
        self.set(
            replace(self.settings, window=WINDOWS[min(max(nearest + steps, 0), len(WINDOWS) - 1)])
        )

    def autoscale(self) -> None:
        """Fit every y range to what is seen, once, and go on following if automatic."""
        self._ranges = {}
        self.redraw()

    def move_cursor(self, share: float) -> None:
        """Move the active cursor by a share of the window."""
        s = self.settings
        if s.active == "a":
            self.set(replace(s, cursor_a=float(np.clip(s.cursor_a + share, 0.0, 1.0))))
        else:
            self.set(replace(s, cursor_b=float(np.clip(s.cursor_b + share, 0.0, 1.0))))

    # -- painting
    # ----------------------------------------------------------------------------------------------

    def on_mount(self) -> None:
        if self._live:
            self.set_interval(getattr(self.app, "frame_s", FRAME_S), self._tick)
        self.app.theme_changed_signal.subscribe(self, self._theme_changed)

    def _theme_changed(self, _: object) -> None:
        self._pens = {}
        self.redraw()

    def on_resize(self, event: events.Resize) -> None:
        self.redraw()

    def _tick(self) -> None:
        if (
            self.paused
            or self.history.count == self._seen
            or self.screen not in self.app.screen_stack
        ):
            return
        self.redraw()

    def redraw(self) -> None:
        """Compose the picture anew and ask for a repaint."""
        self._strips = []
        self._seen = self.history.count
        self.refresh()

    def _data(self) -> tuple[Floats, Floats]:
        if self._frozen is not None:
            return self._frozen
        if self.settings.mode == "roll":
            return self.history.since(self.history.latest - 1.1 * self.settings.window)
        return self.history.since(self.history.latest - 4.0 * self.settings.window)

    def _view(self, t: Floats, y: Floats, columns: int) -> tuple[float, float, float]:
        """Borders of the picture and the zero of its labels, s."""
        s = self.settings
        latest = float(t[-1]) if len(t) else s.window
        if s.mode == "trigger" and len(t) > 1 and y.shape[1]:
            if self._frozen is None:
                fits = latest - (1.0 - s.pre) * s.window
                hit = last_crossing(t, y[:, s.source], s.level, s.edge, fits)
                if hit is not None:
                    self._last_trigger = hit
                    if self.single and not hit <= self._single_after:
                        self.single = False
                        self.paused, self._frozen = True, self.history.newest()
            if self._last_trigger is not None:
                start = self._last_trigger - s.pre * s.window - self.past
                return start, start + s.window, self._last_trigger
        # columns stay at the same times while the picture rolls: no shimmer
        step = s.window / columns
        end = (np.floor((latest - self.past) / step) + 1.0) * step
        return float(end - s.window), float(end), 0.0

    def _draw(self) -> None:
        width, height = self.size
        legend = self._legend_rows(width)
        readout = 2 if self.settings.cursors else 0
        rows = max(height - len(legend) - readout - 1, 1)
        columns = max(width - GUTTER, 1)
        t, y = self._data()
        if not self._pens:
            self._pens = self._make_pens()
        view = self._view(t, y, columns * 2)
        self.picture = compose(
            t, y, self.channels, self.settings, view, self._ranges, (columns, rows), self.limits
        )
        self._drawn = (t, y)
        self._ranges = {lane.key: (lane.bottom, lane.top) for lane in self.picture.lanes}
        self._values = y[-1] if len(y) else np.zeros(0)
        strips = [self._text(row, width) for row in self._legend_rows(width)]
        if self.settings.view != "time" and self.channels:
            strips += self._plane((width, rows + 1))
        else:
            strips += self._plot_strips(self.picture, width, rows)
            strips.append(self._time_axis(self.picture, width))
        if readout:
            pen = self._pens[CURSOR]
            strips.append(self._text([(self.readout(t, y), pen)], width))
            strips.append(self._text([(self.statistics(t, y), pen)], width))
        self._strips = strips

    def _plane(self, size: tuple[int, int]) -> list[Strip]:
        """The curves over the selected one, or over frequency."""
        seen = self.seen()
        if self.settings.view == "xy":
            curves, axes = over_selected(self.channels, self.settings.selected, seen[1])
        elif not ready():
            curves, axes = over_frequency([], np.zeros(0), np.zeros((0, 0)), "one moment …")
            self.set_timer(LOADING_S, self.redraw)
        else:
            curves, axes = over_frequency(self.channels, *density(*seen))
        if not any(len(curve.xy) for curve in curves):  # numbers before there is anything
            low = -float(np.log10(self.settings.window))
            empty = (low, low + 3.0, -6.0, 0.0) if axes.log_x else (-1.0, 1.0, -1.0, 1.0)
            axes = replace(axes, frame=empty)
        colours = trace_colours(self.app.current_theme)
        return plot_lines(curves, axes, size, colours, self._pens[EMPTY])

    def seen(self) -> tuple[Floats, Floats]:
        """Return the rows of the picture that was drawn last, or those between the cursors where
        they are shown: times, shape (n,), and values, shape (n, channels).
        """
        t, y = self._drawn
        s, picture = self.settings, self.picture
        if picture is None:
            return t[:0], y[:0]
        begin, end = picture.start, picture.end
        if s.cursors:
            a, b = sorted((s.cursor_a, s.cursor_b))
            begin, end = begin + a * (end - begin), begin + b * (end - begin)
        inside = (t >= begin) & (t <= end)
        return t[inside], y[inside]

    def next_view(self) -> None:
        """Show the curves over time, over the selected one, or over frequency, by turns."""
        turn = VIEWS[(VIEWS.index(self.settings.view) + 1) % len(VIEWS)]
        self.set(replace(self.settings, view=turn))

    def _plot_strips(self, picture: Picture, width: int, rows: int) -> list[Strip]:
        axis = self._y_labels(picture, rows)
        if not self.channels and rows > 2:
            middle = rows // 2
            axis[middle] = ("", self._pens[GRID])
        strips = []
        for r in range(rows):
            text, style = axis.get(r, ("", self._pens[GRID]))
            segments = [Segment(text.rjust(GUTTER - 1)[: GUTTER - 1] + "▏", style)]
            owner = picture.owner[r]
            line = braille(picture.codes[r])
            borders = [0, *(np.flatnonzero(owner[1:] != owner[:-1]) + 1).tolist(), len(line)]
            segments += [
                Segment(line[a:b], self._pens[int(owner[a])])
                for a, b in itertools.pairwise(borders)
            ]
            if not self.channels and r == rows // 2:
                note = self.empty_text.center(len(line))[: len(line)]
                segments = [segments[0], Segment(note, self._pens[GRID])]
            strips.append(Strip(segments, width))
        return strips

    def _y_labels(self, picture: Picture, rows: int) -> dict[int, tuple[str, Style]]:
        """Numbers beside the plot, by row; the lane's unit stands in its first row."""
        lanes = picture.lanes
        if len(lanes) > 1 and lanes[0].row == lanes[1].row:
            lanes = tuple(lane for lane in lanes if self.settings.selected in lane.channels)
        labels: dict[int, tuple[str, Style]] = {}
        for lane in lanes:
            style = self._pens[lane.channels[0]] if len(lane.channels) == 1 else self._pens[GRID]
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

    def _time_axis(self, picture: Picture, width: int) -> Strip:
        line = [" "] * width
        columns = width - GUTTER
        marks = picture.time_ticks
        step = marks[1] - marks[0] if len(marks) > 1 else self.settings.window
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
        return Strip([Segment("".join(line), self._pens[GRID])], width)

    def _legend_rows(self, width: int) -> list[list[tuple[str, Style]]]:
        """Names and newest values in the colours of the curves, on as few rows as they need; the
        mode at the right.
        """
        if not self._pens:
            self._pens = self._make_pens()
        s = self.settings
        state = (
            ""
            if not self._live
            else (
                "PAUSED"
                if self.paused
                else "SINGLE" if self.single else "ROLL" if s.mode == "roll" else "TRIG"
            )
        )
        if s.view != "time":
            state = f"{state} {s.view.upper()}".strip()
        mode = f" {state} {duration(s.window)}{'' if s.auto else ' fixed'} "
        mode_style = self._pens[CURSOR] + Style(reverse=True) if self.paused else self._pens[CURSOR]
        rows: list[list[tuple[str, Style]]] = [[]]
        for line in legend_lines(self._legend_texts(), width, len(mode)):
            styles = [self._pens[k] for k, _ in line]
            rows[-1] += [
                (text, style + Style(bold=True, underline=True) if k == s.selected else style)
                for (k, text), style in zip(line, styles, strict=True)
            ]
            rows.append([])
        rows = rows[:-1] or rows
        used = sum(len(part) for part, _ in rows[0])
        rows[0].append((" " * max(width - used - len(mode), 0), self._pens[GRID]))
        rows[0].append((mode, mode_style))
        return rows

    def _legend_texts(self) -> list[list[str]]:
        """Each curve's part of the legend: with value and unit, without the unit (the axis has it),
        and its name alone.
        """
        values = getattr(self, "_values", np.zeros(0))
        found = []
        for k, channel in enumerate(self.channels):
            name = f" {k + 1}▐ {channel.name}"
            value = f" {number(float(values[k])) if k < len(values) else '—':>9}"
            unit = f" {channel.unit}" if channel.unit else ""
            full = [f"{name}{value}{unit} ", f"{name}{value} "] if self._live else []
            found.append([*full, f"{name}{unit} ", f"{name} "])
        return found

    def readout(self, t: Floats, y: Floats) -> str:
        """Return what the cursors measure, of the selected channel."""
        s, picture = self.settings, self.picture
        if picture is None or not self.channels:
            return ""
        span = picture.end - picture.start
        a, b = picture.start + s.cursor_a * span, picture.start + s.cursor_b * span
        channel = self.channels[s.selected]
        if len(t):
            ya, yb = (
                float(np.interp(x, t, y[:, s.selected], left=np.nan, right=np.nan)) for x in (a, b)
            )
        else:
            ya = yb = float("nan")
        dt = b - a
        rate = f" = 1/{short(1.0 / abs(dt))} Hz" if dt else ""
        unit = f" {channel.unit}" if channel.unit else ""
        text = f" Δt {duration(dt)}{rate}  {channel.name} Δy {short(yb - ya)}{unit}  "
        return (
            f"{text} A {short(a - picture.zero)} s {short(ya)}  B {short(b - picture.zero)} s"
            f" {short(yb)}"
        )

    def statistics(self, t: Floats, y: Floats) -> str:
        """Return what the selected channel does between the cursors."""
        s, picture = self.settings, self.picture
        if picture is None or not self.channels or not len(t):
            return ""
        span = picture.end - picture.start
        a, b = picture.start + s.cursor_a * span, picture.start + s.cursor_b * span
        found = measure(t, y[:, s.selected], a, b)
        text = (
            f" A…B mean {short(found.mean)}  rms {short(found.rms)}  σ {short(found.deviation)}"
            f"  {short(found.low)} … {short(found.high)}"
        )
        if np.isfinite(found.rise):
            text += f"  rise {duration(found.rise)}  over {100.0 * found.overshoot:.3g} %"
        return text

    def _text(self, parts: Sequence[tuple[str, Style]], width: int) -> Strip:
        return Strip([Segment(text, style) for text, style in parts]).adjust_cell_length(
            width, self._pens[EMPTY]
        )

    def _make_pens(self) -> dict[int, Style]:
        app: App[object] = self.app
        colours = trace_colours(app.current_theme)
        back = Style(bgcolor=self.background_colors[1].rich_color)
        styles = {k: back + Style(color=colour) for k, colour in enumerate(colours.traces)}
        styles[GRID] = back + Style(color=colours.grid)
        styles[CURSOR] = back + Style(color=colours.cursor)
        styles[LIMIT] = back + Style(color=self.app.theme_variables["error"])
        styles[EMPTY] = back
        return styles

    def render_line(self, y: int) -> Strip:
        if not self._strips and self.size.width > GUTTER and self.size.height > 2:
            self._draw()
        return self._strips[y] if y < len(self._strips) else Strip.blank(self.size.width)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return container.height

    # -- mouse
    # ----------------------------------------------------------------------------------------------

    def on_click(self, event: events.Click) -> None:
        """Left sets cursor A, right (or shift) cursor B; a click on the first row selects the next
        curve.
        """
        if self.picture is None:
            return
        if event.x < GUTTER and event.y > 0:
            self._ask_scale(event.y)
            return
        if event.x < GUTTER:
            return
        share = (event.x - GUTTER + 0.5) / max(self.size.width - GUTTER, 1)
        share = float(np.clip(share, 0.0, 1.0))
        if event.y == 0 and self.channels:
            self.set(
                replace(self.settings, selected=(self.settings.selected + 1) % len(self.channels))
            )
        elif event.button == 3 or event.shift:
            self.set(replace(self.settings, cursors=True, cursor_b=share, active="b"))
        else:
            self.set(replace(self.settings, cursors=True, cursor_a=share, active="a"))

    def _ask_scale(self, y: int) -> None:
        """A click on an axis is about the lane beside it."""
        row = y - len(self._legend_rows(self.size.width))
        for lane in self.picture.lanes if self.picture is not None else ():
            inside = lane.row <= row < lane.row + lane.rows
            if inside and self.settings.selected not in lane.channels:
                self.set(replace(self.settings, selected=lane.channels[0]))
        self.post_message(self.ScaleWanted())

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.zoom(-1)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.zoom(1)
