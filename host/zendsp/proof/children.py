"""Child processes of the proof: each ends with its parent, within its time, and its CPU seconds are
known.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from zendsp.cluster import connect
from zendsp.parent import call, die_with
from zendsp_isr.build import cache_root

POLL = 0.02  # s, between two looks at a child


def command(*words: str) -> tuple[str, ...]:
    """``zendsp WORDS…`` as a process that ends with this one."""
    return (sys.executable, "-P", "-c", call(os.getpid()), *words)


def module(name: str, *words: str) -> tuple[str, ...]:
    """``python -m NAME WORDS…`` as a process that ends with this one."""
    code = (
        f"import runpy; from zendsp.parent import die_with; die_with({os.getpid()}); "
        f"runpy.run_module({name!r}, run_name='__main__', alter_sys=True)"
    )
    return (sys.executable, "-P", "-c", code, *words)


@dataclass(frozen=True)
class Ended:
    """How a child ended; `status` None: it was ended at its limit."""

    status: int | None
    seconds: float
    cpu: float  # s, of the child and of what it waited for
    last_words: str  # last line of its standard error


def environment() -> dict[str, str]:
    """The variables of a child."""
    # small matrices in many processes: more threads of the linear algebra only wait for each other
    out = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    if out.pop("PYTHONDONTWRITEBYTECODE", ""):
        # else each child compiles 500 modules, of NumPy too: 2.2 s of CPU of a start that takes 0.9
        out["PYTHONPYCACHEPREFIX"] = str(cache_root() / "python")
    return out


_running: set[subprocess.Popen[bytes]] = set()
_lock = threading.Lock()
_over = threading.Event()  # all are being ended: none begins


def run(line: Sequence[str], out: Path, limit: float) -> Ended:
    """Run a command to its end or for `limit` seconds; its output goes to stdout.txt and stderr.txt
    under `out`.
    """
    out.mkdir(parents=True, exist_ok=True)
    env = environment()
    begin = time.perf_counter()
    with (out / "stderr.txt").open("w") as errors, (out / "stdout.txt").open("w") as output:
        with _lock:
            if _over.is_set():
                raise InterruptedError("the proof has been ended")
            process = subprocess.Popen(
                line, stdout=output, stderr=errors, env=env, start_new_session=True
            )
            _running.add(process)
        try:
            status, cpu = wait(process, begin + limit)
        except BaseException:  # Ctrl-C
            end(process)
            raise
        finally:
            with _lock:
                _running.discard(process)
    words = (out / "stderr.txt").read_text(errors="replace").strip().splitlines() or ["no words"]
    return Ended(status, time.perf_counter() - begin, cpu, words[-1])


def wait(process: subprocess.Popen[bytes], deadline: float) -> tuple[int | None, float]:
    """Exit status and CPU seconds of a child; None where it had to be ended at the deadline."""
    late = False
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            cpu = usage.ru_utime + usage.ru_stime
            return (None if late else process.returncode), cpu
        if not late and time.perf_counter() > deadline:
            late = True
            end(process)
        time.sleep(POLL)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a child and all that it has started in its session."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def end_all() -> None:
    """End every child that runs now, and let none begin."""
    with _lock:
        _over.set()
        for process in _running:
            end(process)


@contextmanager
def workers(pool: AbstractContextManager[Executor]) -> Iterator[Executor]:
    """The executor of `pool`; an exception drops what waits and ends what runs before the block is
    left.
    """
    try:
        with pool as executor:
            try:
                yield executor
            except BaseException:
                executor.shutdown(wait=False, cancel_futures=True)
                end_all()
                for process in multiprocessing.active_children():
                    process.kill()
                raise
    finally:
        _over.clear()


def threads(jobs: int) -> AbstractContextManager[Executor]:
    """Threads, each of which runs one child at a time."""
    return ThreadPoolExecutor(jobs)


def processes(jobs: int) -> AbstractContextManager[Executor]:
    """Processes that end with this one."""
    return ProcessPoolExecutor(jobs, initializer=_child, initargs=(os.getpid(),))


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler, which see files under the same paths."""
    with connect(address) as client:
        yield client.get_executor(pure=False)


def _child(parent: int) -> None:
    die_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent answers Ctrl-C for all
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
