"""Applies the rules of the drives before the handler of every verb that could move or change
something.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from zendsp_protocol import messages as m
from zendsp_protocol import verbs
from zendsp_protocol.errors import Refused
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.drives import TAKING, Drives
from zendsp_target.serving.first_start import FirstStart

Handler = Callable[[Any, str], Any]

# What could move the machine or change what moves it; STOP is not among them.
COMMANDING = (
    "start", "pause", "load", "unload", "write", "update", "table_commit", "set_limits",
    "set_drive", "set_ramp", "set_overrun", "set_inputs", "home", "acknowledge", "run_begin",
)
# those of them that only change values
CHANGES = ("write", "update", "table_commit", "run_begin")
# fields of other requests after which the loss of the host matters
WATCHED = {"start": "attended", "run_begin": "moves"}
SEEN_S = 1.0  # for the token of a host to arrive after its first request


class Guard:
    """Checks requests before their handlers are called.

    Parameters
    ----------
    drives : Drives

    Attributes
    ----------
    sees : callable
        Whether a host is connected, as far as is known.
    lost : callable
        What to do where it is no more.
    """

    def __init__(self, drives: Drives) -> None:
        self._drives = drives
        self._first_start = FirstStart()
        self.sees: Callable[[str], bool] = lambda host: True
        self.lost: Callable[[str], object] = drives.host_gone

    def enter(self, handlers: dict[str, Handler]) -> None:
        """Wrap every handler that could move something in the rules, and add the verbs of the
        sequence.
        """
        for name in COMMANDING:
            handlers[name] = self._guarded(name, handlers[name])
        handlers["drive"] = self._drive
        handlers["drive_status"] = lambda args, by: self._drives.status()

    def _drive(self, args: verbs.Drive, by: str) -> m.Said:
        def act() -> m.Said:
            return m.Said(text=self._drives.act(args, by))

        said: m.Said = self.watched(by, act) if args.action in TAKING else act()
        return said

    def _guarded(self, name: str, handler: Handler) -> Handler:
        drives = self._drives

        def change(args: Any, by: str) -> Any:
            if drives.commander:
                drives.check_right(by)
            return handler(args, by)

        def run(args: Any, by: str) -> Any:
            drives.check_right(by)
            if name == "start":
                self._first_start.check(by)
            said = drives.before(name, args)
            if said is not None:
                return m.Said(text=said)
            result = self._load(handler, args, by) if name == "load" else handler(args, by)
            drives.after(name, args, by)
            if name == "start":
                self._first_start.started(by)
            return result

        act = change if name in CHANGES else run

        def watched(args: Any, by: str) -> Any:
            moves = name == "home" or getattr(args, WATCHED.get(name, ""), False)
            return self.watched(by, lambda: act(args, by)) if moves else act(args, by)

        return watched if name in (*WATCHED, "home") else act

    def _load(self, handler: Handler, args: Any, by: str) -> Any:
        """Load, and remember who did."""
        self._first_start.loading(by)
        try:
            result = handler(args, by)
        except BaseException:
            self._first_start.failed(by)
            raise
        self._first_start.loaded(by)
        return result

    def watched(self, by: str, do: Callable[[], Any]) -> Any:
        """Carry out ``do``, which makes a host one whose loss must be noticed; refused for a host
        whose loss could not be.

        Raises
        ------
        Later
            It is not seen yet.
        """

        def done() -> Any:
            result = do()
            if not self.sees(by):  # lost in between, before anything counted as its own
                self.lost(by)
            return result

        def later() -> Any:
            deadline = time.monotonic() + SEEN_S
            while not self.sees(by):
                if time.monotonic() > deadline:
                    raise Refused(
                        f"{by} is not among the hosts that this target sees, and would be lost"
                        " unnoticed: close other connections (256 hosts of a user are seen; zendsp"
                        " info names them); a client of your own has to show its token"
                    )
                time.sleep(0.002)
            return done()

        if self.sees(by):
            return done()
        raise Later(later)
