"""How long handing a stream to the runner may take."""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from desk import desk_of
from waiting import until

from zendsp_protocol import kept
from zendsp_protocol.errors import AcquisitionError
from zendsp_target.runtime import Runtime, acquisition, program_text
from zendsp_target.runtime.memory.layout import layout


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
