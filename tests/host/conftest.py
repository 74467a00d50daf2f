"""A server over a runtime without C, in this process, and hosts connected to it by real Zenoh
sessions.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from zendsp.link import Target, connect
from zendsp_target.monitor import Monitor, Options

sys.path.insert(0, str(Path(__file__).parent))
from fake_runtime import FakeRuntime


@pytest.fixture(autouse=True)
def _own_registry(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tests neither see nor disturb targets that really run here."""
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path_factory.mktemp("registry")))
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)


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
