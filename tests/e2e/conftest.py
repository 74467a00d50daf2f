"""Real targets in processes of their own, with the real runtime, on the loopback."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

import zendsp
from zendsp.link import Target


@pytest.fixture
def start() -> Iterator[Callable[..., Target]]:
    """Start a target; keyword arguments are those of :func:`zendsp.local`."""
    targets: list[Target] = []

    def begin(**options: object) -> Target:
        targets.append(zendsp.local("imi_planar", **options))  # type: ignore[arg-type]
        return targets[-1]

    yield begin
    for target in targets:
        target.close()


@pytest.fixture
def fast(start: Callable[..., Target]) -> Target:
    # 50 machine seconds a second: quick, and leaves the CPU to the others
    return start(clock="fast", options=["--speed", "50"])


@pytest.fixture
def real(start: Callable[..., Target]) -> Target:
    target = start(clock="real", options=["--no-realtime"])
    target.download("pd.c")
    target.start()
    return target
