"""STOP by shared memory: what the loop answers counts, whatever else hangs."""

from __future__ import annotations

import os
import signal
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import PATIENCE_S, until

from zendsp.errors import NotStopped, Refused
from zendsp.link import Target, connect
from zendsp.link.programs import stopped
from zendsp.link.stop_page import StopPage, find
from zendsp_protocol import stop_page as page
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime

SLOW = """
#include "isr.h"
#include <time.h>
void UserInit(void) { nanosleep(&(struct timespec){.tv_nsec = 500000000}, 0); }
void UserISR_INT2(void) {}
"""


@pytest.fixture
def runtime() -> Iterator[Runtime]:
    with Runtime("imi_planar", clock="real", realtime=False, hang_s=60.0) as runtime:
        yield runtime


@pytest.fixture
def target(runtime: Runtime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Target]:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)
    monitor = Monitor(runtime, Options("paged", "imi_planar"))
    try:
        with connect("paged") as target:
            target.download("pd.c")
            target.start()
            yield target
    finally:
        monitor.close()


def _latched(target: Target) -> int:
    until(lambda: target.status().trip is not None, "a trip")
    trip = target.status().trip
    assert trip is not None and trip.reason == "stop"
    return trip.tick


def test_the_loop_takes_stop_from_shared_memory_and_says_at_which_sample(target: Target) -> None:
    found = find("paged")
    assert found is not None
    sample = found.taken(found.ask(), PATIENCE_S)
    assert sample == _latched(target)


def test_a_loop_that_hangs_is_not_stopped_and_stops_once_it_goes_on(
    target: Target, runtime: Runtime
) -> None:
    os.kill(runtime.runner_pid(), signal.SIGSTOP)
    try:
        with pytest.raises(
            NotStopped, match=r"NOT STOPPED: use the machine's emergency stop.*goes on or hangs"
        ):
            target.stop()
    finally:
        os.kill(runtime.runner_pid(), signal.SIGCONT)
    _latched(target)


def test_a_stop_asked_of_a_loop_that_died_is_latched_until_acknowledged(
    target: Target, runtime: Runtime
) -> None:
    found = find("paged")
    assert found is not None
    os.kill(runtime.runner_pid(), signal.SIGKILL)
    until(lambda: target.status().state == "crashed", "the crash is told")
    found.ask()
    _latched(target)
    with pytest.raises(Refused, match=r"STOP was requested.*acknowledge it first"):
        target.download("pd.c")
    target.acknowledge()
    target.download("pd.c")
    target.start()
    until(lambda: target.status().tick >= 20, "twenty samples")
    assert target.status().trip is None


def test_stop_is_latched_where_no_program_is_loaded(target: Target) -> None:
    target.unload()
    said = stopped(target.stop())
    assert said == "stopped: no program is loaded, nothing moves until acknowledged"
    with pytest.raises(Refused, match=r"STOP was requested.*acknowledge it first"):
        target.download("pd.c")
    target.acknowledge()
    target.download("pd.c")
    target.start(ticks=20)
    assert target.wait().trip is None


def test_a_stop_asked_while_a_program_loads_holds_that_program(
    target: Target, runtime: Runtime
) -> None:
    found = find("paged")
    assert found is not None
    before = runtime.runner_pid()
    refused: list[str] = []

    def load() -> None:
        try:
            target.download({"user.c": SLOW})
        except Refused as error:
            refused.append(str(error))

    loading = threading.Thread(target=load)
    loading.start()
    until(lambda: runtime.runner_pid() != before, "the old runner is gone")
    found.ask()
    loading.join()
    _latched(target)
    # asked before the new loop was there, the load itself is refused
    assert all("acknowledge it first" in reason for reason in refused)
    why = "no program is loaded" if refused else "acknowledge it first"
    with pytest.raises(Refused, match=why):
        target.start()


def test_only_the_page_of_this_run_and_version_is_used(
    target: Target, runtime: Runtime, tmp_path: Path
) -> None:
    assert find("another") is None
    assert find("paged", b"12345678") is None, "another run of the target"
    old = tmp_path / "old"
    old.write_bytes(struct.pack(page.HEAD, page.MAGIC, page.VERSION + 1).ljust(page.SIZE, b"\0"))
    with pytest.raises(OSError, match="another version"):
        StopPage(str(old))
    link = tmp_path / "link"
    link.symlink_to(runtime.stop_page())
    with pytest.raises(OSError, match=r"[Ll]ink"):
        StopPage(str(link))
    assert (
        Path(runtime.stop_page()).stat().st_mode & 0o077 == 0
    ), "nobody else may stop it past the target"
