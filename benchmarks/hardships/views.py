"""Live views for hours: of a screen, of a callback, of a reader that is too slow, opened and closed
again and again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

from hardships.place import Growth, Place, Tally
from zendsp.link.live import LiveBlock

PROMISE = (
    "live views show each row in order, count what they miss, and neither host nor target grows"
)
ROUND_S = 2.0
WARM = 8  # rounds: views keep ten seconds
MOST_MB = 24.0  # of growth, however long it lasts; allocators keep some
CHANNELS = ("q", "tau", "e")


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    with place.local("watched") as target:
        target.download("pd.c")
        target.start()
        growth = {"target": Growth(target.info.pid, WARM), "host": Growth(os.getpid(), WARM)}
        taken: list[LiveBlock] = []
        with (
            target.live(CHANNELS, interval=0.02) as screen,
            target.live(CHANNELS, callback=taken.append) as called,
            target.live(CHANNELS, interval=0.001) as slow,
        ):
            following = -1
            while True:
                deadline = time.monotonic() + ROUND_S
                while time.monotonic() < deadline:
                    screen.window()
                    screen.latest()
                    slow.next_block(0.0)  # one of many: the rest drops out of its backlog
                    time.sleep(1 / 30)  # as a screen does
                blocks, taken[:] = list(taken), []
                rows = 0
                for block in blocks:
                    if following >= 0:
                        tally.expect(
                            block.tick == following + block.gap,
                            f"row {block.tick} after {following}, {block.gap} missed",
                        )
                    following = block.tick + len(block.t)
                    rows += len(block.t)
                tally.expect(rows > 0, "no rows arrive")
                tally.count("rows in order", rows)
                with target.live(["q"], interval=0.02) as short:
                    tally.expect(short.next_block(10.0), "a new view shows nothing")
                tally.count("views opened")
                for who, its in growth.items():
                    megabytes, files, threads = its.look()
                    tally.measure(f"growth of the {who}, MB", megabytes)
                    tally.expect(megabytes < MOST_MB, f"the {who} grew by {megabytes:.1f} MB")
                    tally.expect(
                        files <= 4 and threads <= 4,
                        f"the {who} has {files} files and {threads} threads more",
                    )
                tally.measure("rows missed by the callback", called.lost)
                yield
