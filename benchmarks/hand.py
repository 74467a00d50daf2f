"""How long a hand waits for a command: wall time of `zendsp ls`, `get`, `set` against `python -c
"import zenoh"`.

    python benchmarks/hand.py [--runs 15] [--targets 20]

Starts a target of its own. Each command is timed side by side with its peer, the best of `--runs`:
what a quiet moment of this computer gives. Then `ls` with many targets.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

ZENDSP = str(Path(sysconfig.get_path("scripts")) / "zendsp")
PEER = [sys.executable, "-c", "import zenoh"]


def seconds(command: list[str]) -> float:
    """Wall time of one command that must succeed."""
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def side_by_side(command: list[str], runs: int) -> tuple[float, float]:
    """Best wall times of a command and its peer, taken in turn."""
    pairs = [(seconds(command), seconds(PEER)) for _ in range(runs)]
    return min(ours for ours, _ in pairs), min(peer for _, peer in pairs)


def start(name: str) -> subprocess.Popen[bytes]:
    """A target on the fast clock; ready when it returns."""
    command = [
        sys.executable, "-m", "zendsp_target", "--machine", "imi_planar", "--clock", "fast",
        "--name", name, "--json",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--targets", type=int, default=20)
    options = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ZENDSP_RUNTIME_DIR"] = folder
        os.environ.setdefault("PYTHONPYCACHEPREFIX", f"{folder}/bytecode")
        processes = [start("hand0")]
        try:
            subprocess.run([ZENDSP, "load", "pd.c"], check=True, stdout=subprocess.DEVNULL)
            print(f"{'command':<24}{'s':>8}{'import zenoh':>14}{'ratio':>8}")
            for words in (["ls"], ["get", "Kp1"], ["get"], ["set", "Kp1=450"], ["info"]):
                ours, peer = side_by_side([ZENDSP, *words], options.runs)
                print(f"zendsp {' '.join(words):<17}{ours:>8.3f}{peer:>14.3f}{ours / peer:>8.2f}")
            one = min(seconds([ZENDSP, "ls"]) for _ in range(options.runs))
            processes += [start(f"hand{k}") for k in range(1, options.targets)]
            many = min(seconds([ZENDSP, "ls"]) for _ in range(options.runs))
            print(
                f"zendsp ls, {options.targets} targets: {many:.3f} s, {many / one:.2f} times that"
                " of one"
            )
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.wait()


if __name__ == "__main__":
    main()
