"""Do the experiments' uncertainties hold? Each is repeated on copies of its machine, with other
noise, other places of uneven friction and other start positions; how often do the 95 % intervals
hold what the machine really has?

    python benchmarks/experiments.py --keep runs.json --page docs/measurements/experiments.md
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from zendsp.experiment import Lab, Result
from zendsp.experiment.imi_breakaway import static
from zendsp.experiment.imi_friction import viscous
from zendsp.experiment.lab import Bench
from zendsp.experiment.pendulum_motor import electrical, mechanical
from zendsp.experiment.truth import TRUTH
from zendsp.experiment.wam_friction import friction
from zendsp.recording import Recording

WAM_JOINTS = (4,)
PLACES = 4
# the longest integration step, s: twice that of the machine, for time
SUBSTEP = {"imi_planar": 2e-4, "wam7": 1e-4}
EXPERIMENTS: dict[str, tuple[str, Callable[[Lab], Result]]] = {
    "imi-static": (f"{PLACES} places a direction", lambda lab: static(lab, PLACES)),
    "imi-viscous": ("", viscous),
    "pendulum-electrical": ("", electrical),
    "pendulum-mechanical": ("", mechanical),
    "wam-friction": (
        f"joint {', '.join(map(str, WAM_JOINTS))}",
        lambda lab: friction(lab, joints=WAM_JOINTS, narrow=False),
    ),
}


class Quick(Lab):
    """A lab whose machines integrate with longer steps."""

    @contextmanager
    def bench(self, machine: str | None, name: str, **options: Any) -> Iterator[Bench]:
        if machine in SUBSTEP:
            options["substep"] = SUBSTEP[machine]
        with super().bench(machine, name, **options) as bench:
            yield bench


def keep_nothing() -> None:
    """Draw no figure and write no recording: they cost more than what is counted here."""
    Figure.savefig = lambda *a, **k: None  # type: ignore[method-assign]
    Recording.save = lambda self, path: Path(path)  # type: ignore[method-assign]


def repeat(
    name: str, kept: dict[str, list[Any]], seeds: int, until: float, keep: Path | None = None
) -> None:
    """Add repetitions to those that are kept, until there are so many or the time is over: value
    and standard deviation of every number whose truth is known. Each is kept at once.
    """
    rows = kept.setdefault(name, [])
    while len(rows) < seeds and time.monotonic() < until:
        with tempfile.TemporaryDirectory() as folder:
            result = EXPERIMENTS[name][1](Quick(folder, seed=len(rows) + 1))
        found = result.values
        rows.append(
            {key: (found[key].value, found[key].std) for key in TRUTH[name] if key in found}
        )
        if keep:
            part = keep.with_name(keep.name + ".part")
            part.write_text(json.dumps(kept))
            part.replace(keep)  # a run that is killed leaves all that was done


def section(name: str, rows: list[Any]) -> str:
    """What the repetitions of one experiment say."""
    lines = [
        "| quantity | machine | mean | spread | stated | off, in stated | intervals that hold it |",
        "|---|---|---|---|---|---|---|",
    ]
    held, count = 0, 0
    for key in rows[0]:
        value, std = np.array([row[key] for row in rows]).T
        truth = TRUTH[name][key]
        inside = np.abs(value - truth) <= 1.96 * std
        held, count = held + int(inside.sum()), count + len(inside)
        lines.append(
            f"| {key.replace('_', ' ')} | {truth:.4g} | {value.mean():.4g} |"
            f" {value.std(ddof=1):.2g} | {std.mean():.2g} |"
            f" {(value.mean() - truth) / std.mean():+.2f} | {100 * inside.mean():.1f} % |"
        )
    note = f" ({EXPERIMENTS[name][0]})" if EXPERIMENTS[name][0] else ""
    return (
        f"## {name}{note}\n"
        "\n"
        f"{len(rows)} repetitions: {100 * held / count:.1f} % of {count} intervals hold.\n"
        "\n" + "\n".join(lines) + "\n"
    )


HEAD = """# Do the intervals of the experiments hold?

{day}. `python benchmarks/experiments.py`: every experiment repeated on copies of its simulated
machine, with other noise, other places of uneven friction and other start positions. *Spread* is
that of the values found, *stated* the mean of the standard deviations that the experiment gave;
the last column counts how many of its 95 % intervals hold what the machine has. Where the spread is
far below what is stated, the law that is fitted is not quite the machine's: the error is the same
in every copy, and its interval holds the truth each time, or never.
"""


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--seeds", type=int, default=200, help="repetitions of each")
    p.add_argument("--only", default="", help="one experiment")
    p.add_argument("--minutes", type=float, default=float("inf"), help="stop after so many")
    p.add_argument("--keep", type=Path, help="go on from this file, and keep the repetitions there")
    p.add_argument("--page", type=Path, help="write the tables there (Markdown)")
    args = p.parse_args()
    keep_nothing()
    until = time.monotonic() + 60 * args.minutes
    kept = json.loads(args.keep.read_text()) if args.keep and args.keep.exists() else {}
    for name in [args.only] if args.only else EXPERIMENTS:
        repeat(name, kept, args.seeds, until, args.keep)
    tables = [section(name, kept[name]) for name in EXPERIMENTS if len(kept.get(name, [])) > 1]
    print("\n".join(tables))
    if args.page:
        day = f"{date.today():%-d %B %Y}"
        args.page.write_text("\n".join([HEAD.format(day=day), *tables]), encoding="utf-8")


if __name__ == "__main__":
    main()
