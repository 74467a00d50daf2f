"""Do the experiments' uncertainties hold? Each is repeated on copies of its machine, with other
noise, other places of uneven friction and other start positions; how often do the 95 % intervals
hold what the machine really has?

    python benchmarks/experiments.py --keep runs.json --page docs/measurements/experiments.md
    python benchmarks/experiments.py --keep runs.json --minutes 20 --jobs 2   # go on, two at once
    python benchmarks/experiments.py --machine slide.xml --seeds 40     # what fits a MuJoCo model
    python benchmarks/experiments.py --machine bar.xml --machine-option counts=6283
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from zendsp.errors import ZendspError
from zendsp.experiment import EXPERIMENTS as ALL
from zendsp.experiment import Lab, Result
from zendsp.experiment.any_friction import friction
from zendsp.experiment.breakaway import breakaway
from zendsp.experiment.high_speed import high_speed
from zendsp.experiment.lab import Bench
from zendsp.experiment.low_speed import low_speed
from zendsp.experiment.mechanics import mechanical
from zendsp.experiment.motor import electrical
from zendsp.experiment.truth import FRICTION, PENDULUM, TRUTH
from zendsp.experiment.wam_friction import friction as wam_friction
from zendsp.link import local
from zendsp.parent import die_with
from zendsp.recording import Recording
from zendsp.whole_file import write_whole

PLACES = 4
Copy = dict[str, Any]  # a value and its standard deviation by name; or "failed", and why
Counted = dict[str, dict[str, Copy]]  # by the experiment's name, and the copy's seed
# the longest integration step, s: twice that of the machine, for time
SUBSTEP = {"imi_planar": 2e-4, "wam7": 1e-4}


@dataclass(frozen=True)
class Repeated:
    """An experiment, what is left of it where all of it would take too long, and the truth."""

    make: Callable[[Lab], Result]
    truth: Mapping[str, float]
    note: str = ""


def _wam(joint: int) -> Callable[[Lab], Result]:
    return lambda lab: wam_friction(lab, joints=(joint,), narrow=False)


def _any(
    machine: str, make: Callable[..., Result], joint: int, more: Sequence[str] = ()
) -> Callable[[Lab], Result]:
    def made(lab: Lab) -> Result:
        step = [f"substep={SUBSTEP[machine]}"] if machine in SUBSTEP else []
        options = [f"seed={lab.seed}", *step, *more]
        arguments = [part for option in options for part in ("--machine-option", option)]
        with local(machine, clock="fast", options=arguments) as target:
            return make(Lab(lab.folder, target, seed=lab.seed), joints=(joint,))

    return made


def of_model(file: Path, options: Sequence[str] = ()) -> dict[str, Repeated]:
    """The friction experiments of each joint of a MuJoCo model, and what the file says of it.
    Inertia and weight of a joint that carries others depend on how these hang: they are compared
    where the joint stands alone. ``options``: of the machine, as KEY=VALUE.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(file))
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    one, found = partial(_any, str(file), more=options), {}
    for j in range(model.nv):
        n, loss, damping = j + 1, float(model.dof_frictionloss[j]), float(model.dof_damping[j])
        truth = {f"coulomb{n}{end}": loss for end in ("", "_pos", "_neg")}
        truth |= {f"viscous{n}{end}": damping for end in ("", "_pos", "_neg")}
        for name, make, names in (
            ("low-speed", low_speed, ("level", "slope")),
            ("breakaway", breakaway, ("breakaway",)),
            ("high-speed", high_speed, ("level", "viscous")),
        ):
            own = dict(zip((f"{each}{n}" for each in names), (loss, damping), strict=False))
            found[f"{name}, {file.stem}, joint {n}"] = Repeated(one(make, n), own)
        found[f"friction, {file.stem}, joint {n}"] = Repeated(one(friction, n), truth)
        if model.nv == 1:
            level = float(data.qfrc_bias[0])
            if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
                truth = truth | {"mass1": float(mass[0, 0]), "weight1": level}
            else:
                data.qpos[0] = np.pi / 2
                mujoco.mj_forward(model, data)
                sine = float(data.qfrc_bias[0])
                truth = truth | {"inertia1": float(mass[0, 0]), "weight_sine1": sine,
                                 "weight_cosine1": level}  # fmt: skip
        found[f"mechanical, {file.stem}, joint {n}"] = Repeated(one(mechanical, n), truth)
    return found


EXPERIMENTS: dict[str, Repeated] = {
    "breakaway": Repeated(
        lambda lab: breakaway(lab, PLACES), TRUTH["breakaway"], f"{PLACES} places a direction"
    ),
    "high-speed": Repeated(high_speed, TRUTH["high-speed"]),
    **{
        f"{name}, pendulum, joint 1": Repeated(_any("pendulum", make, 1), PENDULUM[name])
        for name, make in (
            ("low-speed", low_speed), ("breakaway", breakaway), ("high-speed", high_speed)
        )
    },
    "electrical": Repeated(electrical, TRUTH["electrical"]),
    "mechanical": Repeated(mechanical, TRUTH["mechanical"]),
    **{
        f"friction, joint {joint}": Repeated(_wam(joint), TRUTH["friction"])
        for joint in range(1, 8)
    },
    **{
        f"friction, {machine}, joint {joint}": Repeated(_any(machine, friction, joint), truth)
        for machine, truth in FRICTION.items()
        for joint in range(1, 8)
        if f"coulomb{joint}_pos" in truth
    },
}


class Quick(Lab):
    """A lab whose machines integrate with longer steps."""

    @contextmanager
    def bench(
        self, name: str, result: Result | None = None, **options: Any
    ) -> Iterator[Bench]:
        if ALL[name].shipped in SUBSTEP:
            options["substep"] = SUBSTEP[ALL[name].shipped]
        with super().bench(name, result, **options) as bench:
            yield bench


def keep_nothing() -> None:
    """Draw no figure and write no recording: they cost more than what is counted here."""
    Figure.savefig = lambda *a, **k: None  # type: ignore[method-assign]
    Recording.save = lambda self, path: Path(path)  # type: ignore[method-assign]


def begin(machine: Path | None, options: Sequence[str], parent: int = 0) -> None:
    """What each process that makes copies does first; one of another's ends with that."""
    if parent:
        die_with(parent)
    keep_nothing()
    if machine:
        EXPERIMENTS.clear()
        EXPERIMENTS.update(of_model(machine, options))


def repeat(name: str, seed: int) -> Copy:
    """A copy: value and standard deviation of every number whose truth is known; or, where it could
    not be made, why.
    """
    one = EXPERIMENTS[name]
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = one.make(Quick(folder, seed=seed)).values
        except ZendspError as error:
            return {"failed": str(error)}
    return {key: (found[key].value, found[key].std) for key in one.truth if key in found}


def count(kept: Counted, wanted: list[tuple[str, int]], args: argparse.Namespace) -> None:
    """Make the copies that are wanted, ``args.jobs`` at once, and keep each as soon as it is there:
    a run that is killed leaves all that was done.
    """
    until = time.monotonic() + 60 * args.minutes
    left, made = iter(wanted), dict[Future[Copy], tuple[str, int]]()
    spawn = get_context("spawn")  # a link has threads, which a fork would not have
    made_of = args.machine, args.machine_option, os.getpid()
    with ProcessPoolExecutor(args.jobs, spawn, begin, made_of) as pool:
        while True:
            room = args.jobs - len(made) if time.monotonic() < until else 0
            for name, seed in itertools.islice(left, room):
                made[pool.submit(repeat, name, seed)] = name, seed
            if not made:
                return
            for done in wait(made, return_when=FIRST_COMPLETED).done:
                name, seed = made.pop(done)
                kept.setdefault(name, {})[str(seed)] = done.result()
            if args.keep:
                write_whole(args.keep, json.dumps(kept))


def section(name: str, kept: Counted) -> str:
    """What the copies of one experiment say, of all joints that it was made on."""
    lines = [
        "| quantity | machine | mean | spread | stated | off, in stated | intervals that hold it |",
        "|---|---|---|---|---|---|---|",
    ]
    held, number, times, failed = 0, 0, [], list[str]()
    for one in (one for one in EXPERIMENTS if whole(one) == name and len(kept.get(one, {})) > 1):
        failed += [f"{one}, {k}: {x['failed']}" for k, x in kept[one].items() if "failed" in x]
        rows = [row for row in kept[one].values() if "failed" not in row]
        times.append(len(kept[one]))
        for key in {key: None for row in rows for key in row}:  # not each is stated each time
            value, std = np.array([row[key] for row in rows if key in row]).T
            truth = EXPERIMENTS[one].truth[key]
            inside = np.abs(value - truth) <= 1.96 * std
            held, number = held + int(inside.sum()), number + len(inside)
            spread = f"{value.std(ddof=1):.2g}" if len(value) > 1 else "not told"
            lines.append(
                f"| {key.replace('_', ' ')} | {truth:.4g} | {value.mean():.4g} |"
                f" {spread} | {std.mean():.2g} |"
                f" {(value.mean() - truth) / std.mean():+.2f} | {100 * inside.mean():.1f} % of"
                f" {len(inside)} |"
            )
    note = f" ({EXPERIMENTS[name].note})" if name in EXPERIMENTS and EXPERIMENTS[name].note else ""
    fewest, most = min(times), max(times)
    many = f"{most}" if fewest == most else f"{fewest} to {most}"
    said = f"{many} repetitions, {date.today():%-d %B %Y}: {100 * held / max(number, 1):.1f} %"
    lacking = [f"Not made, {len(failed)}:", "", *(f"- {one}" for one in failed), ""]
    said = f"{said} of {number} intervals hold."
    return "\n".join(
        [f"## {name}{note}", "", said, "", *lacking * bool(failed), *lines, ""]
    )


def whole(name: str) -> str:
    """The experiment without the joint that it was made on."""
    return name.rpartition(", joint ")[0] or name


def page(tables: Mapping[str, str], before: str) -> str:
    """The page with these tables in their sections; what was written below a table, or in sections
    of its own, stays.
    """
    new = {table.partition("\n")[0]: table for table in tables.values()}
    head, *parts = before.strip("\n").split("\n\n## ") if before else [HEAD]
    out = [head.strip("\n") + "\n"]
    for part in parts:
        heading, _, text = f"## {part}\n".partition("\n")
        if table := new.pop(heading, None):
            text = table.partition("\n")[2] + "\n" + text.rpartition("|\n")[2].strip("\n")
        out.append(f"{heading}\n{text.rstrip()}\n")
    return "\n".join([*out, *new.values()])


HEAD = """# Do the intervals of the experiments hold?

`python benchmarks/experiments.py`: every experiment repeated on copies of its simulated machine,
with other noise, other places of uneven friction and other start positions. *Spread* is that of the
values found, *stated* the mean of the standard deviations that the experiment gave; the last column
counts how many of its 95 % intervals hold what the machine has. Where the spread is far below what
is stated, the law that is fitted is not quite the machine's: the error is the same in every copy,
and its interval holds the truth each time, or never.
"""


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--seeds", type=int, default=200, help="repetitions of each")
    p.add_argument("--first-seed", type=int, default=1, help="others: other copies")
    p.add_argument("--only", default=[""], nargs="+", help="those whose names begin so")
    p.add_argument("--minutes", type=float, default=float("inf"), help="begin none after so many")
    p.add_argument("--jobs", type=int, default=1, help="copies at once")
    p.add_argument("--keep", type=Path, help="go on from this file, and keep the repetitions there")
    p.add_argument("--page", type=Path, help="write the tables there (Markdown)")
    p.add_argument("--machine", type=Path, help="instead: a MuJoCo model, which has the truth")
    p.add_argument("--machine-option", action="append", default=[], help="of it: KEY=VALUE")
    args = p.parse_args()
    begin(args.machine, args.machine_option)
    kept: Counted = json.loads(args.keep.read_text()) if args.keep and args.keep.exists() else {}
    names = [name for name in EXPERIMENTS if name.startswith(tuple(args.only))]
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    each = itertools.product(seeds, names)
    count(kept, [(name, seed) for seed, name in each if str(seed) not in kept.get(name, {})], args)
    done = dict.fromkeys(whole(name) for name in EXPERIMENTS if len(kept.get(name, {})) > 1)
    tables = {name: section(name, kept) for name in done}
    print("\n".join(tables.values()))
    if args.page:
        before = args.page.read_text(encoding="utf-8") if args.page.exists() else ""
        args.page.write_text(page(tables, before), encoding="utf-8")


if __name__ == "__main__":
    main()
