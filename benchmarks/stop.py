"""STOP, measured: from the key to the target, in a real terminal, with busy processes beside it.

    python benchmarks/stop.py [--presses 300] [--busy 2] [--limit-ms 50] [--elsewhere] [--json]

A real ``zendsp tui`` in a pseudo-terminal of 200 × 60 against a real target (planar arm, 1 kHz, real clock, soft start as
it comes). Before each press another screen is opened or the curves are redrawn. The time of the key is that at which its
bytes are written to the terminal. The time of the target is that of the sample at which the loop latched the STOP, counted
back from the newest sample by the period, the least of several readings: the figure never holds less than the truth.
``--elsewhere`` has the terminal reach the target as one on another computer, over a TCP port, without shared memory.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

import zendsp

CALL = "from zendsp.cli import main; main()"
F = {2: b"\x1bOQ", 3: b"\x1bOR", 4: b"\x1bOS", 9: b"\x1b[20~"}
CURVES = "q[0],q[1],tau[0],tau[1],e[0],e[1],qd1,qd2"
PATIENCE_S = 10.0
READINGS = 3


def _terminal(arguments: list[str]) -> tuple[int, int]:
    import fcntl
    import struct
    import termios

    pid, fd = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
        os.execv(sys.executable, [sys.executable, "-c", CALL, *arguments])
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack("HHHH", 60, 200, 0, 0))

    def drain() -> None:
        try:
            while os.read(fd, 1 << 16):
                pass
        except OSError:
            return

    threading.Thread(target=drain, daemon=True).start()
    return pid, fd


def _until(done: object, what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S * 6
    while not done():  # type: ignore[operator]
        if time.monotonic() > deadline:
            raise SystemExit(f"did not happen: {what}")
        time.sleep(0.02)


def _latched(target: zendsp.Target, begin: float) -> float:
    """Time from ``begin`` to the sample at which the loop latched the STOP, s."""
    least = PATIENCE_S
    readings = 0
    while readings < READINGS:
        status = target.status()
        now = time.perf_counter()
        if status.trip is not None:
            readings += 1
            least = min(least, now - begin - (status.tick - status.trip.tick) / status.rate_hz)
        elif now - begin > PATIENCE_S:
            return PATIENCE_S
        time.sleep(0.005)  # this process must not be one more busy one
    return least


@contextmanager
def _target(elsewhere: bool) -> Iterator[zendsp.Target]:
    """A target here; if wanted, the environment afterwards leads to it as to one on another computer."""
    if not elsewhere:
        with zendsp.local("imi_planar") as target:
            yield target
        return
    users = tempfile.NamedTemporaryFile("w", suffix=".users")  # noqa: SIM115
    with tempfile.TemporaryDirectory() as nothing, users, socket.socket() as free:
        users.write("bench:mark\n")
        users.flush()
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        free.close()
        with zendsp.local("imi_planar", options=["--listen", "here", "--listen", endpoint, "--users", users.name]) as target:
            os.environ |= {"ZENDSP_CONNECT": endpoint, "ZENDSP_USER": "bench", "ZENDSP_PASSWORD": "mark",
                           "ZENDSP_RUNTIME_DIR": nothing}  # fmt: skip
            yield target


def measure(presses: int, busy: int, elsewhere: bool = False) -> list[float]:
    """Return the times from key to target, s; `PATIENCE_S` for one that did not arrive."""
    chance = random.Random(1)
    burners = []
    with tempfile.TemporaryDirectory() as folder, _target(elsewhere) as target:
        target.download("pd.c")
        pid, fd = _terminal(["tui", target.name, "--folder", folder, "--channels", CURVES])
        try:
            _until(lambda: len(target.status().hosts) >= 3, "the terminal connects")
            time.sleep(2.0)  # for the first pictures; the presses of the first seconds count as well
            burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
            times = []
            for number in range(presses):
                target.acknowledge()
                target.start()
                screen = F[2 + (number + 1) % 3]  # the first presses open each screen for the first time
                os.write(fd, screen)
                time.sleep(chance.uniform(0.0, 0.1))
                begin = time.perf_counter()
                os.write(fd, F[9])
                times.append(_latched(target, begin))
                time.sleep(chance.uniform(0.1, 0.3))
            return times
        finally:
            for process in burners:
                process.kill()
                process.wait()
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


def main() -> None:
    """Measure and print; exit status 1 where the 99th percentile is above the limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presses", type=int, default=300)
    parser.add_argument("--busy", type=int, default=2, help="processes that compute beside it")
    parser.add_argument("--limit-ms", type=float, default=50.0)
    parser.add_argument("--elsewhere", action="store_true", help="without shared memory, as over a network")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    ms = 1e3 * np.array(measure(options.presses, options.busy, options.elsewhere))
    figures = {"presses": len(ms), "busy": options.busy, "lost": int((ms >= 1e3 * PATIENCE_S).sum()),
               "load": os.getloadavg()[0], "p50_ms": float(np.percentile(ms, 50)),
               "p99_ms": float(np.percentile(ms, 99)), "max_ms": float(ms.max())}  # fmt: skip
    print(json.dumps(figures) if options.json else
          "STOP, key to target: p50 {p50_ms:.1f} ms, p99 {p99_ms:.1f} ms, max {max_ms:.1f} ms "
          "({presses} presses, {lost} not within 10 s, {busy} busy processes, load {load:.1f})".format(**figures))  # fmt: skip
    sys.exit(figures["p99_ms"] > options.limit_ms)


if __name__ == "__main__":
    main()
