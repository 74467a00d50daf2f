"""The terminal, measured: what a picture costs, how long a key takes, whether memory grows.

    python benchmarks/tui.py [--only first picture key lost terminal] [--seconds 20] [--soak 300]
        [--trace soak.csv] [--json]

Everything is measured on a real ``zendsp tui`` in a pseudo-terminal of 160 × 48 against a real
target process (planar arm, 1 kHz, real clock), with eight curves, except the cost of one picture,
which is also timed alone in this process.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

CURVES = "q[0],q[1],tau[0],tau[1],e[0],e[1],qd1,qd2"
TICK = os.sysconf("SC_CLK_TCK")
CALL = "from zendsp.cli import main; main()"
EMPTY = (  # the least that Textual can show: what no terminal on it can be quicker than
    "from textual.app import App; from textual.widgets import Static\n"
    "class A(App):\n    def compose(self): yield Static('Reference')\n"
    "A().run()"
)


class Terminal:
    """A command in a pseudo-terminal, its output read and counted."""

    def __init__(
        self, arguments: list[str], columns: int = 160, rows: int = 48, call: str = CALL
    ) -> None:
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.environ |= {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
            os.execv(sys.executable, [sys.executable, "-c", call, *arguments])
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self.bytes = 0
        self.seen = b""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while True:
            try:
                data = os.read(self._fd, 1 << 16)
            except OSError:
                return
            self.bytes += len(data)
            self.seen = (self.seen + data)[-200_000:]

    def keys(self, text: str) -> None:
        os.write(self._fd, text.encode())

    def cpu(self) -> float:
        """CPU time of the process itself, s."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICK

    def memory(self) -> float:
        """Resident memory, kB."""
        for line in Path(f"/proc/{self.pid}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return float(line.split()[1])
        return float("nan")

    def close(self) -> None:
        os.kill(self.pid, signal.SIGTERM)
        os.waitpid(self.pid, 0)


def first_picture(n: int = 7) -> dict[str, float]:
    """From the command to its first picture, by turns with an empty Textual application."""
    found: dict[str, list[float]] = {"zendsp": [], "empty": []}
    cpu: dict[str, list[float]] = {"zendsp": [], "empty": []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(n):
            for name, arguments, call in (
                ("zendsp", ["tui", "--folder", folder], CALL),
                ("empty", [], EMPTY),
            ):
                begin = time.perf_counter()
                t = Terminal(arguments, call=call)
                try:
                    _wait(t, b"Reference", 0.002)
                    found[name].append(time.perf_counter() - begin)
                    cpu[name].append(t.cpu())
                finally:
                    t.close()
    ours, empty = (float(np.median(found[name])) for name in ("zendsp", "empty"))
    return {
        "median_s": ours,
        "largest_s": max(found["zendsp"]),
        "empty_textual_s": empty,
        "ratio": ours / empty,
        "cpu_s": float(np.median(cpu["zendsp"])),
        "empty_cpu_s": float(np.median(cpu["empty"])),
    }


def one_picture() -> dict[str, float]:
    """Compose and encode one picture of eight curves × 5 s at 1 kHz, 150 × 40 characters; ms."""
    from zendsp.tui.scope import Channel, ScopeSettings
    from zendsp.tui.scope.picture import compose
    from zendsp.tui.scope.raster import braille, envelope

    t = np.arange(5000) * 1e-3
    y = np.stack(
        [
            np.sin((k + 1) * t) + 0.1 * np.random.default_rng(k).normal(size=len(t))
            for k in range(8)
        ],
        axis=1,
    )
    channels = [Channel(f"c{k}", ("rad", "N m", "rad/s")[k % 3]) for k in range(8)]
    times = []
    for _ in range(60):
        begin = time.perf_counter()
        bands = envelope(t, y, 0.0, 5.0, 300)
        picture = compose(bands, channels, ScopeSettings(), (0.0, 5.0, 0.0), {}, (150, 40))
        _ = [braille(row) for row in picture.codes]
        times.append(1e3 * (time.perf_counter() - begin))
    return {"p50": float(np.percentile(times, 50)), "p95": float(np.percentile(times, 95))}


def key_to_applied(n: int = 30) -> dict[str, float]:
    """From the key that confirms an edit to the target's word that it acts, ms; and a bare write +
    wait beside it.
    """
    import asyncio

    from zendsp.link import local
    from zendsp.tui.app import ZendspApp
    from zendsp.tui.dialogs import Form
    from zendsp.tui.link_port import open_port
    from zendsp.tui.screens.console import ConsoleScreen

    async def run() -> dict[str, float]:
        target = local("imi_planar", timeout=60.0)
        target.download("pd.c")
        target.start()
        times, bare = [], []
        with tempfile.TemporaryDirectory() as folder:
            app = ZendspApp(open_port, target=target.name, folder=Path(folder))
            async with app.run_test(size=(160, 48)) as pilot:
                while not app.session.snapshot.variables or not app.session.channels:
                    await asyncio.sleep(0.05)
                screen = app.screen
                assert isinstance(screen, ConsoleScreen)
                screen.variables.table.mark("Kp1")
                for k in range(n):
                    await pilot.press("enter")
                    while not isinstance(app.screen, Form):
                        await asyncio.sleep(0.005)
                    app.screen.query_one("#f-value").value = str(1500 + k)  # type: ignore[attr-defined]
                    await asyncio.sleep(0.1)
                    screen.key_to_applied_s = float("nan")
                    begin = time.perf_counter()
                    app.simulate_key("enter")
                    while screen.key_to_applied_s != screen.key_to_applied_s:
                        await asyncio.sleep(0.0005)
                    times.append(1e3 * (time.perf_counter() - begin))
                    begin = time.perf_counter()
                    sequence = target.write(Kd1=100.0 + k)
                    target.request("wait_applied", sequence=sequence, timeout=2.0)
                    bare.append(1e3 * (time.perf_counter() - begin))
        target.close()
        return {
            "p50": float(np.percentile(times, 50)), "p95": float(np.percentile(times, 95)),
            "bare_p50": float(np.percentile(bare, 50)), "bare_p95": float(np.percentile(bare, 95)),
        }  # fmt: skip

    return asyncio.run(run())


def host_lost() -> dict[str, float]:
    """From kill −9 of the commanding host to the latched safe state, ms; the host is a process of
    its own.
    """
    from zendsp.link import local

    code = (
        "import sys, time\nfrom zendsp.link import connect\n"
        "t = connect(sys.argv[1]); t.power_on(); t.enable(); t.start()\n"
        "print('on', flush=True); time.sleep(600)\n"
    )
    times = []
    with local("imi_planar", timeout=60.0) as target:
        target.download("pd.c")
        for _ in range(3):
            host = subprocess.Popen(
                [sys.executable, "-c", code, target.name], stdout=subprocess.PIPE
            )
            assert host.stdout is not None
            host.stdout.readline()
            begin = time.perf_counter()
            host.kill()
            while target.status().trip is None:
                time.sleep(0.0005)
            times.append(1e3 * (time.perf_counter() - begin))
            host.wait()
            host.stdout.close()
            target.acknowledge()
            target.pause()
            target.release_command()
    return {"median": float(np.median(times)), "max": float(max(times))}


def terminal(seconds: float, soak: float, trace: Path | None = None) -> dict[str, float]:
    """CPU share, output and memory slope of ``zendsp tui`` with eight live curves."""
    with tempfile.TemporaryDirectory() as folder:
        t = Terminal(
            [
                "tui", "--local", "imi_planar", "--folder", folder, "--source", _source(),
                "--channels", CURVES,
            ]
        )
        try:
            _wait(t, b"imi_planar")
            # the drives stay automatic: with a commander, a busy machine that cuts this one off
            # would stop the program
            for key, event in (("b", "→ loaded"), ("s", "→ running")):
                _press(t, key, event.encode())
            time.sleep(3.0)
            cpu, written, begin = t.cpu(), t.bytes, time.perf_counter()
            time.sleep(seconds)
            wall = time.perf_counter() - begin
            result = {
                "cpu_share": (t.cpu() - cpu) / wall,
                "kB_per_s": (t.bytes - written) / wall / 1e3,
                "rss_MB": t.memory() / 1e3,
            }
            if soak > 0:
                result |= _soak(t, soak, trace)
        finally:
            t.close()
    return result


def _soak(t: Terminal, soak: float, trace: Path | None) -> dict[str, float]:
    times, sizes, output = [], [], []
    begin, written, cpu = time.monotonic(), t.bytes, t.cpu()
    while time.monotonic() - begin < soak:
        times.append(time.monotonic() - begin)
        sizes.append(t.memory())
        output.append(t.bytes - written)
        time.sleep(min(2.0, soak / 20.0))
    if trace is not None:
        np.savetxt(
            trace, np.stack([times, sizes, output], axis=1), delimiter=",",
            header="t [s],memory [kB],written [B]", comments="", fmt="%.10g",
        )
    lasted = time.monotonic() - begin
    x, y = np.array(times), np.array(sizes)
    half = x > soak / 3.0  # the first third is warming up: histories fill, caches find their size
    x, y = x[half], y[half]
    # sizes of one moment and the next are much alike: the error of the slope is that of the means
    # of ten blocks
    blocks = np.array_split(np.arange(len(x)), 10)
    (slope, _), error = np.polyfit(
        [x[i].mean() for i in blocks], [y[i].mean() for i in blocks], 1, cov=True
    )
    # it was not asleep
    busy = {
        "soak_kB_per_s": (t.bytes - written) / lasted / 1e3,
        "soak_cpu_share": (t.cpu() - cpu) / lasted,
    }
    return busy | {
        "soak_s": soak,
        "rss_first_MB": y[0] / 1e3,
        "rss_last_MB": y[-1] / 1e3,
        "slope_kB_per_h": float(slope * 3600.0),
        "slope_2sigma_kB_per_h": float(2.0 * np.sqrt(error[0, 0]) * 3600.0),
    }


def _wait(t: Terminal, words: bytes, step: float = 0.05) -> None:
    deadline = time.monotonic() + 60.0
    while words not in t.seen:
        if time.monotonic() > deadline:
            raise TimeoutError(f"{words!r} did not appear")
        time.sleep(step)


def _press(t: Terminal, key: str, words: bytes) -> None:
    """Press a key until it has had its effect: the target that is started here may not answer yet.
    """
    deadline = time.monotonic() + 60.0
    while words not in t.seen:
        if time.monotonic() > deadline:
            raise TimeoutError(f"{words!r} did not appear after {key!r}")
        t.keys(key)
        patience = time.monotonic() + 5.0
        while words not in t.seen and time.monotonic() < patience:
            time.sleep(0.05)


def _source() -> str:
    from importlib import resources

    return str(Path(str(resources.files("zendsp_isr"))) / "programs" / "pd.c")


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument(
        "--only",
        nargs="+",
        choices=("first", "picture", "key", "lost", "terminal"),
        help="leave out the others",
    )
    p.add_argument("--seconds", type=float, default=20.0)
    p.add_argument("--soak", type=float, default=300.0, help="s; 0 leaves it out")
    p.add_argument(
        "--trace", type=Path, help="CSV of the soak: memory and what was written, every two seconds"
    )
    p.add_argument("--json", action="store_true")
    args = p.parse_args()
    parts: dict[str, tuple[str, Callable[[], dict[str, float]]]] = {
        "first": ("first_picture", first_picture),
        "picture": ("picture_ms", one_picture),
        "key": ("key_to_applied_ms", key_to_applied),
        "lost": ("host_lost_ms", host_lost),
        "terminal": ("terminal", lambda: terminal(args.seconds, args.soak, args.trace)),
    }
    result: dict[str, dict[str, float] | float] = {
        name: measure()
        for part, (name, measure) in parts.items()
        if args.only is None or part in args.only
    }
    result["load"] = os.getloadavg()[0]
    if args.json:
        print(json.dumps(result, indent=1))
        return
    for name, values in result.items():
        shown = (
            ", ".join(f"{k} {v:.4g}" for k, v in values.items())
            if isinstance(values, dict)
            else f"{values:.1f}"
        )
        print(f"{name:20} {shown}")


if __name__ == "__main__":
    main()
