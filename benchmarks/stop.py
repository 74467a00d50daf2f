"""STOP, measured: from the key to the target, in a real terminal, with busy processes beside it.

    python benchmarks/stop.py [--presses 100] [--busy 2] [--limit-ms 50] [--json]

A real ``zendsp tui`` in a pseudo-terminal of 200 × 60 against a real target (planar arm, 1 kHz, real clock, soft start as
it comes). Before each press another screen is opened or the curves are redrawn. The time of the key is that at which its
bytes are written to the terminal. The time of the target is that at which this process, which polls shared status through
a link of its own, first sees the STOP latched: the figure holds the time of one poll as well.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np

import zendsp

CALL = "from zendsp.cli import main; main()"
F = {2: b"\x1bOQ", 3: b"\x1bOR", 4: b"\x1bOS", 9: b"\x1b[20~"}
CURVES = "q[0],q[1],tau[0],tau[1],e[0],e[1],qd1,qd2"
PATIENCE_S = 10.0


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


def measure(presses: int, busy: int) -> list[float]:
    """Return the times from key to target, s."""
    chance = random.Random(1)
    burners = []
    with tempfile.TemporaryDirectory() as folder, zendsp.local("imi_planar") as target:
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
                while target.status().trip is None:
                    if time.perf_counter() - begin > PATIENCE_S:
                        raise SystemExit(f"press {number}: STOP did not arrive within {PATIENCE_S:g} s")
                    time.sleep(0.001)  # this process must not be one more busy one
                times.append(time.perf_counter() - begin)
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
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--busy", type=int, default=2, help="processes that compute beside it")
    parser.add_argument("--limit-ms", type=float, default=50.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    ms = 1e3 * np.array(measure(options.presses, options.busy))
    figures = {"presses": len(ms), "busy": options.busy, "p50_ms": float(np.percentile(ms, 50)),
               "p99_ms": float(np.percentile(ms, 99)), "max_ms": float(ms.max())}  # fmt: skip
    print(json.dumps(figures) if options.json else
          "STOP, key to target: p50 {p50_ms:.1f} ms, p99 {p99_ms:.1f} ms, max {max_ms:.1f} ms "
          "({presses} presses, {busy} busy processes)".format(**figures))  # fmt: skip
    sys.exit(figures["p99_ms"] > options.limit_ms)


if __name__ == "__main__":
    main()
