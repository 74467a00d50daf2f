"""Which cases a MuJoCo reality is judged on: machine, kind, what is concealed, size as a share of
the torque.
"""

from __future__ import annotations

from dataclasses import dataclass

from zendsp.proof.case import Request
from zendsp.proof.forms import FAINT
from zendsp.proof.mujoco.foreign import names as foreign_names
from zendsp.proof.mujoco.make import FAULTS
from zendsp.proof.mujoco.truths import MAKERS

BODIES = ("payload", "heavier", "com", "base_tilt")
# what cannot be put on a machine: bodies need a chain, once per turn needs turns, unbalance needs a
# link that hangs
UNFIT: dict[str, tuple[str, ...]] = {
    "mj_joint": BODIES,
    "mj_cart": (*BODIES, "gravity", "sensor_harmonic", "encoder_eccentricity"),
    "mj_planar2r": (*BODIES, "gravity", "encoder_eccentricity"),
    "mj_arm6": ("gravity", "encoder_eccentricity", "sensor_harmonic"),
    "mj_arm7": ("gravity", "encoder_eccentricity", "sensor_harmonic"),
}
PAIRS = (
    "dry_hard+stiffness", "lugre+ripple", "dry_soft+quadratic_drag", "dry_hard+delay",
    "viscous+stiffness", "stribeck+torque_offset", "dead_zone+ripple", "quadratic_drag+ripple",
    "lag+stiffness", "position_friction+quadratic_drag", "backlash+viscous", "elasticity+dry_hard",
)
# dry friction in every joint, and one thing more
ALL = (
    "dry_hard", "dry_hard+payload", "dry_hard+stiffness", "dry_soft", "dry_hard+heavier",
    "dry_soft+payload", "dry_hard+elasticity", "dry_hard+base_tilt",
)


@dataclass(frozen=True)
class Row:
    """So many cases of one kind on one machine; `count` 0: every name once at every size."""

    machine: str
    kind: str
    count: int
    sizes: tuple[float, ...] = (1.0,)


FULL = (
    Row("mj_joint", "single", 0, (0.2, 0.07, 0.02)),
    Row("mj_cart", "single", 0, (0.1,)),
    Row("mj_planar2r", "single", 0, (0.1,)),
    Row("mj_arm6", "single", 0, (0.15,)),
    Row("mj_arm7", "single", 12, (0.15,)),
    Row("mj_joint", "pair", 0, (0.15,)),
    Row("mj_arm6", "all", 0, (0.15,)),
    Row("mj_arm7", "all", 3, (0.15,)),
    Row("mj_joint", "complete", 128),
    Row("mj_cart", "complete", 64),
    Row("mj_planar2r", "complete", 40),
    Row("mj_arm6", "complete", 32),
    Row("mj_arm7", "complete", 8),
    Row("mj_joint", "nuisance", 24),
    Row("mj_cart", "nuisance", 12),
    Row("mj_arm6", "nuisance", 4),
    Row("mj_joint", "foreign", 84, FAINT),
    Row("mj_cart", "foreign", 28, FAINT),
    Row("mj_planar2r", "foreign", 21, FAINT),
    Row("mj_arm6", "foreign", 14, FAINT),
)


def names(row: Row) -> list[str]:
    """What a row conceals in turn."""
    if row.kind == "single":
        return [name for name in MAKERS if name not in UNFIT[row.machine]]
    if row.kind == "pair":
        return [p for p in PAIRS if not set(p.split("+")) & set(UNFIT[row.machine])]
    if row.kind == "foreign":
        return foreign_names(2 if row.machine in ("mj_planar2r", "mj_arm6", "mj_arm7") else 1)
    return list({"all": ALL, "complete": FAULTS}.get(row.kind, ("",)))


def plan(row: Row, seed: int) -> list[Request]:
    """The requests of one row; case k has seed + k.

    Names go round first; `seed` says where a row that is shorter than its names begins.
    """
    every = names(row)
    count = row.count or len(every) * len(row.sizes)
    turn = 0 if row.count == 0 else (seed // 1000) * count
    return [
        Request(
            seed + k, row.kind, row.machine, every[(turn + k) % len(every)],
            row.sizes[(k // len(every) if row.count == 0 else k) % len(row.sizes)], "mujoco",
        )
        for k in range(count)
    ]  # fmt: skip


# what a diagnosis that always says yes, or one that names the nearest law, gets wrong
QUICK: tuple[tuple[str, str, str, float], ...] = (
    ("mj_joint", "single", "dry_soft", 0.1),
    ("mj_joint", "single", "lugre", 0.1),
    ("mj_cart", "single", "stiffness", 0.05),
    ("mj_arm6", "single", "payload", 1.0),
    ("mj_joint", "complete", "jitter", 1.0),
    ("mj_joint", "complete", "filtered", 1.0),
    ("mj_cart", "complete", "slow", 1.0),
    ("mj_joint", "nuisance", "", 1.0),
    ("mj_joint", "foreign", "sin3tanh", 0.03),
    ("mj_joint", "foreign", "thermal", 0.05),
    ("mj_joint", "foreign", "dragload", 0.03),
    ("mj_cart", "foreign", "memory", 0.05),
)


def of_bodies(request: Request) -> bool:
    """Whether a request conceals a body of an arm."""
    names = request.effect.split("+")
    return request.machine in ("mj_arm6", "mj_arm7") and any(n in BODIES for n in names)


def requests(first_seed: int, quick: bool = False) -> list[Request]:
    """Every case of the programme; with `quick`, a dozen."""
    if quick:
        return [
            Request(first_seed + k, kind, machine, effect, size, "mujoco")
            for k, (machine, kind, effect, size) in enumerate(QUICK)
        ]
    return [r for index, row in enumerate(FULL) for r in plan(row, first_seed + 1000 * index)]
