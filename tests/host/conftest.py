"""A server over a runtime without C, in this process, and hosts connected to it by real Zenoh
sessions.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fake_runtime import FakeRuntime

from zendsp.link import Target, connect
from zendsp_target.monitor import Monitor, Options


@pytest.fixture(autouse=True)
def _alone(own_registry: None) -> None:
    """Tests neither see nor disturb targets that really run here."""


@pytest.fixture
def runtime() -> FakeRuntime:
    return FakeRuntime()


@pytest.fixture
def monitor(runtime: FakeRuntime) -> Iterator[Monitor]:
    monitor = Monitor(runtime, Options("fake", "fake_machine"))
    yield monitor
    monitor.close()


@pytest.fixture
def target(monitor: Monitor) -> Iterator[Target]:
    with connect("fake") as target:
        yield target


@pytest.fixture
def running(target: Target) -> Target:
    target.download({"a.c": "int a;"})
    target.start()
    return target
