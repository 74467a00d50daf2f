"""A stream is handed to the runner: how long that may take."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from zendsp_protocol.errors import AcquisitionError
from zendsp_target.runtime import acquisition
from zendsp_target.runtime.memory.layout import layout


@pytest.mark.parametrize(("size", "taken"), [(2_000_000_000, True), (100_000, False)])
def test_the_runner_is_waited_for_as_long_as_so_many_bytes_may_take(
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
