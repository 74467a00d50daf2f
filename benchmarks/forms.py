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

import numpy as np
from arms.cases import CASES, make
from arms.written import FORMS


def main() -> None:
    """Make, ask, and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=_AsItIs)
    options.add_argument("folder", type=Path)
    options.add_argument("--only", default="", help="names of arms, parted by commas")
    options.add_argument("--form", choices=FORMS, action="append")
    options.add_argument("--seed", type=int, default=0, help="of other arms with the same truths")
    asked = options.parse_args()
    names = [n for n in CASES if not asked.only or n in asked.only.split(",")]
    for name in names:
        if not (asked.folder / name / "truth.json").exists():
            print(make(name, asked.folder / name, asked.seed), file=sys.stderr, flush=True)
    rows = []
    for name in names:
        truth = json.loads((asked.folder / name / "truth.json").read_text())
        for form in asked.form or FORMS:
            rows.append([name, form, *told(answered(asked.folder / name, form), truth)])
            print("  ".join(map(str, rows[-1])), file=sys.stderr, flush=True)
    print("| arm | given as | verdict | findings, confidence | right | beyond the truth | CPU, s |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")
    for form in asked.form or FORMS:
        _, _, _, _, right, beyond, cpu = zip(*(r for r in rows if r[1] == form), strict=True)
        print(
            f"\n{form}: {right.count('yes')} of {len(right)} right, {sum(beyond)} names beyond the"
            f" truth; {np.median(cpu):.0f} s of CPU, at most {max(cpu):.0f}"
        )


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
    """Verdict, findings in their order, whether they are what acts, how many of them are not, and
    seconds.
    """
    findings = report["findings"]
    names = [f"{f['effect']}@{f['joint']}" for f in findings]
    said = [f"{n} {f['confidence']:.2f}" for n, f in zip(names, findings, strict=True)]
    beyond = sum(not _is_true(f, truth) for f in findings)
    right = "yes" if _is_told(report, truth) else "no"
    return [report["verdict"], ", ".join(said) or "–", right, beyond, report["cpu"]]


def _is_told(report: dict[str, Any], truth: list[str]) -> bool:
    """Whether all that acts is named. Of a torque of no law it is enough that something is missing,
    of a body inside an FMU that it says so.
    """
    findings = report["findings"]
    if "foreign" in truth or not truth:
        return bool(truth) == (report["verdict"] != "complete")
    body = truth[0].startswith("payload") and not findings
    if body and "a wrong body inside" in report["unexplained"]:
        return True
    return all(any(_is_true(f, [one]) for f in findings) for one in truth)


def _is_true(finding: dict[str, Any], truth: list[str]) -> bool:
    """Whether a finding, or what it cannot be told from, is what acts; beside a torque of no law,
    one without a law.
    """
    if "foreign" in truth:
        return str(finding["effect"]) == "unknown"
    names = [finding["effect"], *finding["indistinguishable"]]
    return any(f"{name}@{finding['joint']}" in truth for name in names)


if __name__ == "__main__":
    main()
