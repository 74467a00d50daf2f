"""Chooses the target that the terminal is connected to: one that answers, or a machine that is
started here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import cast

from textual.app import App

from zendsp.errors import ZendspError
from zendsp.tui.dialogs import Choose, Option
from zendsp.tui.lab import Lab
from zendsp.tui.port import Port


class Targets:
    """Finds targets, asks which one is meant, and connects to it.

    Parameters
    ----------
    app : App
        A :class:`~zendsp.tui.lab.Lab`: shows the question, and has the session that connects.
    find, start, machines
        ``find_targets``, ``start_machine`` and ``machines`` of the application.
    """

    def __init__(
        self,
        app: App[None],
        find: Callable[[], list[tuple[str, str]]] | None,
        start: Callable[[str], tuple[str, Port]] | None,
        machines: Iterable[str],
    ) -> None:
        self._app, self._lab = app, cast(Lab, app)
        self._session = self._lab.session
        self._find = find
        self._start = start
        self._machines = tuple(machines)

    def look_around(self) -> None:
        """Log the targets that answer, or what can be done without a target."""
        if self._find is not None:
            self._app.run_worker(self._look, thread=True, group="discovery")

    def ask(self) -> None:
        """Ask which target to connect to, or which machine to start."""
        self._lab.expect_dialog()
        self._app.run_worker(self._seek, thread=True, exclusive=True, group="discovery")

    def connect(self, keys: list[str] | None) -> None:
        """Connect to what was chosen: ``target NAME`` or ``machine NAME``."""
        if not keys:
            return
        what, _, name = keys[0].partition(" ")
        if what == "target":
            self._session.connect(name)
        elif self._start is not None:
            self._session.await_start(name)
            start = partial(self._start_here, self._start, name)
            self._app.run_worker(start, thread=True, exclusive=True, group="discovery")

    def _found(self) -> list[tuple[str, str]] | None:
        """The targets that answer; none where the search failed, which is logged."""
        try:
            return self._find() if self._find else []
        except ZendspError as error:
            self._session.events.add(f"discovery: {error}", "warning")
            return None

    def _look(self) -> None:
        found = self._found()
        if found is None:
            return
        for name, text in found:
            self._session.events.add(f"target {name} answers ({text}): Ctrl+O connects")
        if not found:
            self._session.events.add(
                "no target answers: Ctrl+O starts a simulated machine, F4 plans a motion,"
                " F5 diagnoses a file"
            )
        self._session.tell_found([name for name, _ in found])

    def _seek(self) -> None:
        options = [Option(f"target {name}", name, text) for name, text in self._found() or []]
        options += [
            Option(f"machine {m}", f"start {m} here", "a simulated machine in a process of its own")
            for m in self._machines
        ]
        self._app.call_from_thread(self._offer, options)

    def _offer(self, options: list[Option]) -> None:
        if options:
            self._app.push_screen(Choose("Connect to", options), self.connect)
            return
        self._lab.no_dialog()
        self._lab.toast(
            "no target answers, and none can be started from here; in a shell: zendsp target",
            "warning",
        )

    def _start_here(self, start: Callable[[str], tuple[str, Port]], machine: str) -> None:
        try:
            name, port = start(machine)
        except ZendspError as error:
            self._session.await_start("")
            self._session.events.add(f"start {machine}: {error}", "error")
            self._app.call_from_thread(self._lab.toast, str(error), "error")
            return
        self._session.adopt(port, name)
