"""A router between host and target freezes; its lease is 10 s, as Zenoh has it."""

from __future__ import annotations

import signal
import subprocess
import time

from helpers import there
from waiting import until

import zendsp

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


def test_a_host_behind_a_router_that_freezes_is_lost_at_once_and_comes_back(
    routed: tuple[subprocess.Popen[str], str],
) -> None:
    router, place = routed
    with there(HOST, "elsewhere", place), zendsp.connect("imi") as here:
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
    with there(HOST, "here"), zendsp.connect("imi") as here:
        router.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
        while time.monotonic() < begin + 3.0:  # twice what it takes where a host is lost
            assert here.status().state == "running" and here.drive_status().commander
            time.sleep(0.1)
