"""The user of a journey: an installed wheel, an empty folder, and the processes it started."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import sin, tanh
from pathlib import Path

import numpy as np
from waiting import PATIENCE_S, until

__all__ = ["BENCH", "PATIENCE_S", "STEP", "Installed", "record_bench", "until"]

STEP = 0.004  # s, of a row of a bench's recording
BENCH = f"""name = "bench"
sample_time = {STEP}

[mechanism]
kind = "rotary"
parameters = {{ inertia = 0.01 }}

[sensor]
position_resolution = 1e-5

[columns]
time = "t"
position = "q"
command = "u"
"""


def record_bench(path: Path, coulomb: float = 0.05, inner: int = 20) -> None:
    """Write the recording of a PD-controlled joint with dry friction that `BENCH` does not have."""
    h = STEP / inner
    q = qd = 0.0
    rows = []
    for k in range(1000):
        t = k * STEP
        r = sum(0.3 * sin(w * t + p) for w, p in ((2.1, 0.0), (5.3, 1.0), (9.7, 2.0)))
        seen = round(q / 1e-5) * 1e-5
        u = 4.0 * (r - seen) - 0.2 * qd
        rows.append((t, seen, u))
        for _ in range(inner):
            qd += h * (u - coulomb * tanh(qd / 1e-3)) / 0.01
            q += h * qd
    np.savetxt(path, rows, delimiter=",", header="t,q,u", comments="")


@dataclass
class Installed:
    """A user: the wheel in an environment of its own, and an empty folder to work in.

    Attributes
    ----------
    python, zendsp : Path
        The environment's interpreter and the command that the wheel installs.
    folder : Path
        Empty at first; the working directory and home of all that is started.
    env : dict
        The environment of all that is started; no target of the developer is seen or disturbed.
    """

    python: Path
    zendsp: Path
    folder: Path
    env: dict[str, str]
    processes: list[subprocess.Popen[str]] = field(default_factory=list)

    def run(
        self,
        *command: str | Path,
        timeout: float = PATIENCE_S,
        env: Mapping[str, str] | None = None,
        **options: object,
    ) -> subprocess.CompletedProcess[str]:
        """Run `zendsp …` to its end; output as text."""
        return subprocess.run(
            [str(self.zendsp), *map(str, command)],
            cwd=self.folder,
            env={**self.env, **(env or {})},
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
            **options,  # type: ignore[call-overload]
        )

    def script(
        self, text: str, *arguments: str, timeout: float = PATIENCE_S
    ) -> subprocess.CompletedProcess[str]:
        """Run a Python script of the user's to its end."""
        path = self.write("script.py", text)
        return subprocess.run(
            [str(self.python), str(path), *arguments],
            cwd=self.folder,
            env=self.env,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    def write(self, name: str, text: str) -> Path:
        """Write a file of the user's."""
        path = self.folder / name
        path.write_text(text)
        return path

    def start(
        self,
        *command: str | Path,
        env: Mapping[str, str] | None = None,
        stdin: int = subprocess.DEVNULL,
    ) -> subprocess.Popen[str]:
        """Start a program beside the test, in a process group of its own; it is ended with the
        test.

        The first word is `zendsp`, `python`, or a path.
        """
        first = {"zendsp": self.zendsp, "python": self.python}.get(str(command[0]), command[0])
        process = subprocess.Popen(
            [str(first), *map(str, command[1:])],
            cwd=self.folder,
            env={**self.env, **(env or {})},
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.processes.append(process)
        return process

    def target(
        self, name: str = "imi", machine: str = "imi_planar", *options: str
    ) -> subprocess.Popen[str]:
        """Start `zendsp target` and wait until it is registered: then it serves."""
        # no journey asks how late a sample is: its loop sleeps until each, and spares the processor
        command = ("zendsp", "target", "--machine", machine, "--name", name, "--spin", "0")
        process = self.start(*command, *options)
        entry = Path(self.env["ZENDSP_RUNTIME_DIR"]) / f"{name}.json"

        def registered() -> bool:  # not the one before it, which was killed
            return entry.exists() and json.loads(entry.read_text())["pid"] == process.pid

        until(registered, f"target {name} registered", alive=process)
        return process

    def end(self) -> None:
        """End all that was started and is still there."""
        for process in self.processes:
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGTERM)
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait(10)
            if process.stdout is not None:
                process.stdout.close()
        # a loop that a journey froze cannot end itself; only journeys run what is in their cache
        own = self.env["XDG_CACHE_HOME"]
        for pid in filter(str.isdigit, os.listdir("/proc")):
            with contextlib.suppress(OSError):
                if os.readlink(f"/proc/{pid}/exe").startswith(own):
                    os.kill(int(pid), signal.SIGKILL)
