"""A Dask cluster that loses its workers is told, and not waited for in silence."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from zendsp import cluster


class Client:
    """Says at each look which workers the scheduler has, and then that it is closed."""

    def __init__(self, *looks: dict[str, int]) -> None:
        self.looks: Iterator[dict[str, int]] = iter(looks)
        self.left = len(looks)

    @property
    def status(self) -> str:
        return "running" if self.left else "closed"

    def scheduler_info(self) -> dict[str, dict[str, int]]:
        self.left -= 1
        return {"workers": next(self.looks)}


def test_the_last_worker_that_goes_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster, "LOOK_S", 0.0)
    one: dict[str, int] = {"a": 1}
    with caplog.at_level(logging.WARNING):
        cluster._look_on(Client(one, {}, {}, one, one), "tcp://there:8786")
    (said,) = caplog.messages
    assert "has lost its last worker" in said and "`dask worker tcp://there:8786`" in said
