"""Many targets on one computer: what their loops and monitors take of its processors.

python benchmarks/many.py 50
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time


def used(process: subprocess.Popen[str]) -> tuple[float, float]:
    """CPU seconds so far of a target's own process, and of those beneath it."""
    below = subprocess.run(
        ["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=False
    ).stdout.split()
    own, *others = (_seconds(pid) for pid in (str(process.pid), *below))
    return own, sum(others)


def _seconds(pid: str) -> float:
    with open(f"/proc/{pid}/stat") as file:
        words = file.read().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Start them one after the other, let all run, and look for ten seconds."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("targets", type=int, nargs="?", default=20)
    targets = p.parse_args().targets
    os.environ["ZENDSP_RUNTIME_DIR"] = tempfile.mkdtemp()
    command = [sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--json"]
    running: list[subprocess.Popen[str]] = []
    from zendsp import connect

    try:
        for k in range(targets):
            running.append(
                subprocess.Popen(
                    [*command, "--name", f"t{k}"],
                    stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                )
            )
            assert running[-1].stdout is not None
            running[-1].stdout.readline()
        for k in range(targets):
            with connect(f"t{k}", timeout=30.0) as target:
                target.download("pd.c")
                target.start()
        before, begin = [used(process) for process in running], time.monotonic()
        time.sleep(10.0)
        after, seconds = [used(process) for process in running], time.monotonic() - begin
        monitors, loops = (
            sum(b[part] - a[part] for a, b in zip(before, after, strict=True)) / seconds
            for part in (0, 1)
        )
        overruns = ticks = 0
        for k in range(targets):
            with connect(f"t{k}", timeout=30.0) as target:
                timing = target.status().timing
                overruns, ticks = overruns + timing.overruns, ticks + timing.ticks
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait()
    print(
        f"{targets} targets at 1 kHz: loops {loops:.2f} of {os.cpu_count()} processors, monitors"
        f" {monitors:.2f}; {overruns} of {ticks} samples took longer than their period; load"
        f" {os.getloadavg()[0]:.1f}"
    )


if __name__ == "__main__":
    main()
