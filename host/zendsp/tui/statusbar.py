"""The bar at the top of every screen: target, state of the loop, commander, and STOP."""

from __future__ import annotations

import time
from textwrap import shorten, wrap

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widget import Widget
from textual.widgets import Static

from zendsp.tui.actions import SCREENS, in_keys, keys_of
from zendsp.tui.panels.lines import Lines
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp.tui.stop_lane import Verdict
from zendsp.tui.stop_process import Field, StopState
from zendsp_protocol.states import Clock, ProgramState

STATE_MARKS = {
    "running": ("●", "success"),
    "enabled": ("●", "success"),
    "homed": ("◉", "primary"),
    "homing": ("●", "warning"),
    "ready": ("○", "primary"),
    "loaded": ("○", "primary"),
    "paused": ("‖", "warning"),
    "stopped": ("■", "warning"),
    "empty": ("○", "foreground"),
    "off": ("○", "foreground"),
    "tripped": ("▲", "error"),
    "crashed": ("✖", "error"),
}

LEAST = 4  # columns that words are wrapped to
LEAST_NAME = 12  # columns of a target's name, however much there is to be said
OLD_S = 1.5  # since the target was asked, which is ten times a second: its answers are late
FEWEST = 40  # columns; on fewer no screen is of use
ENOUGH = "80×24 is needed"
BUSY = 0.8  # of the period, by the longest execution: more is shown as a warning


def microseconds(ns: float) -> str:
    """An execution time with three digits: ``3.21 µs``, ``104 µs``, ``1.20 ms``."""
    us = ns * 1e-3
    if us >= 1000.0:
        ms = us * 1e-3
        return f"{ms:.{2 if ms < 10.0 else 1 if ms < 100.0 else 0}f} ms"
    return f"{us:.3g} µs"


def mean_and_max(mean_ns: float, max_ns: float) -> str:
    """Mean and maximum of the execution time, with the unit once where it is the same: ``1.13/27.4
    µs``, ``0.473 µs/2.40 ms``.
    """
    mean, most = microseconds(mean_ns), microseconds(max_ns)
    return f"{mean.removesuffix(most[-3:])}/{most}"


def latency(seconds: float) -> str:
    """The round-trip time of the link, or a dash where it is unknown."""
    return f"{seconds * 1e3:.1f} ms" if seconds == seconds else "—"


def banner_lines(text: str, width: int) -> list[str]:
    """How STOP ended, in one line, or two on a narrow terminal; the first words are never cut."""
    if len(text) + 4 <= width:
        return [f" ■ {text} "]
    if width < LEAST:  # a screen that is being built has no size yet
        return [text]
    lines = wrap(text, width)
    rest = " ".join(lines[1:])
    return lines if len(lines) < 3 else [lines[0], shorten(rest, width, placeholder=" …")]


class Tabs(Widget):
    """The names of the four screens; a click opens one."""

    DEFAULT_CSS = "Tabs { height: 1; width: 1fr; }"

    def __init__(self, current: str) -> None:
        super().__init__()
        self.current = current
        self.right = Text()  # recording light and time, at the right end
        self._spans: list[tuple[int, int, str]] = []

    def render(self) -> Text:
        colours = self.app.theme_variables
        text = Text(no_wrap=True, overflow="ellipsis")
        if self.app.size.width < FEWEST:
            return text.append(f" {ENOUGH}", Style(bold=True, color=colours["warning"]))
        tabs = sum(len(f" F0 {name} ") for name in SCREENS)
        # on 80 columns the time is worth more than the name, on 60 than those of other screens
        room = self.size.width - tabs - self.right.cell_len
        text.append(
            " zendsp " if room > len(" zendsp ") else "", Style(bold=True, color=colours["accent"])
        )
        self._spans = []
        for k, name in enumerate(SCREENS):
            begin = text.cell_len
            here = name == self.current
            key = Style(color=colours["accent"], bold=True)
            body = Style(bold=True, reverse=True) if here else Style()
            text.append(f" F{k + 2}", key)
            text.append(f" {name.capitalize()} " if here or room >= 0 else " ", body)
            self._spans.append((begin, text.cell_len, name))
        text.append(" " * max(self.size.width - text.cell_len - self.right.cell_len, 1))
        return text.append_text(self.right)

    def on_click(self, event: events.Click) -> None:
        for begin, end, name in self._spans:
            if begin <= event.x < end:
                self.app.call_later(self.app.run_action, f"show('{name}')")


class StopButton(Static):
    """A red field that is always visible; one click stops."""

    DEFAULT_CSS = """
    StopButton { width: 13; height: 100%; background: $error; color: $background; text-style: bold;
                 content-align: center middle; }
    StopButton:hover { background: $error-lighten-2; }
    """

    class Pressed(Message):
        """STOP was clicked."""

    def __init__(self) -> None:
        super().__init__("■ STOP  F9", markup=False)

    def on_click(self) -> None:
        self.app.call_later(self.app.run_action, "stop")


class StatusBar(Widget):
    """Target, state, rate, execution time, overruns, lost samples, latency, commander, recording
    light, time, STOP.
    """

    DEFAULT_CSS = """
    StatusBar { height: 3; background: $panel; layout: horizontal; dock: top; }
    StatusBar #status-lines { width: 1fr; height: 3; }
    StatusBar .line { height: 1; width: 1fr; }
    """

    def __init__(self, current: str) -> None:
        super().__init__()
        self._current = current
        self._tabs = Tabs(current)
        self._line1 = Lines(classes="line")
        self._line2 = Lines(classes="line")
        self._stop = StopButton()
        self._shown: tuple[object, ...] = ()
        self._busy = ""

    def compose(self) -> ComposeResult:
        with Horizontal():
            with Vertical(id="status-lines"):
                yield self._tabs
                yield self._line1
                yield self._line2
            yield self._stop

    @property
    def field(self) -> Field:
        """The place of the STOP field on the screen. The process that reads the keys handles clicks
        there; the application does so only without that process.
        """
        return Field(*self._stop.region)

    def show(self, snapshot: Snapshot, verdict: Verdict | None = None, busy: str = "") -> None:
        """Paint a snapshot and what the worker is doing; nothing is painted while nothing has
        changed.
        """
        clock = time.strftime("%H:%M:%S")
        now = (id(snapshot), clock, self.app.theme, verdict, self._line1.size.width, busy)
        if now == self._shown:
            return
        self._shown = now
        c = self.app.theme_variables
        right = Text(no_wrap=True)
        light = Style(color=c["error"], bold=True) if snapshot.recording else Style(dim=True)
        right.append("● REC " if snapshot.recording else "○ rec ", light)
        right.append(f"{clock} ", Style(dim=True))
        if self._tabs.right != right:
            self._tabs.right = right
            self._tabs.refresh()
        self._busy = busy
        trouble = self.trouble(snapshot)
        first = cell_len(_short(_what(snapshot))) or trouble.cell_len
        first += trouble.cell_len > first  # the mark of what is cut
        where = self.where(snapshot, first)
        lines = [where, self.loop(snapshot)]
        if verdict is not None or where.cell_len + first <= self._line1.size.width:
            where.append_text(trouble)
        elif trouble:  # a number that is cut would be another number; those of the loop can wait
            lines = [self.where(snapshot), Text(" ", no_wrap=True, overflow="ellipsis")]
            lines[1].append_text(trouble)
        if verdict is not None:
            lines = [*self.banner(verdict), where]
        self._line1.update(lines[0])
        self._line2.update(lines[1])

    def banner(self, verdict: Verdict) -> list[Text]:
        """One or two lines over the whole width on how STOP ended."""
        c = self.app.theme_variables
        colour = c["warning"] if verdict.state == StopState.STOPPED else c["error"]
        after = ", then Ctrl+K" if verdict.state == StopState.NOT_STOPPED else ""
        width = self._line1.size.width
        return [
            Text(line.ljust(width), Style(bold=True, color=colour, reverse=True), no_wrap=True)
            for line in banner_lines(verdict.text + after, width)
        ]

    def where(self, s: Snapshot, beside: int = 0) -> Text:
        """The line with the target, its state and the commander. ``beside``: columns to leave free.
        """
        c = self.app.theme_variables
        line = Text(" ", no_wrap=True, overflow="ellipsis")
        if s.link != LinkState.UP:
            words = {
                LinkState.NONE: f"no target: Ctrl+O {_offer(s)}",
                LinkState.STARTING: f"starting {s.target} …",
                LinkState.CONNECTING: f"connecting to {s.target} …",
                LinkState.LOST: f"LINK LOST to {s.target}: {_again(s)}",
                LinkState.ENDED: f"{s.target} HAS ENDED{_said(s)}: Ctrl+O {_offer(s)}",
            }
            colour = c["error"] if s.link in (LinkState.LOST, LinkState.ENDED) else c["warning"]
            return line.append(words.get(s.link, s.link), Style(bold=True, color=colour))
        rest = self._state(s)
        # what it does is worth more than its whole name
        room = max(self._line1.size.width - rest.cell_len - beside - len("  "), LEAST_NAME)
        machine = f" on {s.machine}" if s.machine != s.target else ""
        if len(s.target) + len(machine) > room:
            machine = ""
        name = s.target if len(s.target) <= room else f"{s.target[: room - 1]}…"
        line.append(name, Style(bold=True, color=c["primary"]))
        line.append(f"{machine}  ", Style(dim=True))
        return line.append_text(rest)

    def _state(self, s: Snapshot) -> Text:
        """What the target does, and who moves it."""
        c = self.app.theme_variables
        line = Text()
        for state in dict.fromkeys((s.drive, "homing" if s.homing else s.state)):
            if state:
                mark, colour = STATE_MARKS.get(state, ("○", "foreground"))
                line.append(f"{mark} {state}  ", Style(bold=True, color=c[colour]))
                if state == s.drive and keys_of(s.steps[:1]) == "^k":
                    line.append("^k  ", Style(color=c["warning"]))
        if self._busy:
            line.append(f"… {self._busy}  ", Style(bold=True, color=c["warning"]))
        who = "you" if s.mine else s.commander or "nobody"
        line.append("cmd ", Style(dim=True))
        line.append(f"{who}  ", Style(color=c["success"] if s.mine else c["warning"]))
        if s.moved_by and s.moved_by != who:
            line.append(f"run {s.moved_by}  ", Style(color=c["warning"]))
        return line

    def trouble(self, s: Snapshot) -> Text:
        """A trip, a crash, or a joint outside its limits, in words; empty where there is none."""
        words = str(s.outside[0]) if s.outside else ""
        if s.trip is not None or s.crash:
            words = s.crash if s.trip is None or s.unsafe else s.trip.text
        colour = self.app.theme_variables["error"]
        known = s.link == LinkState.UP
        return Text(in_keys(_short(words)), Style(color=colour, bold=True)) if known else Text()

    def loop(self, s: Snapshot) -> Text:
        """The line on the loop's timing and the link."""
        bad = Style(color=self.app.theme_variables["error"], bold=True)
        line = Text(" ", no_wrap=True, overflow="ellipsis")
        if s.link == LinkState.CONNECTING and s.complaint:
            return line.append(s.complaint, bad)
        if s.link in (LinkState.NONE, LinkState.CONNECTING):
            return line.append("Reference and Diagnose work without a target", Style(dim=True))
        if s.link in (LinkState.LOST, LinkState.ENDED):
            after = "; its rows: zendsp salvage" if s.gone else left_alone(s)
            return line.append(f"below: what was heard last, at t = {s.t:.1f} s{after}", bad)

        age = time.monotonic() - s.asked
        if age > OLD_S:
            return line.append(f"what is shown is {age:.0f} s old: this computer is busy", bad)
        width = self._line2.size.width

        def item(name: str, value: str, alarm: bool = False) -> None:
            if 0 < width < line.cell_len + len(f"{name} {value}"):
                return  # a number that is cut would be another number
            line.append(f"{name} ", Style(dim=True))
            line.append(f"{value}  ", bad if alarm else Style())

        line.append(f"{s.rate_hz:g} Hz{' fast' if s.clock == Clock.FAST else ''}  ")
        # the fast clock has no deadline to miss
        share = "" if s.clock == Clock.FAST else f" {100.0 * s.share:.1f}%"
        item(
            "exec",
            mean_and_max(s.exec_mean_ns, s.exec_max_ns) + share,
            bool(share) and s.share > BUSY,
        )
        item("over", str(s.overruns), s.overruns > 0)
        item("lost", str(s.lost), s.lost > 0)
        item("link", latency(s.latency_s))
        return line


def _what(s: Snapshot) -> str:
    """What is wrong, without the sample and without advice; empty where nothing else is said."""
    if s.trip is not None and not s.unsafe:
        return s.trip.cause
    return s.outside[0].what if s.outside and not s.crash else ""


def _short(words: str) -> str:
    return words.replace("STOP was requested by", "STOP by")


def left_alone(s: Snapshot) -> str:
    """What a machine that this terminal moved does now that the link is lost."""
    words = {"stop": "it stops", "hold": "it comes to rest", "finish": "it goes on"}
    moved = s.state == ProgramState.RUNNING and (s.mine or s.moved_by == "you")
    return f"; {words[s.host_lost]}" if moved and s.host_lost in words else ""


def _said(s: Snapshot) -> str:
    """What a target that ended by itself said of its machine."""
    return {None: "", True: ", machine safe", False: ", machine NOT SAFE"}[s.safe]


def _again(s: Snapshot) -> str:
    if s.gone and s.safe is False:
        return f"it ended{_said(s)}: emergency stop"
    return f"it has ended{_said(s)}; start it again" if s.gone else "reconnecting …"


def _offer(s: Snapshot) -> str:
    """What Ctrl+O would offer, as far as it is known which targets answer."""
    if s.here is None:
        return "connects"
    return f"connects to {', '.join(s.here)}" if s.here else "starts a simulated machine"
