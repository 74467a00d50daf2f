"""Whose recording the recorder holds: one host's at a time, each known by its number."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable

from zendsp_protocol import messages as m
from zendsp_protocol.errors import Refused
from zendsp_protocol.states import RecorderState
from zendsp_target.serving.guard import SEEN_S

# s since its host last asked about it, for a recording that is set up and not started, or complete
# and not brought home. A host asks 50 times a second while it waits; to copy 2 GB takes it 2 s.
HELD_S = 10.0
GOING = (RecorderState.ARMED, RecorderState.RUNNING)


class Claim:
    """Holds the recorder for the host that set it up, until its rows are brought home. Take
    ``lock`` around a check and what it permits.

    Parameters
    ----------
    recorder : callable
        The recorder's status.

    Attributes
    ----------
    owner : str
        The host; empty where nobody set it up for the program that is loaded.
    present : callable
        The hosts that are connected.
    """

    def __init__(self, recorder: Callable[[], m.AcquireStatus]) -> None:
        self._recorder = recorder
        self.owner = ""
        self.present: Callable[[], tuple[str, ...]] = tuple
        self.lock = threading.Lock()
        # when it set it up or started it, and when it last asked, by the monotonic clock
        self._since = self._asked = 0.0
        self._home = False  # all of its rows

    def check_free(self, by: str) -> None:
        """Refuse a host while another one's recording is set up, runs, or waits to be loaded."""
        owner = self.owner
        if not owner or owner == by or not self._there(owner):
            return
        waits = not self._home and time.monotonic() - self._asked < HELD_S
        if waits or self._recorder().state in GOING:
            own = _process(owner) == _process(by)
            who = f"another connection of your own process ({owner})" if own else owner
            raise Refused(
                f"{who} is recording; wait, or take the recorder over: acquire(…, take=True)"
                " or 'zendsp acquire --take'"
            )

    def _there(self, owner: str) -> bool:
        """Whether a host is connected: seen, or so new that it could not be seen yet."""
        return owner in self.present() or time.monotonic() - self._since < SEEN_S

    def gone(self, host: str) -> None:
        """Free the recorder of a host that is lost."""
        if host == self.owner:
            self.owner = ""

    def check_rows(self, begun: int | None, now: int, by: str) -> None:
        """Refuse a host that speaks of other rows than the recorder has.

        Parameters
        ----------
        begun : int or None
            Of the status that the host was told; None: whatever rows there are.
        now : int
            Of the rows that the recorder has.
        """
        if begun is not None and begun != now:
            who = "this host itself" if self.owner == by else self.owner or "another host"
            raise Refused(
                f"{who} began another recording on this target before this one was brought home:"
                " record again; acquire_load() brings home that one"
            )
        if by == self.owner:
            self._asked = time.monotonic()

    def take(self, by: str) -> None:
        """Give the recorder to a host that sets it up or starts it."""
        self.owner, self._home = by, False
        self._since = self._asked = time.monotonic()

    def loaded(self, by: str) -> None:
        """Free a recording that its host has brought home."""
        if by == self.owner and self._recorder().state not in GOING:
            self._home = True


def _process(host: str) -> str:
    """User, computer and process of a connection: its name without the number of the connection."""
    return re.sub(r"(:\d+)\.\d+$", r"\1", host)
