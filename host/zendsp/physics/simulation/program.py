"""A control program run against a simulated machine, in a child process that may crash or hang
without harm.
"""

from __future__ import annotations

import contextlib
import faulthandler
import mmap
import os
import pickle
import select
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import CompileFailed, RunnerDied, ZendspError
from zendsp.physics.simulation.loaded import Job, LoadedProgram, Outcome
from zendsp.physics.simulation.plant import Plant
from zendsp_isr.sources import Source, gather
from zendsp_protocol.states import Severity


@dataclass(frozen=True)
class Build:
    """A compiled program: its shared object, its sources, and how it was compiled."""

    path: Path
    sources: Mapping[str, str]
    compiler: str
    flags: tuple[str, ...]


def compile_program(program: Source, flags: Sequence[str] = ()) -> Build:
    """Compile a control program for this computer.

    Parameters
    ----------
    program : path, name of a shipped example, or mapping of file name to text
        A path brings the files beside it that it includes.
    flags : sequence of str
        Further flags for the compiler.

    Raises
    ------
    CompileFailed
        With file, line and column of each message.
    """
    from zendsp_isr.build import build, source_root

    sources = gather(program)
    encoded = {name: text.encode() for name, text in sources.items()}
    built = build("program", encoded, [source_root() / "include"], flags=tuple(flags))
    if built.path is None:
        lines = [str(m) for m in built.messages if m.severity == Severity.ERROR]
        raise CompileFailed("\n".join(lines))
    return Build(built.path, sources, built.compiler, tuple(flags))


def run_program(build: Build, plant: Plant, job: Job, timeout_s: float) -> Outcome:
    """Run a program against a machine.

    Parameters
    ----------
    plant : Plant
        Fresh: its samples bound the length.
    timeout_s : float
        Of real time, s.

    Raises
    ------
    RunnerDied
        The program crashed or did not finish in time; the message says at which sample.
    VariableError
        A parameter that the program does not have, or a value outside its limits.
    AcquisitionError
        A channel that does not exist.
    """
    progress = mmap.mmap(-1, 8)
    out, into = os.pipe()
    child = os.fork()
    if child == 0:  # nothing of the parent's may run here: no exception passes, no exit handler
        status = 1
        with contextlib.suppress(BaseException):
            os.close(out)
            faulthandler.disable()  # a crash of the program is told in one sentence, by the parent
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            _child(build, plant, job, progress, into)
            status = 0
        os._exit(status)
    os.close(into)
    try:
        answer = _collect(out, time.monotonic() + timeout_s)
        if answer is None:
            os.kill(child, signal.SIGKILL)
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        os.close(out)
        _, status = os.waitpid(child, 0)
    tick = int(np.frombuffer(progress, np.int32, 1)[0])
    if answer is None:
        raise RunnerDied(
            f"the program did not finish within {timeout_s:g} s; it was in sample {tick}: does a"
            " loop never end?"
        )
    if os.WIFSIGNALED(status):
        raise RunnerDied(
            f"the program crashed in sample {tick} (signal"
            f" {signal.Signals(os.WTERMSIG(status)).name})"
        )
    try:
        result = pickle.loads(answer)
    except (pickle.UnpicklingError, EOFError, AttributeError):
        raise RunnerDied(
            f"the program ended its process in sample {tick} (did it call exit()?)"
        ) from None
    if isinstance(result, ZendspError):
        raise result
    assert isinstance(result, Outcome)
    return result


def _collect(out: int, deadline: float) -> bytes | None:
    parts: list[bytes] = []
    while True:
        left = deadline - time.monotonic()
        ready, _, _ = select.select([out], [], [], max(0.0, left))
        if not ready:
            return None
        part = os.read(out, 1 << 20)
        if not part:
            return b"".join(parts)
        parts.append(part)


def _child(build: Build, plant: Plant, job: Job, progress: mmap.mmap, into: int) -> None:
    try:
        loaded = LoadedProgram(build.path, next(iter(build.sources)), plant)
        result: Any = loaded.run(job, progress)
    except ZendspError as error:
        result = error
    data = memoryview(pickle.dumps(result, protocol=pickle.HIGHEST_PROTOCOL))
    while data:
        data = data[os.write(into, data) :]
