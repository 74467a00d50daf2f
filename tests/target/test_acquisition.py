"""Handing a stream to the runner, and whose the recorder is."""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from desk import Desk, desk_of
from waiting import until

from zendsp_protocol import kept
from zendsp_protocol.errors import AcquisitionError, Refused
from zendsp_target.runtime import Runtime, acquisition, program_text
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.serving import claim


@pytest.mark.parametrize(("size", "taken"), [(2_000_000_000, True), (100_000, False)])
def test_the_runner_gets_time_in_proportion_to_the_bytes_of_a_stream(
    size: int, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ffi, lib = layout()
    control, head = ffi.new("control *"), ffi.new("stream_head *")
    head.bytes = size
    stream: Any = SimpleNamespace(head=head, file=SimpleNamespace(path=Path("stream-0-1")))
    slot = control.stream[0]
    seconds = itertools.count()

    def sleep(_: float) -> None:
        if next(seconds) >= 20:  # on a busy computer, with 2 GB
            lib.monitor_store32(ffi.addressof(slot, "mapped"), slot.requested)

    clock = SimpleNamespace(sleep=sleep, monotonic=lambda: float(next(seconds)))
    monkeypatch.setattr(acquisition, "time", clock)
    if taken:
        acquisition.attach(stream, control, 0, lambda: True)
    else:
        with pytest.raises(AcquisitionError, match="did not take"):
            acquisition.attach(stream, control, 0, lambda: True)


def test_a_recording_begins_although_its_note_for_salvage_cannot_be_written(
    make_runtime: Callable[..., Runtime], monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = make_runtime(program_text("pd"), clock="real", realtime=False)
    desk = desk_of(runtime)
    desk.ask("acquire_configure", channels=["q"], seconds=0.05)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(kept, "write", full)
    runtime.start()
    desk.ask("acquire_start")
    until(lambda: desk.ask("acquire_status").state == "done", "all rows")


@pytest.fixture
def desk(make_runtime: Callable[..., Runtime]) -> Desk:
    """Of a target with a program that runs, and two hosts, anna and bob, that are seen."""
    runtime = make_runtime(program_text("pd"), clock="real", realtime=False)
    runtime.start()
    desk = desk_of(runtime)
    desk.service.claim.present = lambda: ("anna", "bob")
    return desk


def test_the_recorder_has_one_host_from_its_setup_until_its_rows_are_brought_home(
    desk: Desk,
) -> None:
    """Of two that began in the same moment each got the other's rows."""

    def refused() -> None:
        with pytest.raises(Refused, match="anna is recording; wait, or take the recorder over"):
            desk.ask("acquire_configure", "bob", channels=["tau"], seconds=0.05)
        with pytest.raises(Refused, match="anna is recording"):
            desk.ask("acquire_start", "bob")

    mine = desk.ask("acquire_configure", "anna", channels=["q"], seconds=0.05).begun
    refused()
    assert desk.ask("acquire_start", "anna", begun=mine).begun == mine
    refused()
    until(lambda: desk.ask("acquire_status", "anna", begun=mine).state == "done", "all rows")
    refused()
    desk.ask("acquire_status", "anna", begun=mine, loaded=True)
    assert desk.ask("acquire_configure", "bob", channels=["tau"], seconds=0.05).begun != mine


@pytest.mark.parametrize("verb", ["start", "stop", "status", "held"])
def test_rows_of_a_recording_that_was_taken_over_are_refused_by_the_name_of_who_did(
    verb: str, desk: Desk
) -> None:
    mine = desk.ask("acquire_configure", "anna", channels=["q"], seconds=9.0).begun
    desk.ask("acquire_start", "anna", begun=mine)
    theirs = desk.ask("acquire_configure", "bob", channels=["tau"], seconds=9.0, take=True).begun
    desk.ask("acquire_start", "bob", begun=theirs)
    with pytest.raises(Refused, match="bob began another recording on this target before this one"):
        desk.ask(f"acquire_{verb}", "anna", begun=mine)
    assert desk.ask("acquire_status", "bob", begun=theirs).state == "running"


@pytest.mark.parametrize("why", ["lost", "silent", "never seen"])
def test_a_recorder_is_free_where_nobody_waits_for_it(
    why: str, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr(claim, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    host = "carl" if why == "never seen" else "anna"
    desk.ask("acquire_configure", host, channels=["q"], seconds=0.05)
    clock[0] += 0.9  # a host is seen within a second
    with pytest.raises(Refused, match=f"{host} is recording"):
        desk.ask("acquire_configure", "bob", channels=["tau"], seconds=0.05)
    if why == "lost":
        desk.service.claim.gone(host)
    else:
        clock[0] += 10.0
    desk.ask("acquire_configure", "bob", channels=["tau"], seconds=0.05)


def test_a_recording_started_again_has_another_number(desk: Desk) -> None:
    mine = desk.ask("acquire_configure", "anna", channels=["q"], seconds=0.05).begun
    desk.ask("acquire_start", "anna", begun=mine)
    again = desk.ask("acquire_start", "anna", begun=mine).begun
    assert again != mine
    with pytest.raises(Refused, match="this host itself began another recording"):
        desk.ask("acquire_status", "anna", begun=mine)
