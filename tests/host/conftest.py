"""A server over a real runtime, in this process, and hosts connected to it by real Zenoh sessions.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from zendsp.link import Target, connect
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime

# q is the number of the sample, and what is opposite to it
COUNTING = """
#include "isr.h"
static double Kp1, Kd1, q[2], many[4096];
static bool on;
static table ref;
void UserInit(void) {
    PARAMETER(Kp1, 100.0, "N m/rad", 0.0, 1000.0, ""); PARAMETER(Kd1, 10.0, "N m s/rad", 0.0, 1000.0, "");
    PARAMETER(on, false, "", 0, 1, ""); SIGNAL(q, "rad", "positions"); SIGNAL(many, "", ""); TABLE(ref, 50000, 4, "rad", "");
}
void UserISR_INT2(void) { q[0] = (double)SAMPLE_TICK; q[1] = -q[0]; }
void UserBackground(void) {}
"""  # noqa: E501


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with Runtime("imi_planar", realtime=False) as made:
        yield made


@pytest.fixture
def monitor(runtime: Runtime) -> Iterator[Monitor]:
    monitor = Monitor(runtime, Options("fake", "imi_planar"))
    yield monitor
    monitor.close()


@pytest.fixture
def target(monitor: Monitor) -> Iterator[Target]:
    with connect("fake") as target:
        yield target


@pytest.fixture
def loaded(target: Target) -> Target:
    target.download({"a.c": COUNTING})
    return target


@pytest.fixture
def running(loaded: Target) -> Target:
    loaded.start()
    return loaded
