"""The same arms given as URDF, as MJCF and as FMU: what are they told?

    python benchmarks/forms.py FOLDER              # makes what is not there, and asks
    python benchmarks/forms.py FOLDER --group bodies --form urdf --seed 1
    python benchmarks/forms.py FOLDER --only payload2,coulomb6 --form fmu --fmi 3

Groups of arms of two to seven joints: ``forms``, 26 that lack this or that; ``bodies``, 31 with a
payload, a wrong link, rotor or base, or a balancer that the file has not; ``rough``, 18 of these
with a friction that is no straight line, where the line through it is given. They are simulated by
Pinocchio with a dry friction that is neither that of zendsp nor of MuJoCo; the FMU is C by hand.
Right is a report that names all that acts, each by a finding of its own, by its name or among what
it cannot be told from, and nothing else. Of several causes each has to be named. Each answer is
kept in FOLDER, so an interrupted run goes on; then prints the tables. About 20 s of one core to
make an arm, 10 to 60 s an answer. Needs gcc, ``pip install 'zendsp[mujoco,fmpy]' pin``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from arms.told import is_right, is_true, kind, numbers_off


class Row(NamedTuple):
    """An answer: verdict, findings in their order, whether they are right, how many of them are
    not what acts, how far a payload's numbers are off (``numbers_off``), seconds.
    """

    arm: str
    form: str
    verdict: str
    said: str
    right: bool
    beyond: int
    off: tuple[float, float, float, float] | None
    cpu: float


def main() -> None:
    """Make, ask, and print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=_AsItIs)
    options.add_argument("folder", type=Path)
    options.add_argument("--group", choices=("forms", "bodies", "rough"), default="forms")
    options.add_argument("--only", default="", help="names of arms, parted by commas")
    options.add_argument("--form", choices=("urdf", "mjcf", "fmu"), action="append")
    options.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="of the FMU")
    options.add_argument("--seed", type=int, default=0, help="of other arms with the same truths")
    asked = options.parse_args()
    try:  # behind the options: --help needs none of the packages that make an arm
        from arms.cases import GROUPS, make
    except ModuleNotFoundError as lacks:
        what = f"{lacks.name} is missing: pip install 'zendsp[mujoco,fmpy]' pin"
        raise SystemExit(what) from lacks
    names = [n for n in GROUPS[asked.group] if not asked.only or n in asked.only.split(",")]
    forms = [
        "fmu3" if form == "fmu" and asked.fmi == 3 else form
        for form in asked.form or ("urdf", "mjcf", "fmu")
    ]
    rows = []
    for name in names:
        folder = asked.folder / f"{name}-{asked.seed}"
        if not (folder / "truth.json").exists():
            print(make(name, folder, asked.seed), file=sys.stderr, flush=True)
        truth = json.loads((folder / "truth.json").read_text())
        for form in forms:
            rows.append(told(name, form, answered(folder, form), truth))
            print("  ".join(map(str, rows[-1])), file=sys.stderr, flush=True)
    print("| arm | given as | verdict | findings, confidence | right | beyond the truth | CPU, s |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        cells = (*row[:4], "yes" if row.right else "no", row.beyond, row.cpu)
        print("| " + " | ".join(map(str, cells)) + " |")
    for form in forms:
        print_rates(form, [row for row in rows if row.form == form])


class _AsItIs(argparse.RawDescriptionHelpFormatter):
    pass


def print_rates(form: str, rows: list[Row]) -> None:
    """The rate of one form, by class of what is concealed."""
    cpu = [row.cpu for row in rows]
    print(
        f"\n{form}: {sum(row.right for row in rows)} of {len(rows)} right,"
        f" {sum(row.beyond for row in rows)} names beyond the truth; {np.median(cpu):.0f} s of CPU,"
        f" at most {max(cpu):.0f}"
    )
    print("\n| | right | beyond | mass off, %; in ± | centre off, mm; in ± |")
    print("|---|---|---|---|---|")
    for one in dict.fromkeys(kind(row.arm) for row in rows):
        of = [row for row in rows if kind(row.arm) == one]
        off = np.abs([row.off for row in of if row.off is not None]).reshape(-1, 4)
        cells = [f"{sum(row.right for row in of)} of {len(of)}", sum(row.beyond for row in of)]
        for at in (0, 2) if len(off) else ():
            value, by = off[:, at], off[:, at + 1]
            cells.append(
                f"{np.median(value):.1f}, at most {value.max():.1f};"
                f" {np.median(by):.1f}, at most {by.max():.1f}"
            )
        print("| " + " | ".join(map(str, [one, *cells, *[""] * (4 - len(cells))])) + " |")


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


def told(name: str, form: str, report: dict[str, Any], truth: dict[str, Any]) -> Row:
    """What a report says, and whether it is right."""
    findings, acts, also = report["findings"], truth["truth"], truth.get("also", ())
    said = ", ".join(f"{f['effect']}@{f['joint']} {f['confidence']:.2f}" for f in findings) or "–"
    beyond = sum(not is_true(f, acts) and f["mechanism"] not in also for f in findings)
    off = numbers_off(report, acts, truth["numbers"])
    right = is_right(report, acts, also)
    return Row(name, form, report["verdict"], said, right, beyond, off, report["cpu"])


if __name__ == "__main__":
    main()
