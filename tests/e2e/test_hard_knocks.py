"""What goes wrong in a lab: crashes, kills, cut cables, and hosts that fight over one target."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import children, kill, python, relay_to, running
from waiting import PATIENCE_S, freeze, until

import zendsp
from zendsp.errors import LinkError, Refused, RunnerDied
from zendsp.link import Target
from zendsp.link.link import Link
from zendsp_isr.compiler import find_compiler
from zendsp_protocol import codec

HEAD = (
    '#include "isr.h"\nstatic int32_t n;\nvoid UserBackground(void) {}\n'
    'void UserInit(void) { SIGNAL(n, "", ""); }\n'
)
CRASH = HEAD + "void UserISR_INT2(void) { if (++n == 500) *(volatile int *)8 = 1; }\n"
HANG = HEAD + "void UserISR_INT2(void) { if (++n == 500) for (;;) ; }\n"

PAIRS = """#include "isr.h"
static int32_t set[64]; static double a, b, c; static int32_t mixed, changes, last;
void UserInit(void) {
    PARAMETER_ARRAY(set, "", -2147483647, 2147483647, "");
    PARAMETER(a, 0, "", NO_MIN, NO_MAX, ""); PARAMETER(b, 0, "", NO_MIN, NO_MAX, ""); PARAMETER(c, 0, "", NO_MIN, NO_MAX, "");
    SIGNAL(mixed, "", "samples at which not all were equal"); SIGNAL(changes, "", "");
}
void UserISR_INT2(void) {
    for (int i = 0; i < 64; i++)
        if (set[i] != set[0]) { mixed++; break; }
    if (a != set[0] || b != a || c != a) mixed++;
    if (set[0] != last) { changes++; last = set[0]; }
}
void UserBackground(void) {}
"""  # noqa: E501

WRITER = """
import sys, zendsp
from zendsp.errors import LinkError
with zendsp.connect(sys.argv[1]) as target:
    base, n = int(sys.argv[2]) * 1_000_000, 0
    print("ready", flush=True)
    while True:
        n += 1
        value = base + n
        try:
            target.update(set=[value] * 64, a=float(value), b=float(value), c=float(value))
        except LinkError:  # not answered in its time, on a busy computer: the next one may be
            pass
"""

BUSY_HOST = """
import sys, zendsp
target = zendsp.connect(sys.argv[1])
view = target.live(["q", "tau"])
target.acquire_configure(["q", "tau"], seconds=30.0)
target.acquire_start()
view.next_block(30.0)
print("ready", flush=True)
while True:
    target.load_rows(0, target.acquire_status().count, 4)
    target.update(Kp1=2000.0)
"""


@pytest.mark.parametrize(("code", "how"), [(CRASH, "SIGSEGV"), (HANG, "UserISR_INT2")])
def test_user_code_that_crashes_or_hangs_takes_down_the_runner_only(
    fast: Target, code: str, how: str
) -> None:
    fast.download({"bad.c": code})
    with pytest.raises(RunnerDied, match=how):
        fast.acquire(["n"], seconds=5.0, start=True)
    status = fast.status()
    # sample 498 or 499
    assert status.state == "crashed" and how in status.crash and "49" in status.crash
    assert how in fast.read(["n"]).ended  # its last values, and said to be that
    rec = fast.acquire_load()
    assert np.array_equal(rec["n"], np.arange(1.0, len(rec) + 1)) and len(rec) == 499
    with pytest.raises(RunnerDied):
        fast.start()
    fast.download("pd.c")
    assert fast.run_for(0.1).state == "paused"


def test_a_killed_host_disturbs_nothing(real: Target) -> None:
    host = python(BUSY_HOST, real.name)
    assert host.stdout is not None and host.stdout.readline() == "ready\n"
    until(lambda: len(real.status().hosts) == 2, "both hosts are seen")
    before = real.status()
    kill(host)
    until(lambda: len(real.status().hosts) == 1, "the killed host is forgotten")
    until(lambda: real.status().tick > before.tick + 200, "the loop goes on")
    assert real.status().state == "running"
    assert len(real.acquire(["q"], seconds=0.2)) == 200  # its recorder is free again
    views = [real.live(["q"], decimation=k + 1) for k in range(7)]  # and so are its live streams
    for view in views:
        view.close()


def test_closing_a_host_in_the_middle_of_a_transfer_leaves_the_target_alive(real: Target) -> None:
    rows = real.acquire(["q", "tau", "e"], seconds=1.0)
    for _ in range(3):
        other = zendsp.connect(real.name)
        broken: list[BaseException] = []

        def load(other: Target = other, broken: list[BaseException] = broken) -> None:
            try:
                while True:
                    other.load_rows(0, len(rows), 6, patience=0.1)
            except LinkError as error:
                broken.append(error)

        thread = threading.Thread(target=load)
        thread.start()
        time.sleep(0.05)  # any moment will do: the promise holds at each
        other.close()
        thread.join(PATIENCE_S)
        assert not thread.is_alive() and broken
    assert real.status().state == "running"


def test_a_killed_target_is_reported_within_the_lease_and_leaves_no_runner_behind(
    real: Target,
) -> None:
    pid = real.info.pid
    runners = children(pid)
    assert runners
    os.kill(pid, signal.SIGKILL)
    start = time.monotonic()
    with pytest.raises(LinkError, match="is gone"):
        while time.monotonic() - start < PATIENCE_S:
            real.status()
    until(lambda: not real.alive, "the link knows")
    until(lambda: not any(map(running, runners)), "the runner has ended")
    assert zendsp.discover(real.name) == []


def test_a_stopped_target_is_an_error_and_never_silence(real: Target) -> None:
    freeze(real.info.pid)
    try:
        with pytest.raises(LinkError):  # after 1 s by the lease, or the request's own 5 s
            real.status()
    finally:
        os.kill(real.info.pid, signal.SIGCONT)
    until(lambda: real.alive, "the link is back by itself")
    assert real.status().state == "running"


def test_a_local_target_ends_with_the_host_that_started_it() -> None:
    code = (
        "import zendsp, time; t = zendsp.local('imi_planar', clock='fast'); print(t.info.pid,"
        " flush=True); time.sleep(999)"
    )
    host = python(code)
    assert host.stdout is not None
    pid = int(host.stdout.readline())
    assert running(pid)
    kill(host)
    until(lambda: not running(pid), "the target has ended")


def test_a_local_target_ends_when_nothing_refers_to_it_and_in_no_fork_of_its_host() -> None:
    """A notebook's cell that was run twice left the first one's machine running."""
    target = zendsp.local("imi_planar", clock="fast")
    pid, info = int(target.info.pid), target.info
    if not (child := os.fork()):
        del target
        time.sleep(0.3)
        os._exit(0)
    os.waitpid(child, 0)
    assert target.info == info and target.status().state == "empty" and running(pid)
    del target
    until(lambda: not running(pid), "the target has ended")


def test_any_number_of_hosts_at_once_never_mix_an_update(start: Callable[..., Target]) -> None:
    # a hundred times real time: the loop leaves a busy computer's processors to those who write
    fast = start(clock="fast", options=["--speed", "100"])
    fast.download({"pairs.c": PAIRS})
    fast.start()
    writers = [python(WRITER, fast.name, str(k + 1)) for k in range(2)]
    try:
        for writer in writers:
            assert writer.stdout is not None and writer.stdout.readline() == "ready\n"
        until(lambda: fast["changes"] >= 500, "the writers get through", lambda: fast["changes"])
        for writer in writers:
            assert writer.poll() is None
    finally:
        for writer in writers:
            kill(writer)
    assert fast["mixed"] == 0


def test_every_acknowledged_write_takes_effect(fast: Target) -> None:
    fast.download({"pairs.c": PAIRS})
    fast.start()
    ticks = []
    for k in range(1, 201):
        ticks.append(fast.update(a=float(k)))
        reading = fast.read(["a", "tick"])
        assert reading["a"] == float(k), "an acknowledged write was lost"
    log = [change for change in fast.log() if change.name == "a"]
    assert [change.new for change in log] == [float(k) for k in range(1, 201)]
    assert [change.tick for change in log] == ticks and ticks == sorted(ticks)


def test_a_transfer_resumes_after_the_cable_was_cut(fast: Target) -> None:
    fast.download("pd.c")
    whole = fast.acquire(["q", "e", "tau"], seconds=300.0, start=True)
    with (
        relay_to(fast.link.endpoints[0]) as relay,
        zendsp.connect(fast.name, connect=relay.endpoint) as far,
    ):
        relay.cut_after = relay.passed + whole.data.nbytes // 2
        mender = threading.Timer(1.5, relay.mend)
        mender.start()
        again = far.acquire_load(patience=PATIENCE_S)
        mender.join()
        assert relay.passed > whole.data.nbytes
        assert np.array_equal(again.data, whole.data) and again.lost == 0
        far.update(Kp1=1.0)  # and the connection is as good as new
        view = far.live(["tick"])
        fast.start()
        until(lambda: view.received > 0, "live rows arrive through the relay")
        relay.cut()
        until(lambda: not far.alive, "the cut is noticed")
        seen = view.received
        relay.mend()
        until(lambda: view.received > seen, "live rows arrive again by themselves")


def test_a_recording_is_whole_wherever_the_cable_was_cut_while_it_came_home(
    fast: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is cut before each request of the transfer, and once within its data."""
    fast.download("pd.c")
    fast.acquire_configure(["q", "tau"], seconds=20.0)
    fast.acquire_start()
    fast.start(ticks=10_000)
    fast.wait(PATIENCE_S)
    fast.update(Kp1=123.0)
    fast.start(ticks=10_000)
    fast.wait(PATIENCE_S)
    whole = fast.acquire_load()
    assert whole.parameters["Kp1"] == 123.0 and whole.sources and whole.log
    with (
        relay_to(fast.link.endpoints[0]) as relay,
        zendsp.connect(fast.name, connect=relay.endpoint) as far,
    ):
        far.request("info")
        sent: list[str] = []
        cut_before = -1

        def cutting(name: str) -> None:
            original = getattr(Link, name)

            def send(link: Link, verb: str, *rest: object, **named: object) -> object:
                if link is far.link and threading.current_thread() is threading.main_thread():
                    sent.append(verb)
                    if len(sent) - 1 == cut_before:
                        relay.cut()
                        until(lambda: not far.alive, "the cut is noticed")
                        threading.Timer(0.1, relay.mend).start()
                return original(link, verb, *rest, **named)

            monkeypatch.setattr(Link, name, send)

        cutting("request")
        cutting("stream")
        far.acquire_load(patience=PATIENCE_S)
        verbs = list(sent)
        assert {"acquire_read", "read", "log", "program"} <= set(verbs)
        for cut_before in range(len(verbs)):
            sent.clear()
            again = far.acquire_load(patience=PATIENCE_S)
            at = f"cut before {verbs[cut_before]} (request {cut_before})"
            assert np.array_equal(again.data, whole.data), at
            assert again.parameters == whole.parameters, at
            assert (again.log, again.sources, again.lost) == (whole.log, whole.sources, 0), at


def test_a_target_that_was_started_again_is_found_again(start: Callable[..., Target]) -> None:
    first = start(clock="fast", name="phoenix")
    with zendsp.connect("phoenix") as host:
        first.download("pd.c")
        host.stage(Kp1=5.0)
        view = host.live(["tick"])
        first.close()
        with pytest.raises(LinkError, match="no target named 'phoenix'"):
            host.reconnect()
        second = start(clock="fast", name="phoenix")
        second.download("pd.c")
        host.reconnect()
        assert host.info.pid == second.info.pid
        host.update()
        assert host["Kp1"] == 5.0
        second.start()
        until(lambda: view.received > 0, "the live view goes on")


def test_a_live_view_ends_though_its_target_was_started_again_without_a_program(
    start: Callable[..., Target]
) -> None:
    """A bridge had died of it: zenoh.ZError, undeclared subscriber."""
    first = start(clock="fast", name="phoenix")
    with zendsp.connect("phoenix") as host:
        first.download("pd.c")
        view = host.live(["tick"])
        first.close()
        start(clock="fast", name="phoenix")
        host.reconnect()
        view.close()


def test_a_stream_whose_viewer_never_said_goodbye_is_closed(fast: Target) -> None:
    fast.download("pd.c")
    by = "a client without a token"
    for k in range(7):
        request = codec.encode_request("live_open", {"channels": ["q"], "decimation": k + 1}, by)
        replies = list(
            fast.link.session.get(f"zendsp/{fast.name}/rpc/quick", payload=request, timeout=10.0)
        )
        assert replies[0].ok is not None
    with pytest.raises(Refused, match=f"all 7 live streams are in use by {by}"):
        fast.live(["tau"])

    def free() -> bool:
        with contextlib.suppress(Refused):
            fast.live(["tau"]).close()
            return True
        return False

    until(free, "the streams without subscribers are closed")


JUMPS = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
static volatile long *ahead; /* s */
__attribute__((constructor)) static void find(void) {
    int file = open(getenv("AHEAD"), O_RDONLY);
    if (file >= 0) ahead = mmap(NULL, 4096, PROT_READ, MAP_SHARED, file, 0);
}
int clock_gettime(clockid_t clock, struct timespec *t) {
    long failed = syscall(SYS_clock_gettime, clock, t);
    if (!failed && ahead && ahead != MAP_FAILED && clock == CLOCK_REALTIME) t->tv_sec += *ahead;
    return (int)failed;
}
"""


def test_a_jump_of_the_system_clock_disturbs_neither_the_loop_nor_who_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person or the network sets the clock; here only the target's processes see it."""
    library, ahead = tmp_path / "jumps.so", tmp_path / "ahead"
    (tmp_path / "jumps.c").write_text(JUMPS)
    compiler = find_compiler().command
    words = [*compiler, "-shared", "-fPIC", str(tmp_path / "jumps.c"), "-o", str(library)]
    subprocess.run(words, check=True)
    ahead.write_bytes(bytes(4096))
    monkeypatch.setenv("AHEAD", str(ahead))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    with zendsp.local("imi_planar") as target:
        monkeypatch.delenv("LD_PRELOAD")
        target.download("pd.c")
        with zendsp.connect(target.name) as other:
            other.take_command()
            other.start()
            for seconds in (86_400, -600_000_000, 0):
                with ahead.open("r+b") as file:
                    file.write(seconds.to_bytes(8, "little", signed=True))
                begin, first = time.monotonic(), target.status()
                logged = len(target.log())
                other.update(Kp1=1990.0)
                until(lambda n=logged: len(target.log()) > n, "it is logged")  # type: ignore[misc]
                seen = target.log()[-1].host_time
                assert abs(seen - time.time() - seconds) < PATIENCE_S, "the target sees the jump"
                until(lambda s=first: target.status().tick >= s.tick + 300, "300 samples")  # type: ignore[misc]
                now = target.status()
                passed = time.monotonic() - begin
                assert (now.tick - first.tick) / now.rate_hz < passed + 0.05, "no sample too many"
                assert now.trip is None and now.state == "running"
                assert target.drive_status().commander == other.link.author
        until(lambda: target.status().trip is not None, "who commanded is missed")
