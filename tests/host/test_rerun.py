"""What Rerun is handed of a target; a stand-in plays its package, which is large."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zendsp.bridge import rerun as show
from zendsp.bridge.rerun_viewer import PORT
from zendsp.errors import LinkError, Refused
from zendsp.link import local

PATIENCE_S = 30.0


class Stream:
    """A recording of Rerun."""

    def __init__(self, name: str) -> None:
        self.name, self.to, self.ended = name, "", False

    def save(self, path: Path) -> None:
        self.to = str(path)

    def flush(self) -> None:
        assert self.to

    def disconnect(self) -> None:
        self.ended = True


class Rerun:
    """The part of rerun-sdk 0.41 that is used."""

    class Scalars:
        @staticmethod
        def columns(*, scalars: np.ndarray) -> np.ndarray:
            return np.array(scalars)

    def __init__(self) -> None:
        self.sent: list[tuple[str, np.ndarray, np.ndarray]] = []
        self.streams: list[Stream] = []

    def RecordingStream(self, name: str) -> Stream:
        self.streams.append(Stream(name))
        return self.streams[-1]

    def TimeColumn(self, name: str, *, duration: np.ndarray) -> np.ndarray:
        assert name == "t"
        return np.array(duration)

    def escape_entity_path_part(self, name: str) -> str:
        return name.replace("[", "\\[").replace("]", "\\]")

    def send_columns(self, name: str, times: Any, values: Any, *, recording: Stream) -> None:
        assert recording is self.streams[0]
        self.sent.append((name, times[0], values))


def test_signals_are_handed_to_rerun_row_by_row(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fake = Rerun()
    monkeypatch.setitem(sys.modules, "rerun", fake)
    with local("imi_planar", clock="fast", options=["--speed", "5"]) as target:
        with (
            pytest.raises(Refused, match="no program is loaded"),
            show(target, save=tmp_path / "run.rrd"),
        ):
            pass
        target.download("pd.c")
        target.start()
        with show(target, ["q", "tau[1]"], save=tmp_path / "run.rrd"):
            until = time.monotonic() + PATIENCE_S
            while {name for name, _, _ in fake.sent} != {"q", "tau\\[1\\]"} or len(fake.sent) < 8:
                assert time.monotonic() < until, "rows come"
                time.sleep(0.02)
    (stream,) = fake.streams
    assert stream.ended and stream.to.endswith("run.rrd")
    for name, t, values in fake.sent:
        assert values.shape == (len(t), 2 if name == "q" else 1) and len(t) > 0
    rows = np.median([len(t) for _, t, _ in fake.sent])
    assert rows >= 10.0, "a night's file is small: a block costs as much as twenty rows"


def test_without_a_viewer_it_is_said_how_to_start_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", Rerun())
    monkeypatch.setattr("zendsp.bridge.rerun_viewer._viewer_listens", lambda: False)
    with local("imi_planar", clock="fast") as target:
        target.download("pd.c")
        with pytest.raises(LinkError, match=f"port {PORT} .*rerun --bind 127.0.0.1"), show(target):
            pass


def test_a_file_that_cannot_be_written_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(self: Stream, path: Path) -> None:  # as rerun-sdk 0.41 does
        raise RuntimeError(f"Failed to create file: No such file or directory, path: {path}")

    monkeypatch.setattr(Stream, "save", refuse)
    monkeypatch.setitem(sys.modules, "rerun", Rerun())
    with local("imi_planar", clock="fast") as target:
        target.download("pd.c")
        there, words = tmp_path / "none" / "run.rrd", r"run\.rrd: cannot be written"
        with pytest.raises(LinkError, match=words), show(target, save=there):
            pass
