"""Real targets in processes of their own, with the real runtime, on the loopback."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from helpers import ROUTER, there
from waiting import until

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


@pytest.fixture
def routed(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A router and its place, with a target called imi that listens here as well."""
    monkeypatch.delenv("ZENDSP_CONNECT", raising=False)
    with socket.create_server(("127.0.0.1", 0)) as free:
        place = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    words = [
        sys.executable, "-m", "zendsp_target", "--name", "imi", "--listen", "here", "--connect",
        place,
    ]
    with there(ROUTER, place) as router:
        target = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        try:
            until(lambda: "imi" in [t.name for t in zendsp.discover()], "the target is there")
            yield router, place
        finally:
            router.send_signal(signal.SIGCONT)
            target.send_signal(signal.SIGINT)
            target.communicate()
