"""The commands that one types all day: how long each takes, with one target here and with many.

python benchmarks/hand.py [--targets 20] [--times 15]
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time

ZENDSP = [sys.executable, "-m", "zendsp"]
TYPED = 100  # commands in a shell


def spent() -> tuple[float, float]:
    """Time now, and CPU time of all children that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter(), used.ru_utime + used.ru_stime


def measure(commands: dict[str, list[str]], times: int) -> None:
    """Run the commands in turns, and print the median of each."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    for _ in range(times):
        for name, command in commands.items():
            wall, cpu = spent()
            subprocess.run(command, check=True, capture_output=True)
            after = spent()
            found[name].append((after[0] - wall, after[1] - cpu))
    for name, rows in found.items():
        wall, cpu = (statistics.median(column) for column in zip(*rows, strict=True))
        print(f"{name:28s} {1e3 * wall:4.0f} ms, of it CPU {1e3 * cpu:3.0f} ms")


def shell() -> None:
    """Print what a command takes in ``zendsp shell``, over its one link."""
    took = []
    for count in (1, 1 + TYPED):
        begin = time.perf_counter()
        subprocess.run(
            [*ZENDSP, "shell", "-t", "t0"], input="get Kp1\n" * count, text=True, check=True,
            capture_output=True,
        )  # fmt: skip
        took.append(time.perf_counter() - begin)
    print(f"get in a shell               {1e3 * (took[1] - took[0]) / TYPED:4.1f} ms")


def main() -> None:
    """Start targets, and type."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--targets", type=int, default=20)
    p.add_argument("--times", type=int, default=15)
    a = p.parse_args()
    os.environ["ZENDSP_RUNTIME_DIR"] = tempfile.mkdtemp()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # nobody compiles zendsp at each command
    target = [sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--json"]
    running: list[subprocess.Popen[str]] = []

    def start(name: str) -> None:
        running.append(
            subprocess.Popen(
                [*target, "--name", name], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                text=True,
            )
        )
        assert running[-1].stdout is not None
        running[-1].stdout.readline()

    try:
        start("t0")
        subprocess.run([*ZENDSP, "run", "pd.c", "-t", "t0"], check=True, capture_output=True)
        one = {
            "python -c pass": [sys.executable, "-c", "pass"],
            "get": [*ZENDSP, "get", "-t", "t0", "Kp1"],
            "set": [*ZENDSP, "set", "-t", "t0", "Kp1=2000"],
            "ls": [*ZENDSP, "ls"],
        }
        measure(one, a.times)
        shell()
        for k in range(1, a.targets):
            start(f"t{k}")
        measure({f"ls of {a.targets} targets": [*ZENDSP, "ls"]}, a.times)
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait()
    print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
