"""A router between host and target freezes; its lease is 10 s, as Zenoh has it."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from waiting import until

import zendsp

ROUTER = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("there", flush=True)
time.sleep(3600)
"""
# on another computer, by its name
HOST = """
import os, sys, time
import zendsp, zendsp.link.session
if sys.argv[1] == "elsewhere":
    zendsp.link.session.own_name = lambda identity: f"anna@elsewhere:{os.getpid()}"
target = zendsp.connect("imi", sys.argv[2].split() if len(sys.argv) > 2 else None)
target.download("pd.c")
target.take_command()
target.start()
print("there", flush=True)
time.sleep(3600)
"""
AT_ONCE_S = 5.0  # half of the router's own lease; it takes 1.3 s where nothing else computes


@contextmanager
def running(code: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None and process.stdout.readline() == "there\n"
        yield process
    finally:
        process.kill()
        process.communicate()


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
    with running(ROUTER, place) as router:
        target = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        try:
            until(lambda: "imi" in [t.name for t in zendsp.discover()], "the target is there")
            yield router, place
        finally:
            router.send_signal(signal.SIGCONT)
            target.send_signal(signal.SIGINT)
            target.communicate()


def test_a_host_behind_a_router_that_freezes_is_lost_at_once_and_comes_back(
    routed: tuple[subprocess.Popen[str], str],
) -> None:
    router, place = routed
    with running(HOST, "elsewhere", place), zendsp.connect("imi") as here:
        assert "@elsewhere:" in here.drive_status().commander
        router.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
        until(lambda: here.status().trip is not None, "the policy acts")
        assert time.monotonic() < begin + AT_ONCE_S
        assert here.status().trip.reason == "host lost" and not here.drive_status().commander
        router.send_signal(signal.SIGCONT)
        until(lambda: "@elsewhere:" in str(here.status().hosts), "it is back")


def test_a_host_of_this_computer_is_not_lost_with_the_router(
    routed: tuple[subprocess.Popen[str], str],
) -> None:
    router, _ = routed
    with running(HOST, "here"), zendsp.connect("imi") as here:
        router.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
        while time.monotonic() < begin + 3.0:  # twice what it takes where a host is lost
            assert here.status().state == "running" and here.drive_status().commander
            time.sleep(0.1)
