"""Targets that are started and ended, in every way that there is."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Iterator

from hardships.place import Growth, Place, Tally, until

PROMISE = (
    "a target that is ended, however, leaves no process, no entry and no shared memory, and the"
    " next one starts"
)
ENDS = ("close", "SIGTERM", "SIGINT", "SIGKILL")


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    growth = Growth(os.getpid(), warm=2 * len(ENDS))
    swept: list[int] = []
    for end in itertools.cycle(ENDS):
        target = place.local("again", clock="fast")
        pid = target.info.pid
        try:
            for dead in swept:
                tally.expect(
                    not place.shared(dead),
                    "shared memory of a killed target is left after the next start",
                )
            swept.clear()
            target.download("pd.c")
            tally.expect(target.run_for(0.05).tick == 50, "50 samples are not 50")
            if end != "close":
                os.kill(pid, getattr(signal, end))
        finally:
            target.close()
        tally.count(f"ended by {end}")
        tally.expect(
            until(lambda: not place.processes()), f"{end} leaves processes: {place.processes()}"
        )
        if end == "SIGKILL":
            swept.append(pid)  # nobody was left to clear up: the next one does
        else:
            left = [path.name for path in place.folder.iterdir()]
            tally.expect(not left, f"{end} leaves {', '.join(left)}")
            tally.expect(not place.shared(pid), f"{end} leaves shared memory")
        megabytes, files, threads = growth.look()
        tally.measure("growth of the host, MB", megabytes)
        tally.expect(
            files <= 4 and threads <= 4, f"the host has {files} files and {threads} threads more"
        )
        yield
