"""A host and a target of different versions: one line says what to do, and STOP works."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from helpers import python
from waiting import PATIENCE_S

import zendsp
from zendsp.cli import main
from zendsp.errors import VersionMismatch
from zendsp_protocol import stop_page
from zendsp_protocol.version import PROTOCOL

# A target with a program that runs: of another protocol, another layout of its shared memory,
# another stop page.
TARGET = """
import json, sys
wire, page = int(sys.argv[1]), int(sys.argv[2])
import zendsp_protocol.version as version
version.PROTOCOL = wire
from zendsp_target.monitor import Monitor, Options
from zendsp_target.runtime import Runtime, runtime as made
import struct
from zendsp_protocol import stop_page
with Runtime("imi_planar", clock="real", realtime=False) as runtime:
    runtime.load(runtime.compile({"pd.c": made.program_text("pd")}).key)
    runtime.start()
    with open(runtime.stop_page(), "r+b") as file:
        file.write(struct.pack(stop_page.HEAD, stop_page.MAGIC, page))
    monitor = Monitor(runtime, Options("other", "imi_planar"))
    print("ready", flush=True)
    while sys.stdin.readline():
        trip = runtime.status().trip
        print(trip.reason if trip else "running", flush=True)
    monitor.close()
"""
NEWER, PAGE = PROTOCOL + 1, stop_page.VERSION
Begin = Callable[[int, int], subprocess.Popen[str]]


@pytest.fixture
def begin() -> Iterator[Begin]:
    """Start a target of other versions: ``begin(protocol, stop_page)``."""
    started: list[subprocess.Popen[str]] = []

    def start(wire: int, page: int) -> subprocess.Popen[str]:
        started.append(python(TARGET, str(wire), str(page)))
        stdout = started[-1].stdout
        assert stdout is not None and stdout.readline() == "ready\n"
        return started[-1]

    yield start
    for process in started:
        process.communicate(timeout=PATIENCE_S)


def _said(target: subprocess.Popen[str]) -> str:
    """What the target itself knows: "running", or why it stopped."""
    assert target.stdin is not None and target.stdout is not None
    target.stdin.write("\n")
    target.stdin.flush()
    return target.stdout.readline().strip()


Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Give a command of `zendsp`: its status, and what it said and complained of."""

    def give(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["zendsp", *words])
        status: object = 0
        try:
            main()
        except SystemExit as end:
            status = end.code
        said = capsys.readouterr()
        return int(bool(status)), said.out, said.err.strip()

    return give


def test_another_protocol_is_said_in_one_line_and_stop_works(
    begin: Begin, command: Command
) -> None:
    target = begin(NEWER, PAGE)
    with pytest.raises(VersionMismatch, match="upgrade zendsp on the host"):
        zendsp.connect("other")
    _, listed, _ = command("ls")
    assert "other" in listed and "upgrade zendsp on the host" in listed
    status, _, why = command("get", "q", "-t", "other")
    assert status and "upgrade zendsp on the host" in why and "\n" not in why
    assert _said(target) == "running"
    status, said, why = command("stop")
    assert status == 0 and said.startswith("stopped, at sample"), why
    assert _said(target) == "stop"


def test_with_another_stop_page_stop_goes_over_the_link(begin: Begin, command: Command) -> None:
    target = begin(PROTOCOL, PAGE + 1)
    status, said, why = command("stop")
    assert status == 0 and said.startswith("stopped, at sample"), why
    assert _said(target) == "stop"


def test_with_another_protocol_and_stop_page_it_says_loudly_that_it_did_not_stop(
    begin: Begin, command: Command
) -> None:
    target = begin(NEWER, PAGE + 1)
    status, _, why = command("stop")
    assert status and "NOT STOPPED: use the machine's emergency stop" in why
    assert "upgrade zendsp on the host" in why and "\n" not in why
    assert _said(target) == "running"
