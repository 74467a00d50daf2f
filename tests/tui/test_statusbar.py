"""The bar at the top of every screen, by what it says."""

from __future__ import annotations

import pytest

from zendsp.tui.statusbar import banner_lines
from zendsp.tui.stopper import EMERGENCY


@pytest.mark.parametrize(
    ("width", "lines"),
    [
        (67, [f" ■ {EMERGENCY} "]),  # of 80 columns, beside the red field
        (47, ["NOT STOPPED: use the machine's emergency stop"]),
        (27, ["NOT STOPPED: use the", "machine's emergency stop"]),
        (12, ["NOT STOPPED:", "use the …"]),
        (11, ["NOT", "STOPPED: …"]),
    ],
)
def test_how_stop_ended_is_said_on_narrow_terminals_too(width: int, lines: list[str]) -> None:
    assert banner_lines(EMERGENCY, width) == lines
    assert all(len(line) <= width for line in lines)


@pytest.mark.parametrize("width", range(12))
def test_stop_is_said_on_a_bar_that_has_no_room_yet(width: int) -> None:
    """A screen that is built at that moment has no size; an error there would be the end of it."""
    assert banner_lines("stopped, at sample 209956", width)
