"""The question what shall become of a moving machine when the terminal is left."""

from __future__ import annotations

from collections.abc import Callable

from zendsp.tui.dialogs.choose import Choose, Option
from zendsp.tui.snapshot import LinkState, Snapshot
from zendsp_protocol.states import LATCHED, ProgramState

LOOK_S = 0.2  # between looks at the machine beneath
LEFT = {
    "stop": "the target stops it: if the host is lost, stop",
    "hold": "its program brings it to rest: if the host is lost, hold",
    "finish": "the program goes on: if the host is lost, finish",
}


def moves(s: Snapshot) -> bool:
    """Whether the program drives the machine now."""
    return s.link == LinkState.UP and s.state == ProgramState.RUNNING and s.drive not in LATCHED


def may_move(s: Snapshot) -> bool:
    """Whether the program drove the machine when the link was lost, and nothing says that it ended.
    """
    drove = s.state == ProgramState.RUNNING and s.drive not in LATCHED
    return s.link == LinkState.LOST and drove and not s.gone


def becomes(s: Snapshot) -> str:
    """A sentence on what the machine does once this terminal is gone."""
    lets_go = s.mine or (s.moved_by == "you" and not s.commander)
    return LEFT.get(s.host_lost, s.host_lost) if lets_go else "the program goes on"


def stands(s: Snapshot) -> str:
    """A title that says whether the machine moves, and if not, why."""
    if moves(s):
        return "The machine moves"
    if s.link != LinkState.UP:
        return "The link is lost"
    latched = s.drive in LATCHED
    return f"The machine is {s.drive}" if latched else "The machine stands"


class Leave(Choose):
    """Ask; the result is ["stay"], ["stop"] or ["leave"]. The text follows the state of the
    machine.

    Parameters
    ----------
    look : callable
        Returns what is known of the target now.
    busy : callable
        Whether a run of Execute is under way.
    here : bool
        The machine is simulated by this terminal, and ends with it.
    """

    def __init__(
        self, look: Callable[[], Snapshot], busy: Callable[[], bool], *, here: bool
    ) -> None:
        self._look, self._busy, self._ends = look, busy, here
        super().__init__(stands(look()), self._ways())

    def on_mount(self) -> None:
        """Read the state of the machine as often as numbers on the screen change."""
        super().on_mount()
        self.set_interval(LOOK_S, self._see)

    def _see(self) -> None:
        ways = self._ways()
        self.query_one(".box").border_title = stands(self._look())
        if ways != self._options:
            self._options = ways
            self._fill(self._words)

    def _ways(self) -> tuple[Option, ...]:
        s = self._look()
        left = becomes(s) if moves(s) or may_move(s) else ""
        if self._ends:
            left = "the simulated machine ends with this terminal"
        elif self._busy():
            left = f"{left}; what the run has set stays".removeprefix("; ")
        return (
            Option("stay", "stay"),
            Option("stop", "STOP and quit", "stands until acknowledged"),
            Option("leave", "quit", left),
        )
