"""STOP by shared memory: the loop's own answer counts, whatever else hangs."""

from __future__ import annotations

import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from waiting import PATIENCE_S, freeze, until

from zendsp.errors import LinkError, NotStopped, Refused
from zendsp.here.registered import local_entries
from zendsp.here.stop_page import StopPage, find
from zendsp.here.stopped import stopped
from zendsp.link import Target, connect, programs
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


# kB of addresses: Zenoh cannot be loaded; hangs; aborts; NumPy looks for more without end
@pytest.mark.parametrize("most_kb", [30_000, 60_000, 200_000, 300_000])
def test_stop_needs_neither_threads_nor_zenoh_where_addresses_are_few(
    target: Target, most_kb: int
) -> None:
    words = f'ulimit -v {most_kb}; exec "$@"'
    zendsp_ = (sys.executable, "-c", "from zendsp.cli import main; main()")
    done = subprocess.run(
        ["sh", "-c", words, "sh", *zendsp_, "stop", "paged"],
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, ""), done
    assert done.stdout == f"stopped, at sample {_latched(target)}\n"
    away = [*zendsp_, "stop", "--connect", "tcp/127.0.0.1:1"]
    done = subprocess.run(
        ["sh", "-c", words, "sh", *away], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 2 and "NOT STOPPED" in done.stderr, done


def test_the_loop_takes_stop_from_shared_memory_and_says_at_which_sample(target: Target) -> None:
    found = find("paged")
    assert found is not None
    sample = found.taken(found.ask(), PATIENCE_S)
    assert sample == _latched(target)


@pytest.mark.parametrize("road", ["page", "link"])
@pytest.mark.parametrize("program", ["runs", "crashed", "none"])
def test_the_latch_tells_who_asked_from_where_and_when(
    target: Target, runtime: Runtime, road: str, program: str
) -> None:
    if program == "none":
        target.unload()
    elif program == "crashed":
        os.kill(runtime.runner_pid(), signal.SIGKILL)
        until(lambda: target.status().state == "crashed", "the crash is told")
    found = find("paged")
    assert found is not None
    found.ask() if road == "page" else target.request("stop")
    until(lambda: target.status().trip is not None, "the latch")
    here = rf"@{re.escape(os.uname().nodename)}:{os.getpid()}"
    said = rf"^STOP was requested by \S+{here}\S* at \d\d:\d\d:\d\d"
    trip = target.status().trip
    assert trip is not None and re.match(said, trip.text) and re.match(said, trip.cause), trip
    found.ask()  # later ones change no word
    after = target.status().trip
    assert after is not None and (after.text == trip.text or program != "runs")
    with pytest.raises(Refused, match=said):
        target.download("pd.c")


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


def test_a_stop_that_the_loop_took_late_is_none_that_failed_where_the_target_does_not_answer(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy computer a loop takes it after 50 ms, and the target's process answers nothing:
    NOT STOPPED was said of a machine that stood.
    """
    monkeypatch.setattr(programs, "TAKEN_S", 0.0)

    def silent(verb: str, **_: object) -> None:
        until(lambda: target.link.request("status", {}).trip is not None, "the loop took it")
        raise LinkError(f"{verb!r} was not answered")

    monkeypatch.setattr(target.programs, "request", silent)
    status = target.stop()
    assert status.trip is not None and status.trip.reason == "stop"
    monkeypatch.undo()
    assert status.trip.tick == _latched(target)


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
    with pytest.raises(Refused, match="acknowledge it first"):  # whether a program is there or not
        target.start()


def test_only_a_stop_page_of_this_run_and_version_is_used(
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


def test_stop_without_a_name_stops_what_is_here_and_what_the_environment_leads_to(
    start: Callable[..., Target],
    typed: Callable[..., tuple[object, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    users = tmp_path / "users"
    users.write_text("anna:a\n")
    users.chmod(0o600)
    doors = ["--listen", "here", "--listen", "tcp/127.0.0.1:0", "--users", str(users)]
    near, far = start(name="near", options=doors), start(name="far", options=doors)

    def stopped_of(*words: str) -> list[tuple[str, str]]:
        for target in (near, far):
            target.download("pd.c")
            target.start()
        status, said, _ = typed("stop", *words)
        assert status == 0
        for target in (near, far):
            assert target.status().trip is not None
            target.acknowledge()
        lines = [line.partition(": ") for line in said.splitlines()]
        assert all(text.startswith("stopped, at sample") for _, _, text in lines)
        return sorted((name, text) for name, _, text in lines)

    monkeypatch.setenv("ZENDSP_CONNECT", find_tcp("far"))
    for user, password in (("", ""), ("anna", "a")):  # let in by its entry, then as anna
        monkeypatch.setenv("ZENDSP_USER", user)
        monkeypatch.setenv("ZENDSP_PASSWORD", password)
        assert [name for name, _ in stopped_of()] == ["far", "near"]
        assert typed("info", "--json")[0] == 0, "where one target answers, it needs no name"
    elsewhere = tmp_path / "elsewhere"  # as on another computer, where far is not registered
    elsewhere.mkdir(mode=0o700)
    shutil.copy(Path(os.environ["ZENDSP_RUNTIME_DIR"]) / "near.json", elsewhere)
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(elsewhere))
    assert [name for name, _ in stopped_of()] == ["far", "near"]
    monkeypatch.setenv("ZENDSP_CONNECT", f"{find_tcp('near')},tcp/127.0.0.1:1")
    status, said, wrong = typed("stop")
    assert status == 2 and said.startswith("near: stopped")
    assert "tcp/127.0.0.1:1: NOT STOPPED" in wrong and "near" not in wrong


def test_a_target_of_this_machine_is_stopped_by_name_wherever_the_environment_leads(
    start: Callable[..., Target],
    typed: Callable[..., tuple[object, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near = start(name="near")
    near.download("pd.c")
    near.start()
    monkeypatch.setenv("ZENDSP_CONNECT", "tcp/127.0.0.1:1")
    status, said, wrong = typed("stop", "near")
    assert near.status().trip is not None
    assert said.startswith("near at this machine: stopped, at sample")
    assert status == 2 and wrong.startswith("zendsp: near: NOT STOPPED"), "of the other place"


def test_stop_at_the_prompt_of_a_shell_stops_the_target_of_that_prompt(
    start: Callable[..., Target],
    typed: Callable[..., tuple[object, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near, other = start(name="near"), start(name="other")
    for target in (near, other):
        target.download("pd.c")
        target.start()
    for elsewhere in ("", "other"):  # what it says does not matter once the shell has begun
        monkeypatch.setenv("ZENDSP_TARGET", elsewhere)
        lines = iter(["stop", "drive acknowledge", "get t", "stop near", "stop --acknowledge"])
        monkeypatch.setattr("builtins.input", lambda prompt, left=lines: next(left, "exit"))
        status, said, wrong = typed("shell", "-t", "near")
        assert status == 0 and "near: stopped, at sample" in said and "acknowledged;" in wrong
        assert near.status().state == "paused" and other.status().state == "running"
        near.start()


def find_tcp(name: str) -> str:
    return next(e for entry in local_entries() if entry.name == name for e in entry.endpoints[1:])


def _typed_alone(*words: str) -> tuple[int, str, str, bool]:
    """Status, output, errors, and whether Zenoh was loaded, of a command in a process of its own.
    """
    code = (
        "import sys\n"
        "from zendsp.cli import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    print('zenoh' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=PATIENCE_S
    )
    said, _, loaded = done.stdout.rstrip("\n").rpartition("\n")
    return done.returncode, said, done.stderr, loaded == "True"


def test_a_stop_that_the_loops_confirm_returns_without_a_link(
    start: Callable[..., Target], typed: Callable[..., tuple[object, str, str]]
) -> None:
    targets = [start(name=name, options=["--no-realtime"]) for name in ("left", "right")]
    for target in targets:
        target.download("pd.c")
        target.start()
    pids = [target.info.pid for target in targets]
    try:
        for pid in pids:  # who would ask them would wait
            freeze(pid)
        status, said, wrong, linked = _typed_alone("stop")
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
    assert (status, wrong, linked) == (0, "", False)
    told = {line.partition(":")[0]: line for line in said.splitlines()}
    assert told == {
        target.name: f"{target.name}: stopped, at sample {_latched(target)}" for target in targets
    }


def test_a_stop_after_a_trip_says_what_tripped(target: Target, runtime: Runtime) -> None:
    target.set_limits(torque_max=[0.01, 0.01])
    until(lambda: target.status().trip is not None, "the trip")
    trip = target.status().trip
    assert trip is not None and trip.reason != "stop"
    page = find("paged")
    assert page is not None and page.taken(page.ask(), PATIENCE_S) == trip.tick
    assert not page.by_stop()
    status, said, wrong, linked = _typed_alone("stop")
    assert (status, wrong, linked) == (0, "", True)
    assert said == f"stopped, at sample {trip.tick}\n({trip.text})"
    target.acknowledge()
    assert page.taken(page.ask(), PATIENCE_S) is not None and page.by_stop()


def test_a_target_that_did_not_stop_is_reported_while_another_is_silent(
    typed: Callable[..., tuple[object, str, str]],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard: list[str] = []

    def linked(name: str, *_: Any, **__: Any) -> Target:
        def told() -> bool:
            heard.append(capsys.readouterr().err)
            return "gone: NOT STOPPED" in "".join(heard)

        if name == "silent":
            until(told, "the word on the other")
        raise LinkError(f"{name} does not answer")

    monkeypatch.setattr("zendsp.link.connect", linked)
    status, _, wrong = typed("stop", "silent", "gone")
    assert status == 2
    assert "silent: NOT STOPPED: use the machine's emergency stop (silent does not" in wrong


def test_ctrl_c_while_homing_ends_the_homing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path / "run"))
    far = {"q1": 1.0, "q2": -1.0}  # rad: seconds of homing
    with Runtime("imi_planar", clock="real", realtime=False, machine_config=far) as runtime:
        monitor = Monitor(runtime, Options("paged", "imi_planar"))
        try:
            with connect("paged") as target:
                target.download("pd.c")
                target.power_on()

                def pressed(_: float) -> None:
                    if runtime.status().tick > 100:
                        raise KeyboardInterrupt

                clock = SimpleNamespace(monotonic=time.monotonic, sleep=pressed)
                with monkeypatch.context() as patch:
                    patch.setattr("zendsp.link.drives.time", clock)
                    with pytest.raises(KeyboardInterrupt):
                        target.home_and_wait()
                status = target.status()
                assert status.state != "running" and status.trip is None
                tick = runtime.status().tick
                time.sleep(0.2)
                assert runtime.status().tick == tick, "the arm stands"
                assert target.home_and_wait() == "homed", "and it can be homed again"
        finally:
            monitor.close()


def test_a_target_whose_folder_was_removed_is_stopped_and_found_by_name(
    start: Callable[..., Target], typed: Callable[..., tuple[object, str, str]]
) -> None:
    """The system empties the folder of a login when it ends, or when files grow old."""
    target = start(clock="real", options=["--no-realtime"], name="alone")
    target.download("pd.c")
    target.start()
    folder = Path(os.environ["ZENDSP_RUNTIME_DIR"])
    pid = local_entries()[0].pid
    shutil.rmtree(folder.rename(folder.with_name("gone")))  # at once: the target writes there
    until(lambda: "alone" in [entry.name for entry in local_entries()], "its entry again")
    assert folder.stat().st_mode & 0o777 == 0o700
    status, said, wrong = typed("stop")
    assert (status, wrong) == (0, "") and said == f"stopped, at sample {_latched(target)}\n"
    says = rf"alone runs here \(process {pid}\), but its socket \S+ was removed: .*'kill {pid}'"
    with pytest.raises(LinkError, match=says):
        connect("alone")
    assert re.search(says, "".join(typed("ls")[1:]))


def test_a_frozen_target_is_named_with_its_process_and_is_stopped_all_the_same(
    start: Callable[..., Target], typed: Callable[..., tuple[object, str, str]]
) -> None:
    """It was "no target answers: 'zendsp target' starts one", which was then refused: one of that
    name ran.
    """
    target = start(clock="real", options=["--no-realtime"], name="alone")
    target.download("pd.c")
    target.start()
    pid = local_entries()[0].pid
    os.kill(pid, signal.SIGSTOP)
    try:
        says = rf"alone runs here \(process {pid}\) and does not answer: .*'kill -CONT {pid}'"
        with pytest.raises(LinkError, match=says):
            connect("alone", timeout=0.5)
        assert re.search(says, "".join(typed("ls")[1:]))
        status, said, _ = typed("stop")
        assert status == 0 and "stopped, at sample" in said
    finally:
        os.kill(pid, signal.SIGCONT)
    with connect("alone", timeout=PATIENCE_S) as again:
        assert again.status().trip is not None
