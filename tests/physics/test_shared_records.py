"""What the kernel points to stays where it is, whatever other threads make of a record."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event
from typing import Any

import pytest
from test_facts import MODEL, recording

from zendsp.diagnosis.data.prepare import prepare
from zendsp.physics.calibration import joint
from zendsp.physics.calibration.joint import JointRecord


def raced(
    monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, ask: Callable[[], Any]
) -> tuple[Any, Any]:
    """The answers of two threads that both found nothing and make it: the second makes it when the
    first has its answer, and the kernel points to that.
    """
    both, first_has_it, real = Barrier(2), Event(), getattr(owner, name)

    def made(*args: Any) -> Any:
        if both.wait(5.0):
            assert first_has_it.wait(5.0)
        return real(*args)

    def asked(_: int) -> Any:
        answer = ask()
        first_has_it.set()
        return answer

    monkeypatch.setattr(owner, name, made)
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(asked, range(2))
    monkeypatch.setattr(owner, name, real)
    return one, other


def test_gains_that_two_threads_make_are_the_first_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel read the gains of the thread that came first after the other's had replaced them:
    memory that was free. One diagnosis in ten was another one.
    """
    record = prepare([recording(4.0, 0.9)], MODEL).records[0][0]
    one, other = raced(monkeypatch, JointRecord, "_unrest", lambda: record.gains(24.0))
    assert one is other is record.gains(24.0)


def test_an_integral_that_two_threads_make_is_the_first_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record = prepare([recording(4.0, 0.9)], MODEL).records[0][0]
    record._once.clear()
    one, other = raced(monkeypatch, joint.np, "cumsum", lambda: record.integral)
    assert one is other is record.integral


def test_a_thread_gets_the_thinned_record_that_it_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record = prepare([recording(4.0, 0.9)], MODEL).records[0][0]
    asked = iter((2, 4))
    one, other = raced(
        monkeypatch, joint, "thin_measurement", lambda: record.thinned(next(asked))
    )
    assert {one.every, other.every} == {2, 4}
