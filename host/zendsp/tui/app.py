"""The terminal application: four screens over one session, one table of actions."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial
from importlib import import_module
from pathlib import Path

from textual import events
from textual.actions import SkipAction
from textual.app import SystemCommand
from textual.driver import Driver
from textual.screen import ModalScreen, Screen
from textual.widgets import Input

from zendsp.here.ending import SOFT, let_go_of_terminal
from zendsp.tui.actions import ACTIONS, SCREENS, Action, bindings, in_keys
from zendsp.tui.colours import THEMES
from zendsp.tui.dialogs import Message
from zendsp.tui.dialogs.leave import Leave, becomes, may_move, moves
from zendsp.tui.port import Port
from zendsp.tui.runs import Outcome, Run
from zendsp.tui.screens.base import TALL, LabScreen
from zendsp.tui.session import Session
from zendsp.tui.snapshot import LinkState
from zendsp.tui.stopper import with_stop
from zendsp.tui.styles import OnceParsed
from zendsp.tui.targets import Targets
from zendsp.tui.typeahead import HELD_S, TypeAhead
from zendsp.tui.workspace import Workspace
from zendsp_isr.sources import gather, shipped_programs
from zendsp_protocol.states import LATCHED, DriveAction

READ_S = 1.0  # that a message stays, whatever is typed
LEAVE_S = 10  # within which a signal ends the process, whatever hangs
PUT_BACK_S = 5.0  # for a run that was stopped to put back what it has set


class ZendspApp(TypeAhead):
    """Console, Execute, Reference and Diagnose.

    Parameters
    ----------
    open_port : callable
        ``open_port(name) -> Port``.
    find_targets : callable, optional
        Returns the targets in reach as (name, description).
    start_machine : callable, optional
        ``start_machine(machine) -> (name, Port)`` starts a simulated machine here.
    machines : sequence of str
        What ``start_machine`` knows.
    folder : path
        Where references, runs and parameter sets are kept.
    source : path, optional
        C file to begin with.
    begin : str
        Machine to start here at once.
    channels : sequence of str
        Curves to begin with.
    frames : float
        Pictures a second; fewer for a slow line.
    """

    TITLE = "zendsp"
    CSS_PATH = "zendsp.tcss"
    ENABLE_COMMAND_PALETTE = True
    VERTICAL_BREAKPOINTS = [(0, "-low"), (TALL, "-high")]  # noqa: RUF012
    BINDINGS = bindings("app")

    def __init__(
        self,
        open_port: Callable[[str], Port],
        *,
        find_targets: Callable[[], list[tuple[str, str]]] | None = None,
        start_machine: Callable[[str], tuple[str, Port]] | None = None,
        machines: Iterable[str] = (),
        target: str = "",
        folder: Path = Path("."),
        source: Path | None = None,
        first: str = "console",
        theme: str = "zendsp-night",
        begin: str = "",
        frames: float = 30.0,
        channels: Sequence[str] = (),
    ) -> None:
        super().__init__()
        self.stylesheet = OnceParsed(variables=self.get_css_variables())
        self.session = Session(open_port)
        self.frame_s = 1.0 / frames
        self.channels = tuple(channels)
        self.model = ""  # model file that simulation and diagnosis were last given
        self.workspace = Workspace(folder)
        self.source = source
        self.targets = Targets(self, find_targets, start_machine, machines)
        self._target, self._first, self._theme_name, self._begin = target, first, theme, begin
        self.chosen: tuple[Path, ...] = ()  # references that Execute will play
        self._toasted: float | None = None  # when the last message was shown, monotonic
        self._marked = False  # the end of the first picture is told
        self._screens: dict[str, LabScreen] = {}
        self._awaited: tuple[Path, Callable[[Run], None]] | None = None

    # -- life

    def _kept(self, name: str) -> LabScreen:
        """The screen of a mode; it is made, and what it needs is loaded, when it is first shown."""
        if name not in self._screens:
            module = import_module(f"zendsp.tui.screens.{name}")
            self._screens[name] = getattr(module, f"{name.capitalize()}Screen")()
        return self._screens[name]

    async def on_mount(self) -> None:
        for theme in THEMES:
            self.register_theme(theme)
        for name in [n for n, theme in self.available_themes.items() if theme.ansi]:
            self.unregister_theme(name)  # their colours have no numbers to paint bars with
        self.theme = self._theme_name
        self.session.start()
        if not self.is_headless:  # it leaves the terminal as it was
            for number in SOFT:
                asyncio.get_running_loop().add_signal_handler(number, self._end, number)
        for name in SCREENS:
            self.add_mode(name, partial(self._kept, name))
        self._blind = not self.is_headless
        await self.switch_mode(self._first)
        if self._target:
            self.session.connect(self._target)
        elif self._begin:
            self.targets.connect([f"machine {self._begin}"])
        else:
            self.targets.look_around()

    def _end(self, number: int) -> None:
        """Leave once no screen is being built; what hangs meanwhile is ended by an alarm. Where the
        terminal is gone, at once: the policy for a lost host acts, as after ``kill -9``.
        """
        if let_go_of_terminal():
            os._exit(128 + number)
        signal.alarm(LEAVE_S)
        self.call_later(partial(self.exit, return_code=128 + number))

    def post_display_hook(self) -> None:
        """Tell when the first picture is drawn."""
        if self._blind and self.screen_stack and isinstance(self.screen, LabScreen):
            self._first_picture()

    def _first_picture(self) -> None:
        """Tell the process that reads the keys. The other screens are built when their keys are
        pressed: built here, all together, they kept F3 waiting for 2 to 6 s, and the word of a STOP
        for as long.
        """
        if self._marked:
            return
        self._marked = True
        stopper = self.session.stops.stopper
        if stopper is not None and stopper.picture():
            self.set_timer(HELD_S, self._see)  # should its word not come
        else:
            self._see()

    def on_unmount(self) -> None:
        self.session.close()

    # -- actions of the table that belong to no screen

    async def action_stop(self) -> None:
        """STOP."""
        stopper = self.session.stops.stopper
        if stopper is None or not stopper.stop():
            self.session.stops.stop()

    async def action_quit(self) -> None:
        """Leave. Where the machine moves, or may, first ask what shall become of it."""
        s = self.session.snapshot
        if not (moves(s) or may_move(s)):
            self.exit()
        elif not isinstance(self.screen, Leave):
            port = self.session.port
            here = port is not None and port.here
            self.push_screen(
                Leave(lambda: self.session.snapshot, self._plays, here=here), self._leave
            )

    def action_suspend(self) -> None:
        """Say why Ctrl+Z does not suspend the terminal."""
        s = self.session.snapshot
        left = f" ({becomes(s)})" if s.mine or moves(s) else ""
        text = f"nothing is suspended: a terminal that sleeps is a lost host{left}; Ctrl+Q leaves"
        self.session.events.add(text, "warning")
        self.toast(text, "warning")

    def action_help_quit(self) -> None:
        """On Ctrl+C where it ends nothing, say which keys leave and stop."""
        self.toast("Ctrl+C ends nothing here: Ctrl+Q leaves, F9 is STOP", "warning")

    def _leave(self, keys: list[str] | None) -> None:
        if keys == ["leave"]:
            self.exit()
        elif keys == ["stop"]:
            self.run_worker(self._stop_and_leave, thread=True, group="leave")

    def _stop_and_leave(self) -> None:
        """STOP, then leave. Stay where the machine is not known to have stopped: the banner says
        what to do.
        """
        try:
            self.session.stops.stop().result()
        except Exception:
            return
        deadline = time.monotonic() + PUT_BACK_S
        while self._plays() and time.monotonic() < deadline:
            time.sleep(0.02)
        self.call_from_thread(self.exit)

    def _plays(self) -> bool:
        """Whether a run is under way that will restore what it has set."""
        job = getattr(self._screens.get("execute"), "job", None)
        return job is not None and bool(job.busy)

    async def action_show(self, name: str) -> None:
        """Show a screen; not while a dialog waits for an answer."""
        if not isinstance(self.screen, ModalScreen) and self.current_mode != name:
            await self.switch_mode(name)

    def action_help(self) -> None:
        """Show the keys."""
        if isinstance(self.screen, LabScreen):
            self.push_screen(Message("Keys", self.screen.help_text()))

    def action_next_theme(self) -> None:
        """Change the colours."""
        names = [t.name for t in THEMES] + sorted(
            n for n in self.available_themes if not n.startswith("zendsp")
        )
        self.theme = names[(names.index(self.theme) + 1) % len(names)]

    def action_connect(self) -> None:
        """Choose a target."""
        self.targets.ask()

    def action_command(self) -> None:
        """Take the right to command, or give it back."""
        what = "take the command right"
        if self.session.snapshot.mine:
            self.session.do(
                "give back the command right", lambda port: port.drive(DriveAction.RELEASE)
            )
        elif self.session.snapshot.commander:
            who = self.session.snapshot.commander
            self.push_screen(
                Message(
                    "Take over",
                    f"{who} commands this target.\nTaking over ends that at once.",
                    agree="Take over",
                ),
                lambda yes: self.drive(what, DriveAction.TAKE, force=True) if yes else None,
            )
        else:
            self.drive(what, DriveAction.TAKE)

    def action_acknowledge(self) -> None:
        """Acknowledge a trip or a STOP.

        Where none is latched, the key goes to the widget with the focus, such as an input field:
        the target would pause the program on an acknowledgement. Under a dialog it is never a
        command.
        """
        now = self.session.snapshot
        latched = now.trip is not None or now.drive in LATCHED or now.crash
        nothing = now.link == LinkState.UP and not latched and self.session.stops.verdict is None
        beneath = isinstance(self.screen, ModalScreen)
        if nothing or beneath:
            if not isinstance(self.focused, Input):
                self.toast(
                    "nothing is latched, so there is nothing to acknowledge"
                    if nothing
                    else "Esc closes this first; then Ctrl+K acknowledges"
                )
            raise SkipAction
        if self.session.stops.unseen(self._typed):
            said = "the STOP was not shown yet when it was typed: acknowledge once more"
            self.toast(said, "warning")
            return
        self.session.stops.acknowledged()
        self.drive("acknowledge", DriveAction.ACKNOWLEDGE, trip=now.trip)

    # -- keys

    async def on_event(self, event: events.Event) -> None:
        """Remove the message from the bottom of a small terminal at the next key, before that key
        acts.
        """
        pressed = isinstance(event, events.Key) and not event.is_forwarded
        read = self._toasted is not None and time.monotonic() > self._toasted + READ_S
        if pressed and read and self.size.height < TALL:
            self._toasted = None
            self.clear_notifications()
        await super().on_event(event)

    def get_driver_class(self) -> type[Driver]:
        """The driver that reads the keys which the process of STOP hands on."""
        return with_stop(
            super().get_driver_class(),
            lambda: self.session.stops.stopper,
            lambda: self.session.stops.stop(),
        )

    # -- helpers of the screens

    def drive(self, label: str, action: DriveAction, **values: object) -> None:
        """Ask the drives for an action; a refusal is shown with its reason."""

        def done(future: Future[str]) -> None:
            error = future.exception()
            if error is not None:
                self.call_later(self.toast, f"{label}: {error}", "error")
            else:
                self.call_later(self._say, future.result() or f"{label}: done")

        self.session.do(label, lambda port: port.drive(action, **values)).add_done_callback(done)

    def _say(self, text: str) -> None:
        """Show a sentence on the screen in front."""
        screen = next((s for s in self.screen_stack[::-1] if isinstance(s, LabScreen)), None)
        if screen is not None:
            screen.say(text, "good")

    def play(self, path: Path) -> None:
        """Open a planned reference on Execute."""
        self.chosen = (path,)
        self.call_later(self.action_show, "execute")

    def diagnose(self, run: Run) -> None:
        """Open a run on Diagnose."""
        self.call_later(self._diagnose, run)

    async def _diagnose(self, run: Run) -> None:
        from zendsp.tui.screens.diagnose import DiagnoseScreen

        await self.action_show("diagnose")
        if isinstance(self.screen, DiagnoseScreen):
            self.screen.take_run(run)

    def await_run(self, reference: Path, then: Callable[[Run], None]) -> None:
        """Call ``then`` with the next run of a reference, on Diagnose."""
        self._awaited = (reference, then)

    def run_made(self, run: Run) -> None:
        """Hand a new run to the screen that waits for one."""
        if self._awaited is None or run.references != (self._awaited[0].name,):
            return
        (_, then), self._awaited = self._awaited, None
        if run.outcome == Outcome.COMPLETE:
            self.call_later(self.action_show, "diagnose")
            self.call_later(then, run)

    def source_texts(self) -> dict[str, str]:
        """The source that is being worked on, by file name; empty where there is none."""
        if self.source is None or not self.source.is_file():
            return {}
        return gather(self.source)

    def examples(self) -> list[Path]:
        """Return the programs that come with zendsp."""
        return shipped_programs()

    def toast(self, text: str, level: str = "information") -> None:
        """Show a short message over the screen; units in brackets are not read as markup.

        On a small terminal, where it would cover the values, it replaces the keys at the bottom
        until the next key, and the message before it.
        """
        if self.size.height < TALL:
            self.call_later(self.clear_notifications)  # also of those on their way
        self._toasted = time.monotonic()
        severity = (
            "error" if level == "error" else "warning" if level == "warning" else "information"
        )
        seconds = 15 if level == "error" else 6  # what went wrong takes longer to read
        self.notify(in_keys(text), severity=severity, timeout=seconds, markup=False)  # type: ignore[arg-type]

    def get_system_commands(self, screen: Screen[object]) -> Iterable[SystemCommand]:
        """Fill the command palette from the table of actions."""
        here = screen.NAME if isinstance(screen, LabScreen) else ""
        for a in sorted(ACTIONS, key=lambda a: a.scope not in ("app", here)):
            if a.name == "command_palette":
                continue
            where = "" if a.scope in ("app", here) else f" on {a.scope.title()}"

            def run(a: Action = a) -> None:
                self.call_later(self._run_named, a)

            yield SystemCommand(f"{a.label}{where} ({a.shown_key})", a.help, run)

    async def _run_named(self, action: Action) -> None:
        """Carry out the action that was chosen in the palette, on the screen to which it belongs.
        """
        if action.scope == "app":
            await self.run_action(action.name, self)
            return
        await self.action_show(action.scope)
        await self.run_action(action.name, self.screen)
