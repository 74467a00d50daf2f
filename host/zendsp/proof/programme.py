"""Which cases the proof is made of, and where it keeps them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from zendsp.proof.build_case import Request
from zendsp.proof.cases import plan, write_all

# (machine, kind, how many, sizes); 0: every effect once at every size
FULL: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("rotary", "single", 0, (1.0, 0.3, 0.1)),
    ("rotary", "complete", 40, (1.0,)),
    ("rotary", "complete_slow", 20, (1.0,)),
    ("rotary", "nuisance", 20, (1.0,)),
    ("rotary", "pair", 18, (1.0,)),
    ("rotary", "foreign", 14, (1.0,)),
    ("rotary", "replace", 12, (1.0, 0.3)),
    ("rotary", "behind", 12, (1.0,)),
    ("rotary", "part", 12, (1.0, 0.3)),
    ("rotary", "hard", 0, (0.3,)),
    ("rotary", "hard_complete", 20, (1.0,)),
    ("pendulum", "single", 0, (0.3,)),
    ("pendulum", "complete", 15, (1.0,)),
    ("pendulum", "pair", 4, (1.0,)),
    ("linear", "single", 0, (0.3,)),
    ("linear", "complete", 15, (1.0,)),
    ("linear", "foreign", 4, (1.0,)),
    ("planar2r", "single", 0, (0.3,)),
    ("planar2r", "complete", 15, (1.0,)),
    ("planar2r", "pair", 4, (1.0,)),
    ("urdf", "single", 7, (0.3,)),
    ("urdf", "complete", 3, (1.0,)),
)
QUICK: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("rotary", "single", 13, (1.0,)),
    ("rotary", "complete", 4, (1.0,)),
    ("rotary", "complete_slow", 1, (1.0,)),
    ("rotary", "nuisance", 1, (1.0,)),
    ("rotary", "pair", 2, (1.0,)),
    ("rotary", "foreign", 2, (1.0,)),
    ("rotary", "replace", 2, (1.0,)),
    ("pendulum", "single", 2, (1.0,)),
    ("linear", "single", 2, (1.0,)),
    ("planar2r", "single", 1, (1.0,)),
)
# development uses seeds below 500 000, the sealed set of development 710 000 and up
FIRST_SEED = 2_000_000


def requests(seed: int, quick: bool) -> list[Request]:
    """Every case of a run; `seed` moves all of them."""
    out: list[Request] = []
    for index, (machine, kind, count, sizes) in enumerate(QUICK if quick else FULL):
        first = FIRST_SEED + 100_000 * seed + 1000 * index
        planned = plan(kind, machine, first, 0 if kind == "single" else count, sizes)
        if kind == "single" and count:  # spread over the effects instead of the first ones of the table
            step = max(1, len(planned) // count)
            planned = [planned[(seed + k * step) % len(planned)] for k in range(count)]
        out += planned
    return out


def prepare(folder: Path, seed: int, quick: bool, jobs: int) -> tuple[Path, Path, str]:
    """Write the cases and seal their truth, or find those of an interrupted run.

    Returns
    -------
    cases, truth : Path
    stamp : str
        Hash of the list of seals: the one figure to write down before any diagnosis runs.
    """
    cases, truth, note = folder / "cases", folder / "truth", folder / "programme.json"
    wanted = requests(seed, quick)
    text = json.dumps([asdict(r) for r in wanted])
    if note.exists():
        kept = json.loads(note.read_text(encoding="utf-8"))
        if kept["requests"] == json.loads(text):
            return cases, truth, str(kept["stamp"])
        raise FileExistsError(
            f"{folder} holds another run (other seed, --quick or version); give another --out or remove it"
        )
    stamp = write_all(wanted, cases, truth, jobs=jobs)
    note.write_text(json.dumps({"stamp": stamp, "requests": json.loads(text)}, indent=1), encoding="utf-8")
    return cases, truth, stamp
