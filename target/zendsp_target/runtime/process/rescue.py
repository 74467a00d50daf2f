"""A process that waits to bring the machine into its safe state.

It is started together with the runner. Once something has gone wrong, starting a process may fail
for want of memory or of file descriptors (hosts that connect again and again use these up).
"""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys

from zendsp_isr.parts import build_runner
from zendsp_target.runtime.memory.shm import SharedFile

log = logging.getLogger(__name__)

LIMIT_S = 10.0  # for the machine to open and be made safe
NOT_SAFE = "the machine is NOT SAFE: use the machine's emergency stop"


class Rescue:
    """Waits until it is needed or dismissed. If this process is killed, it ends the runner and
    makes the machine safe.

    Parameters
    ----------
    control : SharedFile
        Its own: what stands in the runner's may be what a wild pointer wrote.
    """

    def __init__(self, control: SharedFile) -> None:
        self._control = control
        try:
            self._process = self._begin()
        except BaseException:
            control.unlink()
            raise

    def _begin(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [str(build_runner()), "--safe", str(self._control.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
            cwd="/",
            bufsize=0,
        )

    def guard(self, runner: int) -> None:
        """Tell it the process id of the runner."""
        with contextlib.suppress(OSError):  # it was ended: there is another when it is wanted
            self._tell(runner)

    def stand_by(self, runner: int) -> None:
        """Begin another where it was ended: one that waits needs nothing more, whatever the system
        lacks by then, and makes the machine safe even if this process is killed.
        """
        status = self._process.poll()
        if status is None:
            return
        with contextlib.suppress(OSError):  # none can be had now: tried again in the next round
            ended, self._process = self._process, self._begin()
            assert ended.stdin is not None
            ended.stdin.close()
            self.guard(runner)
            log.warning(
                "the process that waits to make the machine safe was ended (status %d): another"
                " waits in its place", status,
            )

    def _tell(self, number: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(number.to_bytes(4, sys.byteorder))

    def act(self) -> str:
        """Make the machine safe now. Returns why that failed, or an empty string."""
        try:
            if self._process.poll() is not None:  # it has been wanted before, or was ended
                self._process = self._begin()
                self.guard(0)  # it has ended
            self._tell(1)
            status = self._process.wait(LIMIT_S)
            why = f"its process ended with status {status}" if status else ""
        except subprocess.TimeoutExpired:
            self._process.kill()
            why = f"it did not answer within {LIMIT_S:g} s"
        except OSError as error:
            why = str(error)
        if why:
            log.error("%s: %s", NOT_SAFE, why)
        return why and f"{NOT_SAFE} ({why})"

    def dismiss(self) -> None:
        """End it; it is no longer needed."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._tell(0)
            self._process.stdin.close()
        try:
            self._process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._control.unlink()
