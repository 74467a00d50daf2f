"""How long a diagnosis takes: one joint, six and seven, complete and concealed, and whether time
grows linearly with the recording.

    python benchmarks/diagnosis_time.py [--jobs 2] [--only joints=7] [--json FILE]
    python benchmarks/diagnosis_time.py --jobs 1 --cases FOLDER

Wall time and CPU time of the command ``zendsp diagnose``, start of the interpreter included, on
cases made here by the proof's own simulator (those of six joints by MuJoCo), or on those that
``zendsp prove --make`` wrote. Goals: 20 s at 1 kHz of one joint in 5 s, 60 s of seven joints in
60 s, on two cores with nothing else to do; 30 s at 500 Hz of six joints in 30 s, as MJCF in 45 s.

Units: CPU time over that of a plain loop of C (``LOOP``), which runs right before and after each
diagnosis. It changes less than seconds do with the machine and its load.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import statistics
import subprocess
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from zendsp.physics.kernel.native import build
from zendsp.proof.build_case import Request
from zendsp.proof.cases import write_all
from zendsp.proof.children import command, environment
from zendsp.proof.machines import MACHINES
from zendsp.proof.mujoco.machines import MACHINES as MUJOCO_MACHINES

# s, of so many joints and seconds
GOALS = {(1, 20.0, ""): 5.0, (7, 60.0, ""): 60.0, (6, 30.0, ""): 30.0, (6, 30.0, "mjcf"): 45.0}
PAYLOAD = Request(700_009, "single", "mj_arm6", "payload", 1.0, "mujoco")
CASES = (  # joints, seconds of each recording, what is concealed, case
    (1, 20.0, "nothing", Request(700_001, "complete", "rotary")),
    (1, 20.0, "Stribeck", Request(700_002, "single", "rotary", "stribeck", 0.3)),
    (1, 20.0, "hysteresis", Request(700_003, "single", "rotary", "hysteresis", 0.3)),
    (1, 20.0, "backlash", Request(700_004, "single", "rotary", "backlash", 0.3)),
    (1, 20.0, "Coulomb and delay", Request(700_005, "pair", "rotary", "coulomb+delay")),
    (1, 20.0, "foreign", Request(700_006, "foreign", "rotary", "sinqv", 0.1)),
    (1, 40.0, "Stribeck", Request(700_002, "single", "rotary", "stribeck", 0.3)),
    (1, 80.0, "Stribeck", Request(700_002, "single", "rotary", "stribeck", 0.3)),
    (6, 30.0, "payload", PAYLOAD),
    (6, 30.0, "payload, MJCF", replace(PAYLOAD, given="mjcf")),
    (7, 20.0, "Coulomb", Request(700_007, "single", "urdf", "coulomb", 0.3)),
    (7, 40.0, "Coulomb", Request(700_007, "single", "urdf", "coulomb", 0.3)),
    (7, 60.0, "Coulomb", Request(700_007, "single", "urdf", "coulomb", 0.3)),
    (7, 60.0, "nothing", Request(700_008, "complete", "urdf")),
)


# the unit of CPU time: eight joints with viscous and Coulomb friction, pushed to and fro. As many
# as the kernel takes at once: other work on the same core slows both
LOOP = """
double loop(long steps) {
    double q[8] = {0}, v[8] = {0}, sum = 0.0;
    for (long k = 0; k < steps; k++) {
        const double u = (k >> 9) & 1 ? 1.0 : -1.0;
        for (int j = 0; j < 8; j++) {
            v[j] += 1e-3 * (u - 0.1 * (j + 1) * v[j] - (v[j] > 0.0 ? 0.3 : -0.3));
            q[j] += 1e-3 * v[j];
        }
    }
    for (int j = 0; j < 8; j++) sum += q[j];
    return sum;
}
"""
STEPS = 10_000_000
LOOPS = 5  # before a diagnosis, and after it


@dataclass(frozen=True)
class Took:
    """What a diagnosis says, its time, and the unit: the CPU time of the loop beside it."""

    said: str
    wall_s: float
    cpu_s: float
    unit_s: float

    @property
    def units(self) -> float:
        """CPU time in units."""
        return self.cpu_s / self.unit_s


@dataclass(frozen=True)
class Row:
    """One diagnosis; a recording for the fit and one held out, each of so many seconds."""

    joints: int
    recorded_s: float
    concealed: str
    said: str
    wall_s: float
    cpu_s: float
    unit_s: float
    goal_s: float | None


def make(request: Request, seconds: float, folder: Path) -> Path:
    """The case of a request with recordings of that length."""
    own = request.reality == "own"
    machines: dict[str, Any] = MACHINES if own else MUJOCO_MACHINES
    make_machine = machines[request.machine]

    def longer(rng: np.random.Generator) -> Any:
        draft = make_machine(rng)
        draft.seconds, draft.sample_time = seconds, 1e-3 if own else 2e-3
        if own:
            draft.layout = "heldout"
        return draft

    machines[request.machine] = longer
    try:
        write_all([request], folder / "cases", folder / "truth", jobs=1)
    finally:
        machines[request.machine] = make_machine
    return folder / "cases" / "case_0001"


def loops() -> list[float]:
    """CPU seconds of the plain loop, a few times."""
    loop = ctypes.CDLL(str(build(LOOP, ("-O2", "-shared", "-fPIC")))).loop
    loop.restype, loop.argtypes = ctypes.c_double, [ctypes.c_long]
    took = []
    for _ in range(LOOPS):
        begin = time.process_time()
        loop(STEPS)
        took.append(time.process_time() - begin)
    return took


def diagnose(case: Path, jobs: int) -> Took:
    """What the command says, wall and CPU seconds, and the unit right before and after it."""
    listing = json.loads((case / "case.json").read_text(encoding="utf-8"))
    line = [
        *command("diagnose"), *(str(case / n) for n in listing["train"]), "--model",
        str(case / listing["model"]),
    ]
    for name in listing["heldout"]:
        line += ["--heldout", str(case / name)]
    earlier = loops()
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [*line, "--json", "--jobs", str(jobs)], env=environment(), capture_output=True, text=True,
        check=False,
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    unit = statistics.median(earlier + loops())
    if done.returncode:
        return Took(done.stderr.strip().splitlines()[-1][:40], wall, 0.0, unit)
    report = json.loads(done.stdout)
    named = ", ".join(f"{f['effect']}@{f['joint']}" for f in report["findings"])
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Took(named or report["verdict"], wall, cpu, unit)


@click.command(help=__doc__.splitlines()[0] if __doc__ else "")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option("--only", default="", help="joints=1, joints=6 or joints=7.")
@click.option(
    "--json", "out", type=click.Path(path_type=Path), default=None,
    help="Also write the rows there.",
)
@click.option(
    "--cases", type=click.Path(path_type=Path, exists=True), default=None,
    help="The folder 'cases' of zendsp prove --make: those instead.",
)
def main(jobs: int, only: str, out: Path | None, cases: Path | None) -> None:
    """Measure and print."""
    rows: list[Row] = []
    click.echo(f"load {os.getloadavg()[0]:.1f}, {jobs} jobs")
    if cases is not None:
        for case in sorted(cases.glob("case_*")):
            took = diagnose(case, jobs)
            click.echo(
                f"{case.name:20}{took.wall_s:8.1f}{took.cpu_s:8.1f}{took.units:8.0f}  {took.said}"
            )
        return
    click.echo(
        f"{'joints':>6}{'each s':>8}  {'concealed':20}{'wall s':>8}{'CPU s':>8}{'units':>8}"
        f"  {'goal':8}said"
    )
    for joints, seconds, concealed, request in CASES:
        if only and only != f"joints={joints}":
            continue
        with tempfile.TemporaryDirectory() as folder:
            took = diagnose(make(request, seconds, Path(folder)), jobs)
        goal = GOALS.get((joints, seconds, request.given))
        rows.append(
            Row(
                joints, seconds, concealed, took.said, took.wall_s, took.cpu_s, took.unit_s, goal
            )
        )
        met = "" if goal is None else f"{goal:g} {'met' if took.wall_s <= goal else 'NOT'}"
        click.echo(
            f"{joints:6}{seconds:8g}  {concealed:20}{took.wall_s:8.1f}{took.cpu_s:8.1f}"
            f"{took.units:8.0f}  {met:8}{took.said}"
        )
    if out:
        out.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
