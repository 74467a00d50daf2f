"""A recording longer than the memory of the target."""

from __future__ import annotations

import resource
from types import SimpleNamespace
from typing import Any

import pytest

from zendsp.errors import AcquisitionError
from zendsp.link.acquire import Recorder
from zendsp.link.transfer import room


def test_a_long_recording_takes_memory_only_as_rows_arrive() -> None:
    status = SimpleNamespace(channels=("q",), first=0, count=0, state="stopped")
    recorder: Any = SimpleNamespace(_ask=lambda verb, patience, begun: status)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(AcquisitionError, match="ended after 0 of 100000000 rows"):
        Recorder._follow(recorder, 1, 100_000_000, "", None, 1.0, None)
    taken_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert taken_kb < 400_000, "of 800 MB that the whole recording will need"


@pytest.mark.parametrize("rows", [10**13, 2**62])
def test_more_rows_than_the_computer_can_hold_are_refused_in_words(rows: int) -> None:
    """It was numpy's "Unable to allocate 7.28 TiB"."""
    with pytest.raises(AcquisitionError, match="GB, more than this computer has: acquire for a"):
        room(rows, 2)
