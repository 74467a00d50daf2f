"""Runs a command of zendsp in a process of its own, whose output arrives line by line."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from zendsp.parent import call

# Politely: what computes for a minute must not take the CPU of a screen or of a loop.
POLITELY = "import os; os.nice(10); "


INTERRUPTED = -signal.SIGINT  # how a command ends that Ctrl-C ended


class Command:
    """One command of zendsp, run in a process of its own.

    Parameters
    ----------
    arguments : sequence of str
        After ``zendsp``.
    folder : Path
        Where it runs; made where it does not exist.
    tell : callable
        Receives each line that it says; stages of its progress among them.
    width : int
        Columns that it may use.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        folder: Path,
        tell: Callable[[str], object],
        width: int = 100,
    ) -> None:
        self.arguments, self.status = list(arguments), None
        self._folder, self._tell, self._width = folder, tell, width
        self._process: asyncio.subprocess.Process | None = None
        self._ended = False

    status: int | None  # of its end

    async def run(self) -> int:
        """Run it to its end; return the exit status, negative where a signal ended it."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-P",
            "-c",
            POLITELY + call(os.getpid()),
            *self.arguments,
            cwd=self._folder,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env={
                **os.environ,
                "COLUMNS": str(self._width),
                "NO_COLOR": "1",
                "ZENDSP_PROGRESS": "lines",
            },
            start_new_session=True,
        )
        if self._ended:  # before it had begun
            self.end()
        assert process.stdout is not None
        async for line in process.stdout:
            self._tell(line.decode(errors="replace").rstrip("\n"))
        self.status = await process.wait()
        return self.status

    def interrupt(self) -> None:
        """Interrupt it as Ctrl-C does in a terminal; it may still print what it has."""
        self._ended = self._process is None  # it has nothing to say yet
        self._signal(signal.SIGINT)

    def end(self) -> None:
        """End it and every process that it has started."""
        self._ended = True
        self._signal(signal.SIGTERM)

    def _signal(self, number: signal.Signals) -> None:
        process = self._process
        if process is not None and process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, number)
