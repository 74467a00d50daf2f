"""``python -m zendsp.proof.cases``: writes concealed cases, and their truth apart from them, sealed
by hash.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

import click

from zendsp.proof.build_case import NoUsableCase, Request, make_case
from zendsp.proof.children import cluster, processes, workers
from zendsp.proof.conceal import KINDS, PAIRS, REPLACEMENTS
from zendsp.proof.effects import SINGLE
from zendsp.proof.files import save, toml
from zendsp.proof.foreign import NAMES as FOREIGN
from zendsp.proof.machines import MACHINES
from zendsp.proof.seal import digest, seal, write_truth
from zendsp.proof.truth import Truth

SIZES = (1.0, 0.3, 0.1)
# what cannot be put on a machine: coupling needs two joints, eccentricity a turn, open loops have
# no command to saturate
UNFIT = {
    "rotary": {"coupling"},
    "pendulum": {
        "coupling", "encoder_eccentricity", "saturation", "dead_zone", "elasticity", "backlash",
    },
    "linear": {"coupling", "encoder_eccentricity", "gravity", "torque_gain"},
    "planar2r": {"encoder_eccentricity", "torque_gain", "inertia", "gravity"},
    "urdf": {
        "encoder_eccentricity", "torque_gain", "inertia", "gravity", "elasticity", "backlash",
        "saturation",
    },
}
# how a complete machine is logged
FAULTS = ("plain", "jitter", "repeat", "stale", "float32", "filtered", "origin")
BEHIND = (
    "coulomb", "stribeck", "ripple", "viscous_asymmetry", "dead_zone", "delay", "torque_offset",
    "position_friction",
)
PART = ("coulomb", "stribeck", "presliding", "backlash", "coulomb_asymmetry", "dead_zone")


@dataclass(frozen=True)
class Order:
    """One numbered case to write."""

    number: int
    request: Request
    cases: str
    truth: str


def fits(machine: str, effect: str) -> bool:
    """Whether a machine can have an effect, or each of several joined by ``+``."""
    return all(name not in UNFIT[machine] for name in effect.split("+"))


def plan(kind: str, machine: str, seed: int, count: int, sizes: tuple[float, ...]) -> list[Request]:
    """`count` requests of one kind, going round its effects and the sizes."""
    if kind in ("single", "nuisance_single", "hard"):
        names: tuple[str, ...] = tuple(e for e in SINGLE if fits(machine, e))
    elif kind == "pair":
        names = tuple("+".join(p) for p in PAIRS if fits(machine, "+".join(p)))
    elif kind == "replace":
        names = REPLACEMENTS
    elif kind in ("behind", "part"):
        names = tuple(e for e in (BEHIND if kind == "behind" else PART) if fits(machine, e))
    elif kind == "foreign":  # names and sizes go round together
        return [
            Request(seed + k, kind, machine, FOREIGN[k % len(FOREIGN)], sizes[k % len(sizes)])
            for k in range(count)
        ]
    else:
        names = FAULTS if kind == "complete" else ("",)
    every = [(name, size) for size in sizes for name in names]
    return [
        Request(seed + k, kind, machine, *every[k % len(every)])
        for k in range(count if count > 0 else len(every))
    ]


def write_case(order: Order) -> str:
    """Make and write one case, unless its truth is there already; returns one line for the
    terminal.

    A request whose draws make no sensible recording is left out: a campaign does not end with it.
    """
    name = f"case_{order.number:04d}"
    if (Path(order.truth) / f"{name}.json").exists():  # written last
        return f"{name} kept"
    try:
        case = make_case(order.request)
    except NoUsableCase as error:
        return f"{name} left out: {error}"
    folder = Path(order.cases) / name
    folder.mkdir(parents=True, exist_ok=True)
    columns = case.model["columns"]
    train = [save(folder, "train", case.form, case.train, columns).name]
    heldout: list[str] = []
    if case.layout != "none":
        (train if case.layout == "joint" else heldout).append(
            save(
                folder,
                "second" if case.layout == "joint" else "heldout",
                case.form,
                case.heldout,
                columns,
            ).name
        )
    (folder / "model.toml").write_text(toml(case.model), encoding="utf-8")
    for file, content in case.files.items():
        (folder / file).write_text(content, encoding="utf-8")
    listing = {
        "train": train,
        "heldout": heldout,
        "model": "model.toml",
        "joints": case.train.q.shape[1],
    }
    (folder / "case.json").write_text(json.dumps(listing) + "\n", encoding="utf-8")
    hidden = Path(order.truth)
    hidden.mkdir(parents=True, exist_ok=True)
    untouched = save(hidden, f"{name}_untouched", "npz", case.untouched, columns)
    truth: Truth = {
        **case.truth, "case": name, "seed": order.request.seed, "untouched": digest(untouched),
        "reality": order.request.reality, "given": order.request.given,
    }  # fmt: skip
    write_truth(hidden, name, truth)
    return f"{name} {order.request.machine} {order.request.kind}"


def write_all(
    requests: list[Request],
    cases: Path,
    truth: Path,
    *,
    first: int = 1,
    jobs: int = 1,
    scheduler: str = "",
) -> str:
    """Write every case and seal the truth; returns the hash of the list of seals.

    `jobs` at a time on this machine, or as the Dask cluster of `scheduler` has workers.
    """
    where = str(cases.resolve()), str(truth.resolve())
    orders = [Order(first + k, r, *where) for k, r in enumerate(requests)]
    if jobs > 1 or scheduler:
        with workers(cluster(scheduler) if scheduler else processes(jobs)) as pool:
            for done in as_completed([pool.submit(write_case, order) for order in orders]):
                print(done.result(), file=sys.stderr)
    else:
        for order in orders:
            print(write_case(order), file=sys.stderr)
    return seal(truth)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--seed", type=int, required=True, help="First seed; case k has seed + k.")
@click.option("--count", type=int, default=0, help="How many; 0: each effect once at each size.")
@click.option("--kind", type=click.Choice(sorted(KINDS)), required=True)
@click.option("--machine", type=click.Choice(sorted(MACHINES)), default="rotary", show_default=True)
@click.option(
    "--sizes", default="1,0.3,0.1", show_default=True, help="Knobs of size, comma separated."
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the cases.")
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    help="Folder of the truth; default: truth_OUT beside OUT.",
)
@click.option("--jobs", type=int, default=1, show_default=True)
def main(
    seed: int,
    count: int,
    kind: str,
    machine: str,
    sizes: str,
    out: Path,
    truth: Path | None,
    jobs: int,
) -> None:
    """Write concealed cases under OUT (added to what is there) and the truth apart."""
    truth = truth or out.parent / f"truth_{out.name}"
    numbers = (
        [int(p.name.removeprefix("case_")) for p in out.glob("case_*")] if out.exists() else []
    )
    requests = plan(kind, machine, seed, count, tuple(float(s) for s in sizes.split(",")))
    stamp = write_all(requests, out, truth, first=max(numbers, default=0) + 1, jobs=jobs)
    print(f"{len(requests)} cases in {out}; truth sealed in {truth}: {stamp}")


if __name__ == "__main__":
    main()
