"""STOP, measured: from the key to the target, in a real terminal, with busy processes beside it.

    python benchmarks/stop.py [--presses 300] [--busy 2] [--limit-ms 50] [--elsewhere] [--json]

A real ``zendsp tui`` in a pseudo-terminal of 200 × 60 against a real target (planar arm, 1 kHz,
real clock, soft start as it comes). Before each press another screen is opened or the curves are
redrawn. The time of the key is that at which its bytes are written to the terminal. The time of the
target is that of the sample at which the loop latched the STOP, counted back from the newest sample
by the period, the least of several readings: the figure never holds less than the truth.
``--elsewhere`` has the terminal reach the target as one on another computer, over a TCP port,
without shared memory.

A key that is typed waits first in the kernel, whose worker carries it through the pseudo-terminal:
nothing that reads can make that shorter. So beside each press that time is measured alone, on a
bare pseudo-terminal whose reader has the priority of the stopper; and each second press goes past
it, to a second stopper that reads a pipe (as it does under ``--web``). The limit holds for these.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

import zendsp
from zendsp.tui.stop_process import be_prompt

CALL = "from zendsp.cli import main; main()"
F = {2: b"\x1bOQ", 3: b"\x1bOR", 4: b"\x1bOS", 9: b"\x1b[20~"}
CURVES = "q[0],q[1],tau[0],tau[1],e[0],e[1],qd1,qd2"
PATIENCE_S = 10.0
READINGS = 3


def _terminal(arguments: list[str]) -> tuple[int, int]:
    import fcntl
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


class Bare:
    """A pseudo-terminal with nothing but a reader at its end."""

    def __init__(self) -> None:
        self._write, read = pty.openpty()
        tty.setraw(read)
        self._answers, answer = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            be_prompt()
            while os.read(read, 64):
                os.write(answer, struct.pack("d", time.perf_counter()))
            os._exit(0)

    def press(self) -> float:
        """Time from the key to the reader, s."""
        begin = time.perf_counter()
        os.write(self._write, F[9])
        return float(struct.unpack("d", os.read(self._answers, 8))[0]) - begin

    def close(self) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)


class Direct:
    """A second stopper, whose keys come through a pipe."""

    def __init__(self, name: str) -> None:
        read, self._control = os.pipe()
        call = f"from zendsp.tui.stop_process import serve; serve({read}, 2, False)"
        self._process = subprocess.Popen(
            [sys.executable, "-c", call], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, pass_fds=(read,),
        )
        os.write(self._control, f"{name}\n".encode())

    def press(self) -> None:
        assert self._process.stdin is not None
        os.write(self._process.stdin.fileno(), F[9])

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def _until(done: object, what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S * 6
    while not done():  # type: ignore[operator]
        if time.monotonic() > deadline:
            raise SystemExit(f"did not happen: {what}")
        time.sleep(0.02)


def _latched(target: zendsp.Target, begin: float) -> float | None:
    """Time from ``begin`` to the sample at which the loop latched the STOP, s; None where the
    watchdog had ended the loop.
    """
    least = PATIENCE_S
    readings = 0
    while readings < READINGS:
        status = target.status()
        now = time.perf_counter()
        if status.trip is not None:
            readings += 1
            least = min(least, now - begin - (status.tick - status.trip.tick) / status.rate_hz)
        elif status.state == "crashed":
            return None
        elif now - begin > PATIENCE_S:
            return PATIENCE_S
        time.sleep(0.005)  # this process must not be one more busy one
    return least


@contextmanager
def _target(elsewhere: bool) -> Iterator[zendsp.Target]:
    """A target here; if wanted, the environment afterwards leads to it as to one on another
    computer.
    """
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
        with zendsp.local(
            "imi_planar", options=["--listen", "here", "--listen", endpoint, "--users", users.name]
        ) as target:
            os.environ |= {
                "ZENDSP_CONNECT": endpoint,
                "ZENDSP_USER": "bench",
                "ZENDSP_PASSWORD": "mark",
                "ZENDSP_RUNTIME_DIR": nothing,
            }
            yield target


def measure(presses: int, busy: int, elsewhere: bool = False) -> dict[str, list[float]]:
    """Return times, s: `key` and `pipe` to the target (`PATIENCE_S` for one that did not arrive),
    and `kernel` of a key alone.
    """
    chance = random.Random(1)
    burners = []
    times: dict[str, list[float]] = {"key": [], "pipe": [], "kernel": []}
    with tempfile.TemporaryDirectory() as folder, _target(elsewhere) as target:
        target.download("pd.c")
        pid, fd = _terminal(["tui", target.name, "--folder", folder, "--channels", CURVES])
        bare, direct = Bare(), Direct(target.name)
        try:
            _until(lambda: len(target.status().hosts) >= 2, "the terminal connects")
            # for the first pictures; the presses of the first seconds count as well
            time.sleep(2.0)
            burners = [
                subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)
            ]
            for number in range(2 * presses):
                # another real-time program had the CPU for a second: the watchdog
                if target.status().state == "crashed":
                    print(target.status().crash, file=sys.stderr)
                    target.download("pd.c")
                target.acknowledge()
                target.start()
                # the first presses open each screen for the first time
                screen = F[2 + (number + 1) % 3]
                os.write(fd, screen)
                time.sleep(chance.uniform(0.0, 0.1))
                begin = time.perf_counter()
                if number % 2:
                    direct.press()
                else:
                    os.write(fd, F[9])
                took = _latched(target, begin)
                if took is not None:
                    times["pipe" if number % 2 else "key"].append(took)
                time.sleep(chance.uniform(0.1, 0.3))
                if number % 2:
                    times["kernel"].append(bare.press())
            return times
        finally:
            for process in burners:
                process.kill()
                process.wait()
            bare.close()
            direct.close()
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


SAID = {
    "key": "from the key in the terminal to the target",
    "pipe": "past the pseudo-terminal to the target",
    "kernel": "the pseudo-terminal alone, without zendsp",
}


def main() -> None:
    """Measure and print; exit status 1 where the 99th percentile past the pseudo-terminal is above
    the limit.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=300, help="of each kind")
    parser.add_argument("--busy", type=int, default=2, help="processes that compute beside it")
    parser.add_argument("--limit-ms", type=float, default=50.0)
    parser.add_argument(
        "--elsewhere", action="store_true", help="without shared memory, as over a network"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures: dict[str, dict[str, float]] = {}
    for kind, times in measure(options.presses, options.busy, options.elsewhere).items():
        ms = 1e3 * np.array(times)
        p50, p99 = np.percentile(ms, [50, 99])
        figures[kind] = {
            "presses": len(ms),
            "lost": int((ms >= 1e3 * PATIENCE_S).sum()),
            "p50_ms": p50,
            "p99_ms": p99,
            "max_ms": float(ms.max()),
            "late": int((ms > options.limit_ms).sum()),
        }
    if options.json:
        print(json.dumps({"busy": options.busy, "load": os.getloadavg()[0], **figures}))
    else:
        for kind, figure in figures.items():
            print(
                "{:44} p50 {p50_ms:5.1f} ms, p99 {p99_ms:6.1f} ms, max {max_ms:6.1f} ms ({late} of"
                " {presses} above {limit:g} ms, {lost} not within 10 s)".format(
                    SAID[kind], limit=options.limit_ms, **figure
                )
            )
        print(f"{options.busy} busy processes, load {os.getloadavg()[0]:.1f}")
    sys.exit(int(figures["pipe"]["p99_ms"] > options.limit_ms))  # of a NumPy truth it says "False"


if __name__ == "__main__":
    main()
