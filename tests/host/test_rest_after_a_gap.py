"""A recording goes on until the machine is at rest, also when the target was frozen before the
trip.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from zendsp.errors import Incomplete
from zendsp.link import wait_recorded
from zendsp.link.wait_recorded import AFTER_TRIP_REAL_S, wait_done
from zendsp_protocol.messages import AcquireStatus, Status, Trip
from zendsp_protocol.states import ProgramState, RecorderState, TripReason

GAP_S = AFTER_TRIP_REAL_S + 0.5
TRIP = 5000  # sample, the first after the gap


class Frozen:
    """A target of 1 kHz that is frozen during a request, and then loses its host."""

    def __init__(self) -> None:
        self.now, self.ended_at = 0.0, 0

    def tick(self) -> int:
        return int(1000.0 * self.now) + 1000

    def recorder_status(self) -> AcquireStatus:
        stands = 0.5 < self.now < 1.0
        self.now += GAP_S if stands else 0.01
        state = RecorderState.DONE if self.ended_at else RecorderState.RUNNING
        return AcquireStatus(state, wanted=60_000, count=self.tick())

    def status(self) -> Status:
        self.now += 0.01
        trips = self.now > GAP_S
        trip = Trip(TripReason.STOP, tick=TRIP, text="STOP by a host") if trips else None
        state = ProgramState.STOPPED if trips else ProgramState.RUNNING
        return Status(state, trip=trip, tick=self.tick(), rate_hz=1e3)

    def end_ring(self) -> None:
        self.ended_at = self.tick()


def test_an_old_status_of_a_running_target_does_not_end_a_recording(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    target = Frozen()
    time = SimpleNamespace(monotonic=lambda: target.now, sleep=lambda s: None)
    monkeypatch.setattr(wait_recorded, "time", time)
    with pytest.raises(Incomplete, match=r"was stopped before .* rows\): STOP by a host"):
        wait_done(target.recorder_status, target.status, target.end_ring, 60.0, None)
    assert TRIP + 1000 <= target.ended_at < TRIP + 1100
