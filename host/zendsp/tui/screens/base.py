"""What the four screens share: the status bar at the top, the footer, and a look at the newest
snapshot 30 times a second.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from rich.text import Text
from textual.app import ComposeResult
from textual.screen import Screen

from zendsp.tui.actions import actions, called_now
from zendsp.tui.footer import Keys
from zendsp.tui.lab import Lab
from zendsp.tui.panels.events import EventsPanel
from zendsp.tui.scope import Scope
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp.tui.statusbar import StatusBar

if TYPE_CHECKING:
    from zendsp.tui.port import Port

T = TypeVar("T")
HANGING = "\n" + 24 * " "  # under the explanation of a key
NUMBERS_S = 0.2  # between numbers that change all the time: nobody reads faster
WIDE = 116  # columns from which panels stand side by side
TALL = 36  # rows from which a scope has room for a lane of every unit


class LabScreen(Screen[None]):
    """One of Console, Execute, Reference, Diagnose."""

    NAME: ClassVar[str] = ""
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (WIDE, "-broad")]  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__()
        self.bar = StatusBar(self.NAME)
        self.footer = Keys()
        self._pulled: Snapshot | None = None
        self._shown_at = 0.0  # of the monotonic clock

    @property
    def lab(self) -> Lab:
        """The application, with what screens may ask of it."""
        return cast(Lab, self.app)

    @property
    def small(self) -> bool:
        """Whether the screen is so small that curves of several units would share one lane."""
        return self.size.height < TALL

    def compose(self) -> ComposeResult:
        yield self.bar
        yield from self.body()
        yield self.footer

    def body(self) -> ComposeResult:
        """Yield the widgets between the status bar and the footer."""
        raise NotImplementedError

    def on_mount(self) -> None:
        self._scopes = [*self.query(Scope)]
        self._clock = self.set_interval(self.lab.frame_s, self._pull)
        self.ready()
        self._pull()  # what is shown first is what stays, not an empty screen

    def on_screen_resume(self) -> None:
        """Show at once what has changed meanwhile."""
        if self.is_mounted:
            self._clock.resume()
            self._pull()

    def ready(self) -> None:
        """What a screen does once, when its widgets exist."""

    def _pull(self) -> None:
        # another screen is shown; a dialog over this one is not another screen
        if self not in self.app.screen_stack:
            self._clock.pause()
            return
        snapshot, shown = self.lab.session.snapshot, self._pulled
        self.lab.session.stops.place(self.bar.field)
        now = time.monotonic()
        fresh = snapshot is not shown and (
            shown is None or now >= self._shown_at + NUMBERS_S or snapshot.news(shown)
        )
        if fresh:
            self._pulled, self._shown_at = snapshot, now
        session = self.lab.session
        self.bar.show(self._pulled or snapshot, session.stops.verdict, session.busy)
        self.footer.call(called_now(snapshot))
        self.pull(snapshot, fresh)
        for scope in self._scopes:
            if scope.is_on_screen:
                self._keep_live(scope, snapshot)
                scope.tick()

    def _keep_live(self, scope: Scope, snapshot: Snapshot) -> None:
        """Follow the channels of this scope again where another screen has followed others
        meanwhile, and mark curves for which no rows arrive.
        """
        if not scope.live or not scope.channels:
            return
        if scope.history is not self.lab.session.history:
            self.lab.session.watch(scope.channels, scope.history)
        gone = snapshot.link in (LinkState.LOST, LinkState.ENDED)
        scope.mark_old(math.inf if gone else snapshot.tick * snapshot.period_s)

    def pull(self, snapshot: Snapshot, fresh: bool) -> None:
        """Show a snapshot. ``fresh``: also its numbers, which is five times a second, and at once
        where more than numbers changed.
        """

    def say(self, text: str, level: str = "info") -> None:
        """Add a line to the event log. Show a warning or an error as a message too; also good news,
        where the log is not visible.
        """
        self.lab.session.events.add(text, level)
        unseen = not any(log.is_on_screen for log in self.query(EventsPanel))
        if level in ("warning", "error") or (level == "good" and unseen):
            self.lab.toast(text, level)

    def ask(
        self,
        label: str,
        job: Callable[[Port], T],
        then: Callable[[T], Any] | None = None,
        by: Callable[[str, Callable[[Port], T]], Future[T]] | None = None,
    ) -> Future[T]:
        """Run a job against the target on another thread, by default that of the session's worker;
        then call ``then`` with its result, or show why it failed.
        """

        def done(future: Future[T]) -> None:
            error = future.exception()
            if error is not None:
                self.app.call_later(self.lab.toast, f"{label}: {error}", "error")
            elif then is not None:
                self.app.call_later(then, future.result())

        future = (by or self.lab.session.do)(label, job)
        future.add_done_callback(done)
        return future

    def help_text(self) -> Text:
        """The keys of this screen and those that work everywhere."""
        c = self.app.theme_variables
        text = Text()
        # of the dialog: its frame, its scroll bar and the columns before the explanation
        room = max(20, min(96, int(0.96 * self.app.size.width)) - 6 - len(HANGING))
        for scope, title in ((self.NAME, self.NAME.capitalize()), ("app", "Everywhere")):
            text.append(f"{title}\n", f"bold {c['accent']}")
            for a in actions(scope):
                text.append(f"  {a.shown_key:>6} ", f"bold {c['primary']}")
                text.append(f"{a.label:<14}", "bold")
                lines = wrap(a.help, room)
                text.append(f" {HANGING.join(lines)}\n")
            text.append("\n")
        return text
