"""The same arms given as URDF, as MJCF and as FMU: are they told the same?

    python benchmarks/forms.py FOLDER              # makes what is not there, and asks
    python benchmarks/forms.py FOLDER --only payload2,coulomb6 --form fmu

26 arms of two to seven joints, simulated by Pinocchio with a dry friction that is neither that of
zendsp nor of MuJoCo; the FMU is C by hand. Each answer is kept in FOLDER, so an interrupted run
goes on; then prints the table. About 25 s of one core an answer. Needs gcc, ``pip install
'zendsp[mujoco,fmpy]' pin``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

from arms.cases import CASES, make
from arms.written import FORMS

BODIES = ("payload", "body", "inertia")


def main() -> None:
    """Make, ask, and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=_AsItIs)
    options.add_argument("folder", type=Path)
    options.add_argument("--only", default="", help="names of arms, parted by commas")
    options.add_argument("--form", choices=FORMS, action="append")
    asked = options.parse_args()
    names = [n for n in CASES if not asked.only or n in asked.only.split(",")]
    for name in names:
        if not (asked.folder / name / "truth.json").exists():
            print(make(name, asked.folder / name), file=sys.stderr, flush=True)
    rows = []
    for name in names:
        for form in asked.form or FORMS:
            answer = answered(asked.folder / name, form)
            row = [name, form, *told(answer, json.loads((asked.folder / name / "truth.json").read_text()))]
            rows.append(row)
            print("  ".join(str(x) for x in row), file=sys.stderr, flush=True)
    print_table(rows)


class _AsItIs(argparse.RawDescriptionHelpFormatter):
    pass


def answered(folder: Path, form: str) -> dict[str, Any]:
    """The report of a diagnosis, with the seconds of CPU that it took."""
    kept = folder / f"{form}.json"
    if not kept.exists():
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(
            [Path(sys.executable).with_name("zendsp"), "diagnose", folder / "fit.npz", "--heldout",
             folder / "heldout.npz", "--model", folder / f"{form}.toml", "--json", "--no-figures",
             "--jobs", "1"],
            capture_output=True, text=True, check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        report = {"verdict": "none", "findings": [], "unexplained": done.stderr.strip()[-300:]}
        if not done.returncode:
            report = json.loads(done.stdout)
        used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        kept.write_text(json.dumps({**report, "cpu": round(used, 1)}, indent=1))
    return json.loads(kept.read_text())  # type: ignore[no-any-return]


def told(report: dict[str, Any], truth: list[str]) -> list[Any]:
    """Verdict, findings in their order, and what is wrong with them."""
    found = [f"{f['effect']}@{f['joint']}" for f in report["findings"]]
    said = ", ".join(
        f"{name} {f['confidence']:.2f}" for name, f in zip(found, report["findings"], strict=True)
    )
    return [report["verdict"], said or "-", ",".join(truth) or "complete", report["cpu"]]


def print_table(rows: list[list[Any]]) -> None:
    """The rows as Markdown."""
    for row in rows:
        print("| " + " | ".join(str(x) for x in row) + " |")


if __name__ == "__main__":
    main()
