"""Which cases the proof is made of, and where it keeps them."""

from __future__ import annotations

import json
import random
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from zendsp.proof import shipped
from zendsp.proof.case import Request
from zendsp.proof.cases import plan, write_all
from zendsp.proof.forms import FAINT
from zendsp.proof.mujoco import programme as mujoco

# (machine, kind, how many, sizes); 0: every effect once at every size
FULL: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("rotary", "single", 0, (1.0, 0.3, 0.1)),
    ("rotary", "complete", 120, (1.0,)),
    ("rotary", "complete_slow", 40, (1.0,)),
    ("rotary", "nuisance", 40, (1.0,)),
    ("rotary", "pair", 18, (1.0,)),
    ("rotary", "foreign", 84, FAINT),
    ("rotary", "replace", 12, (1.0, 0.3)),
    ("rotary", "behind", 12, (1.0,)),
    ("rotary", "part", 12, (1.0, 0.3)),
    ("rotary", "hard", 0, (0.3,)),
    ("rotary", "hard_complete", 40, (1.0,)),
    ("pendulum", "single", 0, (0.3,)),
    ("pendulum", "complete", 36, (1.0,)),
    ("pendulum", "pair", 4, (1.0,)),
    ("linear", "single", 0, (0.3,)),
    ("linear", "complete", 36, (1.0,)),
    ("linear", "foreign", 14, FAINT),
    ("planar2r", "single", 0, (0.3,)),
    ("planar2r", "complete", 30, (1.0,)),
    ("planar2r", "pair", 4, (1.0,)),
    ("urdf", "single", 7, (0.3,)),
    ("urdf", "complete", 6, (1.0,)),
)
QUICK: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("rotary", "single", 8, (1.0,)),
    ("rotary", "complete", 2, (1.0,)),
    ("rotary", "complete_slow", 1, (1.0,)),
    ("rotary", "nuisance", 1, (1.0,)),
    ("rotary", "pair", 1, (1.0,)),
    ("rotary", "foreign", 3, (0.1, 0.05, 0.02)),
    ("rotary", "replace", 1, (1.0,)),
    ("pendulum", "single", 1, (1.0,)),
    ("linear", "single", 1, (1.0,)),
    ("planar2r", "single", 1, (1.0,)),
)
# development uses seeds below 500 000, the sealed set of development 710 000 and up
FIRST_SEED = 2_000_000
REALITIES = ("own", "machines", "mujoco")
LACK_NOTHING = ("complete", "complete_slow", "nuisance", "hard_complete")


def own(first_seed: int, turn: int, quick: bool) -> list[Request]:
    """The cases of the own generator."""
    out: list[Request] = []
    for index, (machine, kind, count, sizes) in enumerate(QUICK if quick else FULL):
        first = first_seed + 1000 * index
        planned = plan(kind, machine, first, 0 if kind == "single" else count, sizes)
        if (
            kind == "single" and count
        ):  # spread over the effects instead of the first ones of the table
            step = max(1, len(planned) // count)
            planned = [planned[(turn + k * step) % len(planned)] for k in range(count)]
        out += planned
    return out


def shared_out(count: int, sizes: Sequence[int]) -> list[int]:
    """`count` in equal parts, none above its size: what one cannot hold goes to the others."""
    shares = [0] * len(sizes)
    for _ in range(min(count, sum(sizes))):
        open_ones = [k for k, size in enumerate(sizes) if shares[k] < size]
        shares[min(open_ones, key=shares.__getitem__)] += 1
    return shares


def every_sort(group: Sequence[Request], taken: list[int], rng: random.Random) -> list[Request]:
    """Those of a group that were drawn. A sort of case that is not among them takes the place of
    one of the sort that was drawn most often: a small sample holds pairs and replaced terms, too.
    """
    sorts = ["body" if mujoco.of_bodies(r) else r.kind for r in group]
    for sort in dict.fromkeys(sorts):
        held = Counter(sorts[i] for i in taken)
        if sort in held or max(held.values(), default=0) < 2:
            continue
        most = max(held, key=held.__getitem__)
        taken.remove(next(i for i in reversed(taken) if sorts[i] == most))
        taken.append(rng.choice([i for i, other in enumerate(sorts) if other == sort]))
    return [group[i] for i in sorted(taken)]


def requests(
    seed: int,
    quick: bool,
    realities: Sequence[str] = ("own",),
    sample: int = 0,
    given: str = "urdf",
    nulls: bool = False,
) -> list[Request]:
    """Every case of a run; `seed` moves all of them. With `nulls`, those that lack nothing.

    With `sample`, so many of them drawn by the seed: as many of each reality, as far as it has
    them, and some of every sort of case where there is room. With `given` "mjcf",
    those of MuJoCo's arms that conceal a body are asked a second time, their model given as MJCF.
    """
    first = FIRST_SEED + 100_000 * seed
    groups = []
    for name in realities:
        if name == "own":
            groups.append(own(first, seed, quick))
        elif name == "machines":
            groups.append(shipped.requests(first + 40_000, quick))
        else:  # MuJoCo itself is not needed to say what will be made
            groups.append(mujoco.requests(first + 50_000, quick))
    if nulls:
        groups = [[r for r in group if r.kind in LACK_NOTHING] for group in groups]
    if sample:
        rng = random.Random(seed)
        shares = shared_out(sample, [len(group) for group in groups])
        taken = [
            rng.sample(range(len(group)), share)
            for group, share in zip(groups, shares, strict=True)
        ]
        groups = [every_sort(*drawn, rng) for drawn in zip(groups, taken, strict=True)]
    asked = [request for group in groups for request in group]
    if given == "mjcf":
        asked += [replace(r, given="mjcf") for r in asked if mujoco.of_bodies(r)]
    return asked


@dataclass(frozen=True)
class Prepared:
    """Where the cases of a run lie, and the hash of the list of their seals.

    The hash is the one figure to write down before any diagnosis runs.
    """

    folder: Path
    stamp: str

    @property
    def cases(self) -> Path:
        """Folder of the cases."""
        return self.folder / "cases"

    @property
    def truth(self) -> Path:
        """Folder of what they conceal."""
        return self.folder / "truth"


def prepare(folder: Path, wanted: Sequence[Request], jobs: int, scheduler: str = "") -> Prepared:
    """Write the cases and seal their truth, or find those of an interrupted run.

    Raises
    ------
    FileExistsError
        `folder` holds other cases.
    """
    note = folder / "programme.json"
    asked = json.loads(json.dumps([asdict(r) for r in wanted]))
    if note.exists():
        kept = json.loads(note.read_text(encoding="utf-8"))
        if kept["requests"] != asked:
            raise FileExistsError(
                f"{folder} holds another run (other seed, realities, --quick, --sample or version);"
                " give another folder or remove it"
            )
        if kept["stamp"]:
            return Prepared(folder, str(kept["stamp"]))
    made = Prepared(folder, "")
    folder.mkdir(parents=True, exist_ok=True)
    write_note(note, "", asked)  # an interrupted making goes on
    stamp = write_all(list(wanted), made.cases, made.truth, jobs=jobs, scheduler=scheduler)
    write_note(note, stamp, asked)
    return Prepared(folder, stamp)


def write_note(path: Path, stamp: str, asked: list[dict[str, Any]]) -> None:
    """What was asked for, and the stamp once all of it is sealed."""
    path.write_text(json.dumps({"stamp": stamp, "requests": asked}, indent=1), encoding="utf-8")


def found(folder: Path) -> Prepared:
    """The cases that were made under `folder` before.

    Raises
    ------
    FileNotFoundError
        There are none.
    """
    note = folder / "programme.json"
    stamp = str(json.loads(note.read_text(encoding="utf-8"))["stamp"]) if note.exists() else ""
    if not stamp:
        raise FileNotFoundError(
            f"{folder} holds no finished cases: make them with zendsp prove --make"
            f" {shlex.quote(str(folder))}"
        )
    return Prepared(folder, stamp)
