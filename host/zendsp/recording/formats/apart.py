"""Reads files in other processes, for libraries whose native code crashes on a damaged file.

One process loads the library and forks for every file, so that only the first file pays for
loading.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.formats.raw import Raw

REFUSED = 3  # exit status: what was said is for the user
IDLE = 60.0  # s without a file after which the process that has the library ends


class _Reader:
    """A process that has loaded a module's library, for one process of ours."""

    def __init__(self, module: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,  # Ctrl-C is for us; it ends when we do
        )
        atexit.register(self.close)

    def status(self, path: Path, result: Path) -> int | None:
        """The exit status of reading a file; None where the process itself is gone."""
        assert self.process.stdin and self.process.stdout
        try:
            self.process.stdin.write(json.dumps([os.getcwd(), str(path), str(result)]) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return None
        line = self.process.stdout.readline()
        return int(line) if line else None

    def close(self) -> None:
        """End it."""
        atexit.unregister(self.close)
        if self.process.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGTERM)  # also what it reads just now
        try:
            self.process.communicate()
        except BrokenPipeError:
            self.process.wait()


_readers: dict[tuple[int, str], _Reader] = {}  # by our process (a fork has none) and module
_one_at_a_time = threading.Lock()


def _ended(module: str, path: Path, result: Path) -> int | None:
    """The exit status of reading a file, by a reader that exists or a new one."""
    key = (os.getpid(), module)
    with _one_at_a_time:
        for _ in range(2):
            if key not in _readers:
                _readers[key] = _Reader(module)
            status = None
            try:
                status = _readers[key].status(path, result)
            finally:  # it was idle, or is interrupted: its answer must not be the next one's
                if status is None:
                    _readers.pop(key).close()
            if status is not None:
                return status
    return None


def read_apart(module: str, path: Path) -> Raw:
    """What ``module.parse(path)`` returns, called in a process that may crash.

    Raises
    ------
    RecordingError
        What the reader says; or that the file broke it.
    """
    with tempfile.TemporaryDirectory() as folder:
        result, words = Path(folder, "raw.npz"), Path(folder, "raw.npz.said")
        status = _ended(module, path, result)
        said = words.read_text(errors="replace").strip() if words.exists() else ""
        if status == REFUSED:
            raise RecordingError(said.partition("\0")[2])
        if status is not None and status < 0:
            raise ValueError(f"its reader ended on {signal.Signals(-status).name}")
        if status or not result.exists():
            raise ValueError((said.splitlines() or ["its reader ended without a word"])[-1])
        with np.load(result, allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            columns = {name: stored[f"c{k}"] for k, name in enumerate(about["names"])}
    return Raw(
        columns, about["units"], about["constants"], about["metadata"], about["refused"],
        tuple(about["notes"]),
    )


def _serve(module: str) -> None:
    """Fork for each file that is asked for, until the other end closes."""
    reader = import_module(module)
    reader.library()
    while select.select([sys.stdin], [], [], IDLE)[0] and (line := sys.stdin.readline()):
        folder, path, result = json.loads(line)
        child = os.fork()
        if child == 0:
            os.chdir(folder)  # names are meant as the one who asks means them
            _forked(reader, path, result)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _forked(reader: ModuleType, path: str, result: str) -> None:
    """Read one file and end; messages are written beside the result."""
    os.dup2(os.open(f"{result}.said", os.O_WRONLY | os.O_CREAT, 0o600), 2)
    os.dup2(2, 1)
    status = 1
    try:
        status = _parsed(reader, path, result)
    except BaseException:  # its last line says why
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def _parsed(reader: ModuleType, path: str, result: str) -> int:
    try:
        raw: Raw = reader.parse(Path(path))
    except RecordingError as error:
        sys.stderr.write(f"\0{error}")
        return REFUSED
    about = {
        "names": list(raw.columns), "units": raw.units, "constants": raw.constants,
        "metadata": raw.metadata, "refused": raw.refused, "notes": raw.notes,
    }
    arrays = {f"c{k}": values for k, values in enumerate(raw.columns.values())}
    np.savez(result, allow_pickle=False, about=np.array(json.dumps(about)), **arrays)
    return 0


if __name__ == "__main__":
    _serve(*sys.argv[1:])
