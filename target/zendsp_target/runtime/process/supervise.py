"""Watches one runner: notices at once when it dies, ends it when it hangs, and brings the machine
into its safe state.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.process.runner import RunnerProcess, ffi_address
from zendsp_target.threads import start_thread

log = logging.getLogger(__name__)

_ROUND_S = 0.05


def processor(pid: int) -> tuple[bool, float]:
    """Whether a process's first thread is running or ready to run, and the processor time that it
    has had, s.
    """
    task = Path(f"/proc/{pid}/task/{pid}")
    try:
        state = (task / "stat").read_text(errors="replace").rpartition(")")[2].split()[0]
        had = (task / "schedstat").read_text().split()[0]
    except (OSError, IndexError):  # it has ended, or the kernel does not count
        return False, 0.0
    return state == "R", 1e-9 * int(had)


def _do(each_round: Callable[[], None]) -> None:
    """Call ``each_round`` and log what it raises. An error, for want of memory for example, must
    not end the watch: nobody would then see the runner die and make its machine safe.
    """
    try:
        each_round()
    except Exception:
        log.exception("a round of the watch of a runner failed; it goes on")


class Supervisor:
    """A thread that lives as long as its runner.

    Parameters
    ----------
    each_round : callable
        Called about twenty times a second while the runner lives, and once after.
    on_death : callable
        Called once, with a sentence, when the runner ended without being asked to.
    """

    def __init__(
        self,
        process: RunnerProcess,
        each_round: Callable[[], None],
        on_death: Callable[[str], None],
    ) -> None:
        self._process = process
        self._expected = threading.Event()
        self._had = 0.0  # of a processor, by the loop
        # The thread alone keeps them, and only until its end: they lead back to who keeps this, and
        # a program that was replaced would stay mapped until the garbage collector comes.
        self._thread = start_thread("supervisor", partial(self._run, each_round, on_death))

    def expect_end(self) -> None:
        """Note that the runner is about to be ended on purpose."""
        self._expected.set()

    def join(self, timeout_s: float = 5.0) -> None:
        """Wait until the thread has ended."""
        if self._thread is not threading.current_thread():
            self._thread.join(timeout_s)

    def _run(self, each_round: Callable[[], None], on_death: Callable[[str], None]) -> None:
        _, lib = layout()
        heartbeat = ffi_address(self._process.control, "heartbeat")
        seen, stalled, last = -1, 0.0, time.monotonic()
        while not self._process.wait_death(_ROUND_S):
            self._process.look()
            _do(self._process.keep_rescue)
            _do(each_round)
            beat, now = int(lib.monitor_load64(heartbeat)), time.monotonic()
            # a computer that stood still, or starved this thread, must not make a program look hung
            passed, last = min(now - last, 2.0 * _ROUND_S), now
            # odd: within a sample. Even: the loop waits for its deadline, which a slow rate may set
            # far ahead
            allowed = self._process.settings.hang_s + (
                0.0 if beat % 2 else 2.0 / self._process.settings.rate_hz
            )
            stalled = stalled + self._lost(passed) if beat == seen else 0.0
            seen = beat
            if stalled > allowed:
                sentence = self._end_hung()
                _do(each_round)
                if not self._expected.is_set():
                    on_death(sentence)
                return
        self._process.end_group()
        _do(each_round)
        if not self._expected.is_set():
            unsafe = self._process.make_safe()
            on_death("; ".join(filter(None, (self._process.death(), unsafe))))

    def _lost(self, passed: float) -> float:
        """How much of the last ``passed`` seconds counts as hanging, for a loop that did no sample
        in them.

        For a simulated machine this is the time in which the loop had a processor or did not wait
        for one: on a busy computer a program that waits for its turn does not hang. For hardware
        all of it counts, whatever the reason.
        """
        if not self._process.simulated:
            return passed
        waits, had = processor(self._process.pid)
        before, self._had = self._had, had
        return min(passed, had - before) if waits else passed

    def _end_hung(self) -> str:
        self._process.ask_where()
        sentence = self._process.death(hung=True)
        self._process.kill()
        return "; ".join(filter(None, (sentence, self._process.make_safe())))
