"""Which recording of killed targets is the newest, when the time of day was changed meanwhile."""

from __future__ import annotations

from pathlib import Path

import pytest

from zendsp.link.salvage import find_salvage
from zendsp_protocol import kept
from zendsp_protocol.messages import Program
from zendsp_target.runtime.memory.shm import SharedFolder


def _leave(base: Path, name: str, begun: float, since_start: float) -> Path:
    """What a killed target leaves: a lock that is free, a note, and one row of one column."""
    folder = base / f"{kept.PREFIX}{name}"
    folder.mkdir()
    (folder / kept.LOCK).touch()
    (folder / "rows").write_bytes((1).to_bytes(8, "little") + bytes(64))
    about = kept.About(
        target=name, machine="imi_planar", rate_hz=1000.0, begun=begun, since_start=since_start,
        program=Program(), parameters={}, versions={}, extra={},
    )
    note = kept.Kept(
        about=about, file="rows", rows_at=64, capacity=1, columns=("tick",), units=("",),
        decimation=1, rows=1, pre=0, ring=False, triggered=False, count_at=0, start_at=8,
        fired_at=8, missed_at=8, gaps_at=8, gaps_held=1,
    )
    kept.write(folder, note)
    return folder


def test_the_newest_is_the_one_that_was_begun_last_whatever_the_clock_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The newest is the one that is saved, and the last one to be removed."""
    monkeypatch.setattr(kept, "base", lambda: tmp_path)
    day = 86400.0
    begun = {"first": 400 * day, "second": 300 * day, "third": 200 * day, "fourth": 100 * day}
    folders = {
        name: _leave(tmp_path, name, at, float(number))
        for number, (name, at) in enumerate(begun.items(), 1)
    }
    assert [one.target for one in find_salvage()] == ["fourth", "third", "second", "first"]
    shared = SharedFolder()
    shared.close()
    assert [name for name, folder in folders.items() if folder.exists()] == [
        "second", "third", "fourth",
    ]
    assert [note.about.target for note in shared.dropped] == ["first"]
