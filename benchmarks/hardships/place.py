"""Where a hardship happens: a folder of its own, what was started there, and what is left."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import zendsp
from zendsp.link import Target

OWN_FOLDER = "ZENDSP_RUNTIME_DIR"
SHARED = Path("/dev/shm")
PATIENCE_S = 20.0  # for what happens within a second on a computer that has nothing else to do
LOOK_S = 0.01
SLOWER = 10.0  # how many times as long, at the most, it is waited on a computer that is busy
START_S = 150.0  # for a target to come up
TOLD = 20  # violations of a hardship that are told in full


class Tally:
    """What was done, what was measured, and what did not hold."""

    def __init__(self) -> None:
        self.done: Counter[str] = Counter()
        self.worst: dict[str, float] = {}
        self.violated: list[str] = []
        self.violations = 0

    def count(self, what: str, number: int = 1) -> None:
        """Count something that was done."""
        self.done[what] += number

    def measure(self, what: str, value: float) -> None:
        """Keep the largest value of something."""
        self.worst[what] = max(value, self.worst.get(what, value))

    def expect(self, holds: object, what: str) -> bool:
        """Note as violated what does not hold; returns whether it does."""
        if not holds:
            self.violations += 1
            if len(self.violated) < TOLD:
                busy = f"at a load of {os.getloadavg()[0]:.0f} on {os.cpu_count()} processors"
                self.violated.append(f"{what} ({busy})")
        return bool(holds)


class Place:
    """A folder in which targets are registered that nobody else sees; all that was started there is
    ended at its end.
    """

    def __enter__(self) -> Place:
        self.folder = Path(tempfile.mkdtemp(prefix="ze-"))
        self.folder.chmod(0o700)
        self._before = os.environ.get(OWN_FOLDER)
        os.environ[OWN_FOLDER] = str(self.folder)
        return self

    def __exit__(self, *_: object) -> None:
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        until(lambda: not self.processes())
        if self._before is None:
            del os.environ[OWN_FOLDER]
        else:
            os.environ[OWN_FOLDER] = self._before
        shutil.rmtree(self.folder, ignore_errors=True)

    def local(self, name: str, clock: str = "real", **options: str) -> Target:
        """Start a target of the planar arm."""
        return zendsp.local(
            "imi_planar", clock=clock, name=name, timeout=START_S, **options  # type: ignore[arg-type]
        )

    def script(
        self, text: str, *words: str, env: Mapping[str, str] | None = None
    ) -> subprocess.Popen[str]:
        """Start a Python script of a user's, with its output in a pipe."""
        return subprocess.Popen(
            [sys.executable, "-c", text, *words], cwd=self.folder,
            env={**os.environ, **(env or {})}, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, start_new_session=True,
        )

    def processes(self) -> list[int]:
        """All processes that began here, whoever their parents are now; not this one."""
        mark = f"{OWN_FOLDER}={self.folder}".encode()
        found = []
        for path in Path("/proc").glob("[0-9]*/environ"):
            pid = int(path.parent.name)
            with contextlib.suppress(OSError):
                if (
                    pid != os.getpid()
                    and mark in path.read_bytes().split(b"\0")
                    and state(pid) != "Z"
                ):
                    found.append(pid)
        return found

    def shared(self, pid: int) -> list[Path]:
        """Folders in shared memory of a target."""
        return list(SHARED.glob(f"zendsp-{pid}-*"))


def until(holds: Callable[[], object], patience: float = PATIENCE_S) -> bool:
    """Wait until something holds; returns whether it came to that.

    Time counts as far as this process could look: where others take the processor, a look takes
    longer, and what is waited for has had as little of it. So a slow computer is no violation.
    """
    looks, last = int(patience / LOOK_S), time.monotonic() + SLOWER * patience
    while not holds():
        looks -= 1
        if looks < 0 or time.monotonic() > last:
            return False
        time.sleep(LOOK_S)
    return True


def state(pid: int) -> str:
    """State of a process by one letter, empty where there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


def alive(pid: int) -> bool:
    """Whether a process runs."""
    return state(pid) not in ("", "Z")


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    found: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(word) for word in path.read_text().split()]
    return found


def runner_of(target: int) -> int:
    """The process of a target in which its loop runs; beside it one waits to make hardware safe."""
    (found,) = (
        pid
        for pid in children(target)
        if b"--safe" not in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    )
    return found


class Growth:
    """What a process holds more than when it had warmed up: memory, open files, threads.

    Parameters
    ----------
    pid : int
    warm : int
        Looks before the first that counts.
    """

    def __init__(self, pid: int, warm: int = 3) -> None:
        self.pid = pid
        self._warm = warm
        self._first: tuple[float, int, int] | None = None

    def look(self) -> tuple[float, int, int]:
        """Return the growth: MB, files, threads; zeros while it warms up."""
        now = self._now()
        if self._warm > 0 or self._first is None:
            self._warm -= 1
            self._first = now
        return now[0] - self._first[0], now[1] - self._first[1], now[2] - self._first[2]

    def _now(self) -> tuple[float, int, int]:
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        fields = dict(line.split(":", 1) for line in lines)
        files = len(os.listdir(f"/proc/{self.pid}/fd"))
        return int(fields["RssAnon"].split()[0]) / 1024.0, files, int(fields["Threads"])
