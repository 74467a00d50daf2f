"""The memory of a live view is bounded by its rows, however they arrive."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zendsp.link.live import LiveView
from zendsp_protocol import codec
from zendsp_protocol import messages as m
from zendsp_protocol.verbs import LiveOpen
from zendsp_protocol.version import PROTOCOL

COLUMNS = ("a", "b", "c")
HISTORY = 5000  # rows


class Quiet:
    """A subscriber to which nothing comes: the test hands over the messages."""

    def __init__(self) -> None:
        self.handler = self

    def recv(self) -> Any:
        import zenoh

        raise zenoh.ZError("closed")


@pytest.fixture
def view() -> LiveView:
    opened = m.LiveOpened(stream=1, key="k", channels=COLUMNS, units=("", "", ""), sample_time=1e-3)
    link = SimpleNamespace(
        session=SimpleNamespace(declare_subscriber=lambda *_: Quiet()),
        on_return=lambda _: None,
        request=lambda *_: opened,
    )
    requests: Any = SimpleNamespace(link=link)
    return LiveView(requests, LiveOpen(channels=list(COLUMNS)), HISTORY * 1e-3, None)


def deliver(view: LiveView, first: int, rows: int, session: int = 1) -> None:
    """Hand over rows whose values are their index."""
    header = m.LiveHeader(
        v=PROTOCOL, session=session, first=first, rows=rows, columns=COLUMNS, tick=first,
        decimation=1, lost=0,
    )  # fmt: skip
    data = np.repeat(np.arange(first, first + rows, dtype="<f8"), len(COLUMNS)).tobytes()
    view._take(
        SimpleNamespace(  # type: ignore[arg-type]
            attachment=SimpleNamespace(to_bytes=lambda: codec.encode(header)),
            payload=SimpleNamespace(to_bytes=lambda: data),
        )
    )


def test_rows_that_come_one_by_one_take_no_more_memory_than_the_rows(view: LiveView) -> None:
    deliver(view, 0, 1)
    tracemalloc.start()
    try:
        for k in range(1, 2 * HISTORY):
            deliver(view, k, 1)
        grown = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    rows = HISTORY * (1 + len(COLUMNS)) * 8
    # with room to append, and the blocks that an iterator may lag behind
    assert grown < 2.5 * rows + 300_000, f"{grown / rows:.1f} times its rows"


@pytest.mark.parametrize("rows", [1, 7, 900, HISTORY, 3 * HISTORY])
def test_the_window_is_the_last_rows_however_they_came(view: LiveView, rows: int) -> None:
    for first in range(0, 4 * HISTORY, rows):
        deliver(view, first, rows)
        t, data = view.window()
        newest = first + rows
        kept = min(newest, HISTORY)
        assert len(t) == kept and data.shape == (kept, 3)
        assert t[0] == (newest - kept) / 1e3 and t[-1] == (newest - 1) / 1e3
        assert np.array_equal(data[:, 2], np.arange(newest - kept, newest))
        assert view.latest() == {"t": t[-1], "a": data[-1, 0], "b": data[-1, 0], "c": data[-1, 0]}
        if first > 60 * rows and rows < 100:
            break


def test_what_was_missed_is_one_row_of_nan_and_another_program_begins_afresh(
    view: LiveView,
) -> None:
    deliver(view, 0, 10)
    deliver(view, 25, 10)
    t, data = view.window()
    assert len(t) == 21 and np.isnan(data[10]).all() and not np.isnan(np.delete(data, 10, 0)).any()
    assert view.lost == 15 and (np.diff(t) >= 0).all()
    t[:] = 0.0  # it is the caller's own
    deliver(view, 35, 1)
    assert view.window()[0][0] == 0.0 and view.window()[0][9] == 9e-3
    deliver(view, 0, 3, session=2)
    assert len(view.window()[0]) == 3


def test_a_view_that_has_seen_nothing_shows_nothing(view: LiveView) -> None:
    t, data = view.window()
    assert t.shape == (0,) and data.shape == (0, 3) and view.latest() == {}
