"""What is to become of a machine that moves, before the terminal is left."""

from __future__ import annotations

from zendsp.tui.dialogs.choose import Choose, Option
from zendsp.tui.snapshot import Snapshot

LEFT = {
    "stop": "the target stops it: if the host is lost, stop",
    "hold": "its program brings it to rest: if the host is lost, hold",
    "finish": "the program goes on: if the host is lost, finish",
}


def moves(s: Snapshot) -> bool:
    """Whether the program drives the machine now."""
    return s.link == "up" and s.state == "running" and s.drive not in ("stopped", "tripped")


def becomes(s: Snapshot) -> str:
    """What the machine does once this terminal is gone."""
    lets_go = s.mine or (s.moved_by == "you" and not s.commander)
    return LEFT.get(s.host_lost, s.host_lost) if lets_go else "the program goes on"


class Leave(Choose):
    """Ask; the result is ["stay"], ["stop"] or ["leave"].

    Parameters
    ----------
    here : bool
        The machine is simulated by this terminal, and ends with it.
    busy : bool
        A run of Execute is under way.
    """

    def __init__(self, s: Snapshot, here: bool, busy: bool) -> None:
        left = becomes(s)
        if here:
            left = "the simulated machine ends with this terminal"
        elif busy:
            left += "; what the run has set stays"
        super().__init__(
            "The machine moves",
            [
                Option("stay", "stay"),
                Option("stop", "STOP and quit", "stands until acknowledged"),
                Option("leave", "quit", left),
            ],
        )
