"""Processes that user code started on a system without a filter of system calls: they are found and
ended with their runner.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

from zendsp_protocol.registry import born

MARK = "ZENDSP_RUNNER"  # in the environment of a runner, and of all that it starts
ROUNDS = 1000
Process = tuple[int, str]  # its number and start time, since numbers are used again


class Strays:
    """The processes that one runner started.

    Parameters
    ----------
    runner : int
        Its process id. It is the subreaper of what it starts, so nothing leaves it while it lives.
    mark : str
        Value of `MARK` in its environment, by which most of the rest is found once it is dead; what
        took that off is found by the sessions and groups of what was seen.
    """

    def __init__(self, runner: int, mark: str) -> None:
        self._runner, self._mark = runner, f"{MARK}={mark}".encode()
        self._seen: set[Process] = set()

    def look(self) -> None:
        """Note the processes that descend from the runner now: one that removes the mark from its
        environment is then known when the runner is dead.
        """
        self._seen |= _beneath(self._runner)

    def end(self) -> None:
        """End all of them, and those that they start meanwhile."""
        for _ in range(ROUNDS):
            self.look()
            left = {
                process
                for process in self._seen | self._elsewhere()
                if born(process[0]) == process[1] != ""
            }
            if not left:
                return
            for number, _ in left:
                self._seen |= _beneath(number)
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(number, signal.SIGKILL)
            time.sleep(0.001)

    def _elsewhere(self) -> set[Process]:
        known = {self._runner, *(number for number, _ in self._seen)}
        found = set()
        for folder in _paths("/proc", "[0-9]*"):
            number = int(folder.name)
            with contextlib.suppress(OSError, IndexError):
                fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
                related = {int(fields[2]), int(fields[3])} & known  # group, session
                if number != self._runner and (
                    related or self._mark in (folder / "environ").read_bytes().split(b"\0")
                ):
                    found.add((number, born(number)))
        return found


def _beneath(number: int) -> set[Process]:
    found: set[Process] = set()
    for children in _paths(f"/proc/{number}/task", "*/children"):
        with contextlib.suppress(OSError):
            for child in children.read_text().split():
                found |= {(int(child), born(int(child))), *_beneath(int(child))}
    return found


def _paths(root: str, pattern: str) -> list[Path]:
    """The paths under ``/proc`` that fit a pattern; none where this process has no file descriptor
    left to look with, so that a dead runner's machine is made safe all the same.
    """
    try:
        return list(Path(root).glob(pattern))
    except OSError:
        return []
