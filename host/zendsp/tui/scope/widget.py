"""The scope as a Textual widget: takes what History holds thirty times a second and paints it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.app import App
from textual.filter import ANSIToTruecolor, LineFilter
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from zendsp.tui.colours import trace_colours
from zendsp.tui.scope.history import History
from zendsp.tui.scope.lines import GUTTER, legend_lines, plot_rows, time_axis, y_numbers
from zendsp.tui.scope.measure import cursor_lines
from zendsp.tui.scope.path import plot_lines
from zendsp.tui.scope.picture import CURSOR, EMPTY, GRID, LIMIT, Picture, blank, compose
from zendsp.tui.scope.plane import over_frequency, over_selected
from zendsp.tui.scope.raster import DOTS_X, envelope
from zendsp.tui.scope.rolling import Rolling
from zendsp.tui.scope.settings import MOST_CHANNELS, VIEWS, WINDOWS, Channel, ScopeSettings
from zendsp.tui.scope.spectrum import density, ready
from zendsp.tui.scope.ticks import duration, number
from zendsp.tui.scope.trigger import last_crossing

Floats = npt.NDArray[np.float64]
NO_CHANNELS = "no channels: press c, or mark variables with space"
STILL_S = 0.1  # between pictures where only numbers change
OLD_S = 1.0  # without rows, of the clock and of the machine, after which a picture is old
LOADING_S = 0.2  # between looks whether the spectrum is ready


class Scope(Widget, can_focus=True):
    """Up to eight live curves.

    Data come through :attr:`history`, which any thread may fill; :meth:`tick` looks at it and
    repaints only where there is something new. All that the user can set is in :attr:`settings`.
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
        self.empty_text = NO_CHANNELS
        self._frozen: tuple[Floats, Floats] | None = None
        self._ranges: dict[str, tuple[float, float]] = {}
        self._strips: list[Strip] = []
        self._seen = -1
        self._drawn: tuple[Floats, Floats] | None = None  # rows of the picture, where asked for
        self._until = float("nan")  # s, of the newest of them
        self._drawn_at = 0.0  # of the monotonic clock
        self._rolling = Rolling()
        self._last_trigger: float | None = None
        self._pens: dict[int, Style] = {}
        self.live = live
        self.old = False  # the machine has gone on, and no rows have come
        self._grown = (-1, 0.0)  # rows of the history, and when they became so many

    # -- data

    def show_channels(self, channels: Sequence[Channel], history: History | None = None) -> None:
        """Show other channels, at most eight; ``history`` is a new one unless given."""
        self.channels = tuple(channels)[:MOST_CHANNELS]
        self.history = history if history is not None else History(len(self.channels))
        selected = min(self.settings.selected, max(len(self.channels) - 1, 0))
        source = min(self.settings.source, max(len(self.channels) - 1, 0))
        self.settings = replace(self.settings, selected=selected, source=source)
        self._frozen, self.paused, self._last_trigger, self.past = None, False, None, 0.0
        self._ranges = {}
        self.redraw()

    def set(self, settings: ScopeSettings) -> None:
        """Use other settings and repaint."""
        self.settings = settings
        self.redraw()
        self.post_message(self.Changed())

    def pause(self, paused: bool) -> None:
        """Freeze the picture, or let it run again. A frozen picture keeps its data whatever
        arrives.
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
        """Move a frozen picture by a fraction of the window; positive is into the past."""
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
        """Fit every y range once to the visible values; with automatic scaling it goes on
        following.
        """
        self._ranges = {}
        self.redraw()

    def move_cursor(self, share: float) -> None:
        """Move the active cursor by a fraction of the window."""
        s = self.settings
        if s.active == "a":
            self.set(replace(s, cursor_a=float(np.clip(s.cursor_a + share, 0.0, 1.0))))
        else:
            self.set(replace(s, cursor_b=float(np.clip(s.cursor_b + share, 0.0, 1.0))))

    # -- painting

    def on_mount(self) -> None:
        self.app.theme_changed_signal.subscribe(self, self._theme_changed)

    def _theme_changed(self, _: object) -> None:
        self._pens = {}
        self.redraw()

    def on_resize(self, event: events.Resize) -> None:
        self.redraw()

    def tick(self) -> None:
        """Repaint where there is something new; the screen calls it thirty times a second."""
        if not self.live or self.paused or self.history.count == self._seen:
            return
        if self._moves() or time.monotonic() - self._drawn_at >= STILL_S:
            self.redraw()

    def mark_old(self, machine_s: float) -> None:
        """Say so where no rows arrive any more although the machine's time, ``machine_s`` (s), goes
        on.
        """
        now = time.monotonic()
        if self.history.count != self._grown[0]:
            self._grown = (self.history.count, now)
        behind = abs(machine_s - self.history.latest) > OLD_S
        old = behind and now - self._grown[1] > OLD_S
        if old != self.old:
            self.old = old
            self.redraw()

    def _moves(self) -> bool:
        """Whether the curves have changed since the picture was drawn."""
        if self.settings.view == "spectrum" or self.settings.mode != "roll":
            return self.settings.mode != "roll"
        return self._rolling.moves(self.history, *self._raster())

    def redraw(self) -> None:
        """Compose the picture and ask for a repaint."""
        self._strips = []
        self._seen = self.history.count
        self.refresh()

    def _raster(self) -> tuple[float, int]:
        """The width of a dot column of a rolling picture, s, and the number of columns."""
        columns = DOTS_X * max(self.size.width - GUTTER, 1)
        return self.settings.window / columns, columns

    def _data(self) -> tuple[Floats, Floats]:
        if self._frozen is not None:
            return self._frozen
        if self.settings.mode == "roll":
            return self.history.since(self.history.latest - 1.1 * self.settings.window)
        return self.history.since(self.history.latest - 4.0 * self.settings.window)

    def _look(self) -> tuple[tuple[Floats, Floats], tuple[float, float, float]]:
        """The envelope of the visible curves; the limits of the picture and the zero of its labels,
        s.
        """
        step, columns = self._raster()
        s = self.settings
        if self._frozen is None and s.mode == "roll":
            self._drawn, self._until = None, self.history.latest
            # columns stay at the same times while the picture rolls: no shimmer
            first, low, high = self._rolling.look(self.history, step, columns)
            return (low, high), (first * step, (first + columns) * step, 0.0)
        t, y = self._drawn = self._data()
        start, zero = self._start(t, y, step)
        return envelope(t, y, start, start + s.window, columns), (start, start + s.window, zero)

    def _start(self, t: Floats, y: Floats, step: float) -> tuple[float, float]:
        """The left limit of a picture that does not roll, and the zero of its labels, s."""
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
                return self._last_trigger - s.pre * s.window - self.past, self._last_trigger
        end = (np.floor((latest - self.past) / step) + 1.0) * step
        return float(end - s.window), 0.0

    def _rows(self) -> tuple[Floats, Floats]:
        """The rows from which the picture was drawn."""
        if self._drawn is None:
            t, y = self.history.since(self._until - 1.1 * self.settings.window)
            now = t <= self._until
            self._drawn = t[now], y[now]
        return self._drawn

    def _draw(self) -> None:
        width, height = self.size
        readout = 2 if self.settings.cursors else 0
        if not self._pens:
            self._pens = self._make_pens()
        bands, view = self._look()
        self._drawn_at = time.monotonic()
        newest = self._drawn[1] if self._drawn is not None else self.history.newest(1)[1]
        self._values = newest[-1] if len(newest) else np.zeros(0)
        legend = self._legend_rows(width)
        rows = max(height - len(legend) - readout - 1, 1)
        strips = [self._text(row, width) for row in legend]
        if self.settings.view != "time" and self.channels:
            self.picture = blank(view)
            strips += self._plane((width, rows + 1))
        else:
            size = (max(width - GUTTER, 1), rows)
            self.picture = compose(
                bands, self.channels, self.settings, view, self._ranges, size, self.limits
            )
            self._ranges = {lane.key: (lane.bottom, lane.top) for lane in self.picture.lanes}
            numbers = y_numbers(self.picture, self.settings.selected, self._pens)
            note = "" if self.channels else self.empty_text
            strips += plot_rows(self.picture, numbers, self._pens, width, note)
            strips.append(time_axis(self.picture, width, self._pens[GRID]))
        if readout:
            pen, said = self._pens[CURSOR], ("", "")
            if self.channels:
                channel = self.channels[self.settings.selected]
                said = cursor_lines(self.picture, self.settings, channel, *self._rows(), width)
            strips += [self._text([(line, pen)], width) for line in said]
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
        """The rows of the picture that was drawn last, or those between the cursors where they are
        shown: times, shape (n,), and values, shape (n, channels).
        """
        t, y = self._rows()
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
        """Go to the next view: over time, over the selected curve, over frequency."""
        turn = VIEWS[(VIEWS.index(self.settings.view) + 1) % len(VIEWS)]
        self.set(replace(self.settings, view=turn))

    def _legend_rows(self, width: int) -> list[list[tuple[str, Style]]]:
        """Names and newest values in the colours of the curves, on as few rows as possible; the
        mode is at the right.
        """
        if not self._pens:
            self._pens = self._make_pens()
        s = self.settings
        state = (
            ""
            if not self.live
            else (
                "FROZEN"
                if self.paused
                else "SINGLE" if self.single else "ROLL" if s.mode == "roll" else "TRIG"
            )
        )
        if self.old and not self.paused:
            state = f"OLD {state}"
        if s.view != "time":
            state = f"{state} {s.view.upper()}".strip()
        mode = f" {state} {duration(s.window)}{'' if s.auto else ' fixed'} "
        mode_style = self._pens[CURSOR] + Style(reverse=self.paused or self.old)
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
        """Three legend texts for each curve: with value and unit, without the unit (the axis has
        it), and the name alone.
        """
        values = getattr(self, "_values", np.zeros(0))
        found = []
        for k, channel in enumerate(self.channels):
            name = f" {k + 1}▐ {channel.name}"
            value = f" {number(float(values[k])) if k < len(values) else '—':>9}"
            unit = f" {channel.unit}" if channel.unit else ""
            full = [f"{name}{value}{unit} ", f"{name}{value} "] if self.live else []
            found.append([*full, f"{name}{unit} ", f"{name} "])
        return found

    def _text(self, parts: Sequence[tuple[str, Style]], width: int) -> Strip:
        strip = Strip([Segment(*part) for part in parts], sum(len(text) for text, _ in parts))
        return strip.adjust_cell_length(width, self._pens[EMPTY])

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

    def render_lines(self, crop: Region) -> list[Strip]:
        """The lines of the picture. They are not cached as Textual would: in a rolling picture all
        of them change.
        """
        strips = [self.render_line(y) for y in crop.line_range]
        for line_filter in self._filters():
            strips = [s.apply_filter(line_filter, self.background_colors[1]) for s in strips]
        if crop.column_span != (0, self.size.width):
            strips = [strip.crop(*crop.column_span) for strip in strips]
        return strips

    def render_line(self, y: int) -> Strip:
        if not self._strips and self.size.width > GUTTER and self.size.height > 2:
            self._draw()
        return self._strips[y] if y < len(self._strips) else Strip.blank(self.size.width, Style())

    def _filters(self) -> list[LineFilter]:
        """The line filters but that for ANSI colours, which the pens do not use."""
        return [f for f in self.get_line_filters() if not isinstance(f, ANSIToTruecolor)]

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return container.height

    # -- mouse

    def on_click(self, event: events.Click) -> None:
        """Set cursor A (left) or B (right, or with shift); on the first row select the next curve.
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
        """Ask for the scale of the lane beside which an axis was clicked."""
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
