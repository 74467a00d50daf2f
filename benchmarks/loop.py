"""The loop, measured: lateness, Acquire() cost, a wide and fast recording. Prints ratios of things
measured side by side.

    python benchmarks/loop.py [--seconds 4] [--json]

The reference for lateness is cyclictest where it is installed, at the same rate, priority and CPU;
and always a bare loop of ``clock_nanosleep`` to absolute times, compiled here, which is what
cyclictest does. Runs alternate, so that a busy neighbour disturbs both. Goal: no later than the
reference at p99 and p99.9.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_isr.compiler import find_compiler
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime, program_text

PRIORITY = 80
EMPTY = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
WIDE = (
    '#include "isr.h"\nstatic double wide[1024];\nvoid UserInit(void) { SIGNAL(wide, "", ""); }\n'
    "void UserISR_INT2(void) { wide[0] = (double)SAMPLE_TICK; wide[127] = -wide[0]; }\n"
)
BARE = r"""
#define _GNU_SOURCE
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
static uint64_t now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec; }
int main(int count, char **words) {
    const uint64_t period = strtoull(words[1], 0, 10), samples = strtoull(words[2], 0, 10);
    const struct sched_param priority = {.sched_priority = atoi(words[3])};
    cpu_set_t one; CPU_ZERO(&one); CPU_SET((size_t)atoi(words[4]), &one);
    (void)count;
    sched_setscheduler(0, SCHED_FIFO, &priority); sched_setaffinity(0, sizeof one, &one);
    mlockall(MCL_CURRENT | MCL_FUTURE); prctl(PR_SET_TIMERSLACK, 1ul);
    uint64_t *late = calloc(samples, sizeof *late), next = now() + period;
    for (uint64_t i = 0; i < samples; i++, next += period) {
        const struct timespec t = {.tv_sec = (time_t)(next / 1000000000u), .tv_nsec = (long)(next % 1000000000u)};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, 0);
        late[i] = now() - next;
    }
    fwrite(late, sizeof *late, samples, stdout);
    return 0;
}
"""  # noqa: E501

Array = npt.NDArray[np.float64]


def percentiles(late_us: Array) -> dict[str, float]:
    """p50, p99, p99.9 and the largest, µs."""
    p50, p99, p999 = np.percentile(late_us, [50, 99, 99.9])
    return {
        "p50": float(p50),
        "p99": float(p99),
        "p99.9": float(p999),
        "max": float(np.max(late_us)),
    }


def our_lateness(rate: float, seconds: float, spin_us: float) -> tuple[Array, str, int]:
    """Lateness of every sample of the zendsp loop, µs; how it was scheduled; and the CPU that it
    took (-1: none).
    """
    with Runtime(
        "imi_planar", rate_hz=rate, clock="real", priority=PRIORITY, spin_us=spin_us
    ) as runtime:
        runtime.load(runtime.compile({"user.c": EMPTY}).key)
        runtime.acquire_configure(0, AcquireConfig(("late_us",), seconds=seconds))
        runtime.acquire_start(0)
        runtime.start(ticks=int(seconds * rate))
        runtime.wait_paused(seconds + 30.0)
        scheduling = runtime.status().scheduling
        words = scheduling.split("on CPU ")
        cpu = int(words[1].split(",")[0]) if len(words) > 1 else -1
        return runtime.acquire_read(0, 0, int(seconds * rate))[:, 0], scheduling, cpu


def bare_lateness(program: Path, rate: float, seconds: float, cpu: int) -> Array:
    """Lateness of the bare loop, µs."""
    command = [
        str(program),
        str(round(1e9 / rate)),
        str(int(seconds * rate)),
        str(PRIORITY),
        str(max(0, cpu)),
    ]
    done = subprocess.run(command, capture_output=True, check=True)
    return np.frombuffer(done.stdout, dtype=np.uint64).astype(np.float64) / 1e3


def cyclictest_lateness(rate: float, seconds: float, cpu: int) -> Array | None:
    """Latency as cyclictest sees it, µs (its resolution: whole microseconds); None where it is not
    installed.
    """
    tool = shutil.which("cyclictest")
    if tool is None:
        return None
    command = [
        tool,
        "-q",
        "-m",
        "-p",
        str(PRIORITY),
        "-i",
        str(round(1e6 / rate)),
        "-l",
        str(int(seconds * rate)),
        "-h",
        "20000",
        "-t",
        "1",
    ]
    command += ["-a", str(cpu)] if cpu >= 0 else []
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    pairs = [line.split()[:2] for line in done.stdout.splitlines() if line[:1].isdigit()]
    return np.repeat([float(us) for us, _ in pairs], [int(n) for _, n in pairs])


def compile_bare(folder: Path) -> Path:
    """Compile the bare loop."""
    (folder / "bare.c").write_text(BARE)
    subprocess.run(
        [*find_compiler().command, "-O2", str(folder / "bare.c"), "-o", str(folder / "bare")],
        check=True,
    )
    return folder / "bare"


def lateness(seconds: float, rounds: int = 3) -> dict[str, Any]:
    """Both loops in turn, at 1, 10 and 20 kHz; with our spin, and without it."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        bare = compile_bare(Path(name))
        for rate in (1000.0, 10_000.0, 20_000.0):
            runs: dict[str, list[Array]] = {
                "zendsp": [], "zendsp, no spin": [], "bare": [], "cyclictest": [],
            }
            for _ in range(rounds):
                ours, scheduling, cpu = our_lateness(rate, seconds / rounds, 60.0)
                runs["zendsp"].append(ours)
                runs["bare"].append(bare_lateness(bare, rate, seconds / rounds, cpu))
                runs["zendsp, no spin"].append(our_lateness(rate, seconds / rounds, 0.0)[0])
                cyclic = cyclictest_lateness(rate, seconds / rounds, cpu)
                if cyclic is not None:
                    runs["cyclictest"].append(cyclic)
            found[f"{rate / 1000:g} kHz"] = {
                who: percentiles(np.concatenate(all_)) for who, all_ in runs.items() if all_
            }
            found["scheduling"] = scheduling
    return found


def cpu_ns(pid: int) -> int:
    """Time that the loop's thread has spent on a CPU, ns: what a busy neighbour takes does not
    count.
    """
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0])


def acquire_cost(ticks: int = 100_000) -> dict[str, float]:
    """Cost of one channel in one sample, ns: fast clock with many channels against the same loop
    without.
    """
    with Runtime("imi_planar", clock="fast", machine_config={"substep": 1.0}) as runtime:
        runtime.load(runtime.compile({"user.c": WIDE}).key)

        def run(channels: int) -> float:
            if channels:
                names = tuple(f"wide[{i}]" for i in range(channels))
                runtime.acquire_configure(0, AcquireConfig(names, seconds=1.0, continuous=True))
                runtime.acquire_start(0)
            elif runtime.acquire_status(0).state == "running":
                runtime.acquire_stop(0)
                runtime.start(ticks=1)
                runtime.wait_paused()
            best = np.inf
            for _ in range(5):
                before = cpu_ns(runtime.runner_pid())
                runtime.start(ticks=ticks)
                runtime.wait_paused()
                best = min(best, cpu_ns(runtime.runner_pid()) - before)
            return best / ticks

        without, with_1, with_128, with_1024 = run(0), run(1), run(128), run(1024)
        return {
            "sample without acquisition": without,
            "Acquire() with 1 channel": with_1 - without,
            "a channel of 128": (with_128 - without) / 128,
            "a channel of 1024": (with_1024 - without) / 1024,
        }


def wide_recording(seconds: float) -> dict[str, float]:
    """20 kHz × 128 float64, read in pieces while it runs, to a file; lost rows."""
    rate, channels = 20_000.0, 128
    with (
        Runtime("imi_planar", rate_hz=rate, clock="real", priority=PRIORITY) as runtime,
        tempfile.TemporaryFile() as file,
    ):
        runtime.load(runtime.compile({"user.c": WIDE}).key)
        names = tuple(f"wide[{i}]" for i in range(channels))
        runtime.acquire_configure(0, AcquireConfig(names, seconds=1.0, continuous=True))
        runtime.acquire_start(0)
        cpu, began = time.process_time(), time.perf_counter()
        runtime.start(ticks=int(seconds * rate))
        row, broken = 0, 0
        while row < int(seconds * rate):
            piece = runtime.acquire_read(0, row, 8192)
            broken += int(np.any(piece[:, 0] != np.arange(row, row + len(piece))))
            file.write(piece.data)
            row += len(piece)
            if len(piece) < 2048:
                time.sleep(0.02)
        busy, took = time.process_time() - cpu, time.perf_counter() - began
        status, timing = runtime.acquire_status(0), runtime.status().timing
        return {
            "rows": row,
            "lost": status.lost,
            "pieces out of order": broken,
            "MB/s": row * channels * 8 / took / 1e6,
            "share of a core": busy / took,
            "overruns": timing.overruns,
            "loop exec mean us": timing.exec_mean_ns / 1e3,
        }


def edit_to_running() -> dict[str, float]:
    """From changed source to the first sample, s."""
    with Runtime("imi_planar", clock="real") as runtime:
        times = []
        for _ in range(5):
            source = program_text("pd") + f"\n/* {time.time_ns()} */\n"
            began = time.perf_counter()
            runtime.load(runtime.compile({"pd.c": source}).key)
            runtime.start()
            times.append(time.perf_counter() - began)
        return {"median": float(np.median(times)), "largest": max(times)}


def update_cost() -> dict[str, float]:
    """Python's side of a synchronous update, and of reading, µs a call; 64 variables."""
    code = (
        '#include "isr.h"\n'
        + "".join(f"static double p{i};\n" for i in range(64))
        + "void UserInit(void) {\n"
    )
    code += (
        "".join(f'PARAMETER(p{i}, 0.0, "", NO_MIN, NO_MAX, "");\n' for i in range(64))
        + "}\nvoid UserISR_INT2(void) {}\n"
    )
    with Runtime("imi_planar", clock="fast") as runtime:
        runtime.load(runtime.compile({"user.c": code}).key)
        runtime.start()
        names = [f"p{i}" for i in range(64)]

        def each(call: Any, count: int = 500) -> float:
            times = []
            for _ in range(count):
                began = time.perf_counter()
                call()
                times.append(time.perf_counter() - began)
            return 1e6 * float(np.median(times))

        return {
            "read 1": each(lambda: runtime.read(["p0"])),
            "read 64": each(lambda: runtime.read(names)),
            "write 1 and wait": each(
                lambda: runtime.wait_applied(runtime.write({"p0": 1.0}, "b"), 5.0)
            ),
            "write 64 and wait": each(
                lambda: runtime.wait_applied(runtime.write(dict.fromkeys(names, 2.0), "b"), 5.0)
            ),
        }


def report(found: dict[str, Any]) -> None:
    """Print it for people."""
    print(
        f"scheduling: {found['lateness'].pop('scheduling')}\n"
        "\n"
        "lateness at the start of a sample, us"
    )
    print(f"{'':22}{'p50':>10}{'p99':>10}{'p99.9':>10}{'max':>10}")
    for rate, runs in found["lateness"].items():
        for who, p in runs.items():
            print(f"{rate:>7} {who:14}" + "".join(f"{value:10.2f}" for value in p.values()))
        for reference in ("bare", "cyclictest"):
            if reference in runs:
                ratios = {
                    q: runs["zendsp"][q] / max(runs[reference][q], 1e-9) for q in ("p99", "p99.9")
                }
                print(
                    f"{rate:>7} zendsp / {reference}: p99 {ratios['p99']:.3g}, p99.9"
                    f" {ratios['p99.9']:.3g} (goal: at most 1)"
                )
    if "cyclictest" not in found["lateness"]["1 kHz"]:
        print("cyclictest is not installed: the bare loop stands in for it")
    for title in ("acquire, ns", "20 kHz x 128", "edit to running, s", "updates, us"):
        print(f"\n{title}")
        for name, value in found[title].items():
            print(f"  {name:28}{value:12.4g}")


def main() -> None:
    """Measure everything and print it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds", type=float, default=4.0, help="of each lateness run and of the recording"
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found = {
        "lateness": lateness(arguments.seconds), "acquire, ns": acquire_cost(),
        "20 kHz x 128": wide_recording(arguments.seconds), "edit to running, s": edit_to_running(),
        "updates, us": update_cost(),
    }
    if arguments.json:
        print(json.dumps(found))
    else:
        report(found)


if __name__ == "__main__":
    main()
