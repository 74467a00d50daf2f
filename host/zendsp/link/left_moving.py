"""A script that ends and leaves a machine in motion says so: nobody else would."""

from __future__ import annotations

import atexit
import sys
import weakref
from typing import TYPE_CHECKING

from zendsp_protocol.states import HostLost, ProgramState

if TYPE_CHECKING:
    from zendsp.link.link import Link
    from zendsp_protocol import messages as m

ANSWER_S = 0.5  # that the end of a script waits for a target; a healthy one takes milliseconds
DOES = {
    HostLost.STOP: "it stops now",
    HostLost.HOLD: "it comes to rest now and holds",
    HostLost.FINISH: "it goes on",
}

_started: weakref.WeakSet[Link] = weakref.WeakSet()
_commanded: weakref.WeakSet[Link] = weakref.WeakSet()


def started(link: Link) -> None:
    """Note the link by which this process started a program."""
    _started.add(link)


def commanded(link: Link) -> None:
    """Note the link by which this process may have taken the right to command."""
    _commanded.add(link)


def ended(link: Link) -> None:
    """Note that it is closed on purpose."""
    _started.discard(link)
    _commanded.discard(link)


def say(link: Link, on_purpose: bool = False) -> None:
    """Say on standard error what becomes of a program that this process started, or has the right
    to command, if it runs.

    Parameters
    ----------
    on_purpose : bool
        The link is closed as the script says: that the machine moves on is what it wants.
    """
    begun = link in _started
    if not begun and link not in _commanded:
        return
    ended(link)
    try:
        status: m.Status = link.request("status", {}, ANSWER_S)
        drive: m.DriveStatus = link.request("drive_status", {}, ANSWER_S)
    except Exception:  # at the end of a process: what there is to say is said, and no more
        return
    if status.state != ProgramState.RUNNING:
        return
    words = "the machine moves on: 'zendsp pause' pauses it, 'zendsp stop' stops it"
    if link.author in (drive.commander, drive.moved_by):
        words = f"the machine was this script's to command: {DOES[drive.host_lost]}"
    elif on_purpose or not begun:
        return
    print(f"zendsp: {link.target}: {words}", file=sys.stderr)


@atexit.register  # after that of `background`, and so called before the links are closed
def _say_all() -> None:
    for link in {*_started, *_commanded}:
        say(link)
