"""The host-lost policy acts in the worst case, too."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from zendsp_protocol import keys
from zendsp_protocol.errors import Refused
from zendsp_target.access.hosts import BACK_S, Hosts
from zendsp_target.api import RECORDER, AcquireConfig
from zendsp_target.runtime import Runtime
from zendsp_target.serving.drives import Drives

PROGRAM = """
#include "isr.h"
static double a;
static bool hold;
void UserInit(void) {
    PARAMETER(a, 1.0, "", NO_MIN, NO_MAX, "");
    PARAMETER(hold, false, "", NO_MIN, NO_MAX, "");
}
void UserISR_INT2(void) {}
"""


@pytest.mark.parametrize("full", [False, True])
def test_a_machine_that_cannot_be_told_to_hold_stops(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None], full: bool
) -> None:
    """A host writes faster than a slow loop reads, so that there is no room for another message."""
    runtime = make_runtime(PROGRAM, clock="real", realtime=False, rate_hz=1.0)
    drives = Drives(runtime)
    drives.take("anna@a:1", False)
    drives.set_policy("hold", "anna@a:1")
    runtime.start()
    if full:
        # 16 are taken in a sample
        with pytest.raises(Refused, match="updates wait already"):
            for k in range(1000):
                runtime.write({"a": float(k)}, "bo@b:2")
    assert drives.host_gone("anna@a:1") == ("stop" if full else "hold")
    if full:
        wait_for(lambda: runtime.status().trip is not None)
        trip = runtime.status().trip
        assert trip is not None and trip.reason == "host lost"
    else:
        wait_for(lambda: runtime.read(["hold"])[1]["hold"] is True)
        assert runtime.status().trip is None


def test_a_recording_ends_where_the_loop_had_stopped_the_machine_by_itself(
    make_runtime: Callable[..., Runtime], wait_for: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The monitor was frozen and did not see that the host was lost; a continuous recording had
    then gone on for ever.
    """
    monkeypatch.setattr("zendsp_target.serving.drives.AFTER_TRIP_S", 0.05)
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    drives = Drives(runtime)
    drives.take("anna@a:1", False)
    runtime.start()
    runtime.acquire_configure(RECORDER, AcquireConfig(("a",), continuous=True))
    runtime.acquire_start(RECORDER)
    runtime.trip("host lost")  # as the loop does it
    wait_for(lambda: runtime.status().state == "stopped")
    assert runtime.acquire_status(RECORDER).state == "running"
    drives.host_gone("anna@a:1")
    wait_for(lambda: runtime.acquire_status(RECORDER).state == "done")


def test_that_a_host_is_lost_is_acted_upon_without_a_thread_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The system may refuse another one at that very moment."""
    lost: list[str] = []
    hosts = hosts_of(lost)
    hosts._change("anna@a:1", gone=False)

    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    hosts._change("anna@a:1", gone=True)
    assert lost == ["anna@a:1"]


DELETE, PUT = zenoh.SampleKind.DELETE, zenoh.SampleKind.PUT


def hosts_of(lost: list[str]) -> Hosts:
    """The hosts of a target without a session; who is lost is added to a list."""
    liveliness = SimpleNamespace(declare_subscriber=lambda *_, **__: None)
    session: Any = SimpleNamespace(liveliness=lambda: liveliness)
    return Hosts(cast(zenoh.Session, session), "imi", lost.append)


def told(hosts: Hosts, key: str, kind: zenoh.SampleKind) -> None:
    sample: Any = SimpleNamespace(kind=kind, key_expr=key)
    (hosts._left if key.endswith("left") else hosts._changed)(sample)


def test_a_process_that_runs_may_come_back_and_one_that_ends_is_lost_at_once(
    monkeypatch: pytest.MonkeyPatch, wait_for: Callable[..., None]
) -> None:
    """A busy computer had lost the link of a host that was alive, and its machine was stopped."""
    lost: list[str] = []
    hosts = hosts_of(lost)
    with subprocess.Popen(["sleep", "60"]) as process:
        here = f"anna@{os.uname().nodename}:{process.pid}"
        key = keys.host("imi", here)
        told(hosts, key, PUT)
        told(hosts, key, DELETE)
        assert here in hosts and not lost, "its process runs"
        told(hosts, key, PUT)
        told(hosts, key, DELETE)
        told(hosts, keys.left("imi", here), PUT)
        wait_for(lambda: lost == [here])  # it says itself that it leaves
        told(hosts, key, PUT)
        begun = time.monotonic()
        told(hosts, key, DELETE)
        process.send_signal(signal.SIGSTOP)
        wait_for(lambda: lost == [here, here])  # it is stopped, and cannot come back
        told(hosts, key, PUT)
        told(hosts, key, DELETE)
        process.kill()
        process.wait()
        wait_for(lambda: lost == 3 * [here])  # it has ended
        assert time.monotonic() - begun < BACK_S
    monkeypatch.setattr("zendsp_target.access.hosts.BACK_S", 0.1)
    own = f"anna@{os.uname().nodename}:{os.getpid()}"
    told(hosts, keys.host("imi", own), PUT)
    told(hosts, keys.host("imi", own), DELETE)
    wait_for(lambda: lost[-1] == own and own not in hosts)  # it did not come back in time
    elsewhere = keys.host("imi", "bo@elsewhere:1")
    told(hosts, elsewhere, PUT)
    told(hosts, elsewhere, DELETE)
    assert "bo@elsewhere:1" not in hosts, "of another computer nothing is known"
